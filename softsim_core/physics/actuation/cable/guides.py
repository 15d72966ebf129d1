"""Friction along cables: at each point over which a cable slides, the tension changes by a force of its own.

At a point g between the ends of a cable, the tension falls from t to t exp(-l z) on the way from the pulled
end to the anchored one, with

    l = friction . (angle between the segments) + friction_per_length . (half the length of both segments)
    z = clip(z0 + (s - s0) / presliding, -1, 1)

where s is the length that has slid over the point towards the pulled end, and z0 and s0 are z and s where the
motion began. So z = 1 while the cable is pulled, -1 while it is let out, and in between the force grows with
the motion, whatever its rate. What is remembered are z0 and s0.

The change of tension is the multiplier of a passive row whose coordinate is s: the shortening of the part of
the cable beyond the point. Its law is linearised about a state, with a compliance while z is between its
bounds; its bounds are those of the tension change. The tension before the point is that of the state.

Source: the capstan equation (Euler, Eytelwein); Dahl 1968, A solid friction model (its limit without a
transition, which is elastic up to the sliding force).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray, SceneError
from softsim_core.physics.actuation import Constraints
from softsim_core.physics.actuation.cable.description import CableDescription
from softsim_core.physics.mechanics import PASSIVE_EFFORTS, Model, State, Transmissions

if TYPE_CHECKING:
    from softsim_core.physics.actuation.cable.cables import Cables

SMALLEST = 1e-9
"""Largest tension change in [N] that is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class Guides:
    """Friction at the m points over which cables slide.

    Attributes:
        cables: The cables, without their passive rows.
        cable: Cable of each guide, shape (m,).
        point: Its point among those of all cables, shape (m,).
        per_angle: Loss per angle in [1/rad], shape (m,).
        per_length: Loss by the length of the segments, shape (m,).
        presliding: Motion in [m] in which z changes by 1, shape (m,).
        beyond: Whether each segment is beyond each guide, shape (m, p - 1), as 0 and 1.
        at_rest: Length beyond each guide at the start in [m], shape (m,).
        constraints: Constant part of the rows: their entries are those of the cables' rows beyond the guides.
        entries: Entry of the cables' rows that each entry is a part of, shape (k,).
        at_guide: Whether it is at the guide itself, where only the segment beyond it counts, shape (k,).
    """

    cables: Cables
    cable: IndexArray
    point: IndexArray
    per_angle: Array
    per_length: Array
    presliding: Array
    beyond: Array
    at_rest: Array
    constraints: Constraints = field(init=False)
    entries: IndexArray = field(init=False)
    at_guide: BoolArray = field(init=False)

    def __post_init__(self) -> None:
        layout, points = self.cables.layout, self.cables.entry_points()
        owner = np.repeat(np.arange(len(self.cables.names)), np.diff(layout.start))
        parts = [
            np.flatnonzero((owner == cable) & (points >= point))
            for cable, point in zip(self.cable, self.point, strict=True)
        ]
        counts, entries = np.array([len(each) for each in parts]), np.concatenate(parts)
        start = np.concatenate([[0], np.cumsum(counts)])
        by_multiplier = np.zeros(len(self.point), np.bool_)
        constraints = Constraints(np.zeros(0, np.int64), start, layout.place[entries], by_multiplier)
        object.__setattr__(self, "constraints", constraints)
        object.__setattr__(self, "entries", entries)
        object.__setattr__(self, "at_guide", points[entries] == np.repeat(self.point, counts))

    @property
    def keeps(self) -> int:
        """Numbers of memory: z0 and s0 of each guide."""
        return 2 * len(self.point)

    def values(self, model: Model, state: State) -> Array:
        """Return the lengths that have slid over the guides since the start in [m], shape (m,)."""
        _, lengths = self.cables.directions(self.cables.points(model, state))
        return np.asarray(self.at_rest - self.beyond @ lengths)

    def coefficients(self, model: Model, state: State) -> Array:
        """Return the entries of the rows, shape (k, 3)."""
        cables, points = self.cables, self.cables.points(model, state)
        unit, _ = cables.directions(points)
        beyond = np.append(unit, np.zeros((1, 3)), axis=0)
        whole, part = (cables.spread(model, state, points, each) for each in (cables.pulls(points), beyond))
        return np.where(self.at_guide[:, None], part[self.entries], whole[self.entries])

    def transmissions(self, model: Model, state: State, kept: Array) -> Transmissions:
        """Return the law of each guide, linearised at a state; see PassiveRows."""
        cables = self.cables
        unit, lengths = cables.directions(cables.points(model, state))
        shares, slid = self._shares(lengths, kept)
        loss = self._losses(unit)
        left = np.exp(-loss * shares)
        before = self._tensions_before(state, np.exp(-(loss * shares) @ self.beyond), lengths)
        resisting = before * loss > SMALLEST
        compliance = np.zeros(len(self.point))
        stiffness = (before * loss * left / self.presliding)[resisting]
        compliance[resisting] = 1.0 / stiffness
        force = np.where(resisting, before * (left - 1.0), 0.0)
        held = np.where(resisting, before, 0.0)
        lower, upper = held * np.expm1(-loss), held * np.expm1(loss)
        return Transmissions(slid + compliance * force, compliance, lower, upper, np.zeros_like(compliance))

    def remember(self, model: Model, state: State, kept: Array) -> None:
        """Write z and s at the end of a motion into `kept`."""
        _, lengths = self.cables.directions(self.cables.points(model, state))
        kept[: len(self.point)] = self._shares(lengths, kept)[0]
        kept[len(self.point) :] = self.at_rest - self.beyond @ lengths

    def tension_changes(self, state: State) -> Array:
        """Return the sum of the tension changes before each segment in [N], shape (p - 1,)."""
        return np.asarray(state.extra[PASSIVE_EFFORTS] @ self.beyond)

    def _shares(self, lengths: Array, kept: Array) -> tuple[Array, Array]:
        """Return z, and s at which it is reached first in [m], shapes (m,), with segments of `lengths`."""
        began, place = kept.reshape(2, -1)
        moved = self.at_rest - self.beyond @ lengths - place
        shares = np.clip(began + moved / self.presliding, -1.0, 1.0)
        return shares, place + self.presliding * (shares - began)

    def _losses(self, unit: Array) -> Array:
        """Return l of each guide, with segments in the directions `unit` (p - 1, 3)."""
        before, after = unit[self.point - 1], unit[self.point]
        sine = np.linalg.norm(np.cross(before, after), axis=1)
        angle = np.arctan2(sine, np.einsum("gi,gi->g", before, after))
        return np.asarray(self.per_angle * angle + self.per_length)

    def _tensions_before(self, state: State, left: Array, lengths: Array) -> Array:
        """Return the tension before each guide in [N], from that in the state, shape (m,).

        The ratios of tensions are those of the law. Of the tensions in the state, the one at the pulled end
        counts where they fall beyond it, and the mean where they rise, because that is which the next solve
        will change least.

        Args:
            state: The state.
            left: Tension of each segment over that at the pulled end, shape (p - 1,).
            lengths: Lengths of the segments in [m], 0 between cables, shape (p - 1,).
        """
        cables, first = self.cables, self.cables.first[:-1]
        pulled = state.joint_efforts[cables.joint]
        whole = np.add.reduceat(lengths, first)
        mean_left = np.add.reduceat(left * lengths, first) / whole
        changes = np.add.reduceat(self.tension_changes(state) * lengths, first) / whole
        mean = (pulled + changes) / mean_left
        tension = np.maximum(np.where((mean_left > 1.0) & ~cables.by_force, mean, pulled), 0.0)
        return np.asarray(tension[self.cable] * left[self.point - 1])


def build_guides(cables: Cables, descriptions: Sequence[CableDescription], lengths: Array) -> Guides | None:
    """Return the guides of the cables that have friction; None: none has.

    Args:
        cables: All cables.
        descriptions: Their descriptions.
        lengths: Lengths of the segments at the start in [m], shape (p - 1,).

    Raises:
        SceneError: a cable with friction has no point between its ends.
    """
    cable, point = list[int](), list[int]()
    for c, each in enumerate(descriptions):
        if each.friction == 0.0 and each.friction_per_length == 0.0:
            continue
        between = range(int(cables.first[c]) + 1, int(cables.first[c + 1]) - 1)
        if not between:
            raise SceneError(
                f"cable {cables.names[c]}: friction acts at the points between the ends, and there are none; "
                "add points, or remove friction and friction_per_length"
            )
        cable += [c] * len(between)
        point += between
    if not point:
        return None
    of, at, segments = np.array(cable), np.array(point), np.arange(len(lengths))
    beyond = (segments >= at[:, None]) & (segments < cables.first[of + 1][:, None] - 1)
    values = np.array([[each.friction, each.friction_per_length, each.presliding] for each in descriptions])
    per_angle, per_length, presliding = values[of].T
    per_length = 0.5 * per_length * (lengths[at - 1] + lengths[at])
    tail = beyond.astype(float)
    return Guides(cables, of, at, per_angle, per_length, presliding, tail, tail @ lengths)
