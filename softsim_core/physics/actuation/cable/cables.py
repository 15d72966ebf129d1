"""Cables: lines through points of a body, pulled at one end.

The length L is the sum of the straight segments. The coordinate s = L0 - L, the cable displacement, is the
shortening relative to the rest length. Its row is H = ds/dx = -dL/dx: at each point the unit vectors towards
both neighbours, so that one tension acts in all segments. A pull-only cable enforces s >= the commanded
displacement, with a tension >= 0 that is zero where the cable is slack. A cable that stretches by c per
tension t, from its pretension t0, enforces s + c (t - t0) in place of s. With friction, t is the tension of
the first segment; what it loses at the points is in rows of their own, see Guides.

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

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray, SceneError
from softsim_core.physics.actuation import (
    Actuator,
    ActuatorKind,
    ActuatorView,
    Constraints,
    GeometricStiffness,
    MeasuredSize,
    Placed,
    Surroundings,
    no_geometric_stiffness,
)
from softsim_core.physics.actuation.cable.description import CableDescription
from softsim_core.physics.mechanics import PASSIVE_EFFORTS, Model, Rows, State, Transmissions, cross

IN_BODY, IN_WORLD = -2, -1
"""Carriers of a cable's points that no joint carries."""

SMALLEST_CHANGE = 1e-9
"""Largest tension change in [N] that is left out."""


class RowLayout(NamedTuple):
    """Layout of the rows of c cables: a cable's points first, then the joints that carry outside points.

    Attributes:
        start: First entry of each row, and the end of the last row, shape (c + 1,).
        place: Node, or number of nodes + reduced coordinate, of each entry, shape (k,).
        of_points: Entries of the points, four each, shape (4 p,).
        levers: Entries of joints that carry outside points (pull points and guides), shape (m,).
        lever_points: The point of each lever, shape (m,).
        lever_unknowns: Reduced coordinate of each lever, shape (m,).
    """

    start: IndexArray
    place: IndexArray
    of_points: IndexArray
    levers: IndexArray
    lever_points: IndexArray
    lever_unknowns: IndexArray


class CableArrays(NamedTuple):
    """All cables of a scene for the compiled kernels: p points, m joints that carry outside points.

    Attributes:
        first: First point of each cable, and the end of the last cable, shape (c + 1,).
        nodes, weights: Nodes that carry each point, and their weights, shapes (p, 4).
        carrier: Joint that carries each point, or IN_WORLD or IN_BODY, shape (p,).
        local: Position in the carrier's frame in [m], shape (p, 3).
        entry: First of the four entries of each point in the rows of all cables, shape (p,).
        levers, lever_points, lever_unknowns: See RowLayout, shapes (m,).
        rest_length: Rest length in [m], shape (c,).
        points, pulls: Filled by `measure_cables`: points in [m], and H on them, shape (p, 3).
    """

    first: IndexArray
    nodes: IndexArray
    weights: Array
    carrier: IndexArray
    local: Array
    entry: IndexArray
    levers: IndexArray
    lever_points: IndexArray
    lever_unknowns: IndexArray
    rest_length: Array
    points: Array
    pulls: Array


def row_layout(
    model: Model, first: IndexArray, nodes: IndexArray, outside: Sequence[tuple[int, int, Array]]
) -> RowLayout:
    """Return the layout of cables; for the arguments see Cables."""
    count, frames = len(model.rest), 6 * len(model.frame_names)
    start, levers = [0], []
    place: list[int] = []
    of_points: list[int] = []
    for own in itertools.starmap(range, itertools.pairwise(first.tolist())):
        of_points += range(len(place), len(place) + 4 * len(own))
        place += nodes[own.start : own.stop].ravel().tolist()
        for point, carrier, _ in outside:
            if point in own and carrier >= 0:
                for unknown in (frames + a for a in model.chain(carrier)):
                    levers.append((len(place), point, unknown))
                    place.append(count + unknown)
        start.append(len(place))
    table = np.array(levers, dtype=np.int64).reshape(-1, 3)
    return RowLayout(
        np.array(start),
        np.array(place, dtype=np.int64),
        np.array(of_points, dtype=np.int64),
        *(column.copy() for column in table.T),
    )


def line_stiffness(nodes: IndexArray, weights: Array, line: Array, tension: float) -> GeometricStiffness:
    """Return the geometric stiffness of a line from a body to a fixed point: tension over length, transverse.

    Args:
        nodes: Nodes that carry the point, shape (k,).
        weights: Weights of these nodes, shape (k,).
        line: Vector from one end to the other in [m], shape (3,).
        tension: Tension in [N].
    """
    if tension == 0.0:
        return no_geometric_stiffness()
    length = float(np.linalg.norm(line))
    across = np.eye(3) - np.outer(line, line) / length**2  # three rows, of rank two
    coefficient = (weights[None, :, None] * across[:, None, :]).reshape(-1, 3)
    rows = Rows(len(nodes) * np.arange(4), np.tile(nodes, 3), coefficient)
    return GeometricStiffness(rows, np.full(3, tension / length))


@dataclass(frozen=True, slots=True, eq=False)
class CableView(ActuatorView):
    """Visible state of a cable; its points begin with the pull point if it has one.

    Attributes:
        length: Length in [m].
    """

    length: float = 0.0

    @property
    def tension(self) -> float:
        """Tension at the pulled end in [N]."""
        return self.multiplier

    @property
    def measured_size(self) -> MeasuredSize:
        """Its length in [m], which the coordinate shortens."""
        return MeasuredSize(self.length + self.value, -1.0)


class _Entries(NamedTuple):
    """Some entries of rows: their row, place and coefficient, see Rows; shapes (k,), (k,), (k, 3)."""

    row: IndexArray
    place: IndexArray
    coefficient: Array


@dataclass(frozen=True, slots=True, eq=False)
class Cables:
    """All cables of a scene; their points in sequence, each cable's pull point and guides, if any, first.

    Attributes:
        names: Names of the joints that pull them.
        joint: Indices of these joints, shape (c,).
        first: First point of each cable, and the end of the last cable, shape (c + 1,).
        nodes, weights: Nodes that carry each point, and weights, shapes (p, 4); zeros for outside points.
        outside: Pull points and guides: number of the point, its joint (or -1), and position in the joint's
            frame in [m].
        rest_length: Lengths in [m] at displacement 0, shape (c,).
        lower, upper: Bounds of the tensions in [N], shape (c,).
        by_force: Whether the command is a tension in [N] instead of a displacement in [m], shape (c,).
        compliance: Stretch per tension in [m/N], shape (c,).
        stretch: Stretch by the pretension in [m], shape (c,).
        layout: Constant part of their rows.
        passive: Friction at their points; None: they slide without friction.
        any_by_force: Whether any cable is commanded by a tension.
    """

    names: tuple[str, ...]
    joint: IndexArray
    first: IndexArray
    nodes: IndexArray
    weights: Array
    outside: tuple[tuple[int, int, Array], ...]
    rest_length: Array
    lower: Array
    upper: Array
    by_force: BoolArray
    compliance: Array
    stretch: Array
    layout: RowLayout
    passive: Guides | None = None
    any_by_force: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "any_by_force", bool(self.by_force.any()))

    @property
    def constraints(self) -> Constraints:
        """The constant part of the cables' constraint rows: joints, entries and control mode."""
        return Constraints(self.joint, self.layout.start, self.layout.place, self.by_force)

    def values(self, model: Model, state: State) -> Array:
        """Return the displacements in [m], shape (c,)."""
        return np.asarray(self.rest_length - self.lengths(self.points(model, state)))

    def bounds(self, commands: Array) -> tuple[Array, Array]:
        """Return the bounds of the tensions in [N], shapes (c,), under the commands of the cables (c,)."""
        if not self.any_by_force:
            return self.lower, self.upper
        clamped = np.clip(commands, self.lower, self.upper)
        return np.where(self.by_force, clamped, self.lower), np.where(self.by_force, clamped, self.upper)

    def transmissions(self, commands: Array, multipliers: Array) -> Transmissions:
        """Return the transmissions of all cables: bounds from the commands, unit gain."""
        shortened = commands + self.stretch
        return Transmissions(
            shortened, self.compliance.copy(), *self.bounds(commands), np.ones(len(commands))
        )

    def commands_of(self, values: Array, multipliers: Array) -> Array:
        """Return the commands at rest: multipliers in force control, else coordinates, shape (c,)."""
        shortened = values + self.compliance * multipliers - self.stretch
        return np.where(self.by_force, multipliers, shortened)

    def keeping(self) -> list[tuple[int, Actuator]]:
        """Return an empty list: cables have no internal state."""
        return []

    def points(self, model: Model, state: State) -> Array:
        """Return all points in [m], shape (p, 3)."""
        points = np.asarray(np.einsum("pk,pki->pi", self.weights, state.positions[self.nodes]))
        frames: dict[int, tuple[Array, Array]] = {}
        for point, joint, local in self.outside:
            if joint >= 0 and joint not in frames:
                frames[joint] = model.joint_frame(joint, state)
            points[point] = frames[joint][0] + frames[joint][1] @ local if joint >= 0 else local
        return points

    def directions(self, points: Array) -> tuple[Array, Array]:
        """Return unit vectors and lengths in [m] of the segments after each point; 0 between cables."""
        along = points[1:] - points[:-1]
        along[self.first[1:-1] - 1] = 0.0
        length = np.sqrt(np.einsum("pi,pi->p", along, along))
        return along / np.maximum(length, 1e-12)[:, None], length

    def lengths(self, points: Array) -> Array:
        """Return the length of each cable in [m], shape (c,), with its points at (p, 3)."""
        return np.asarray(np.add.reduceat(self.directions(points)[1], self.first[:-1]))

    def pulls(self, points: Array) -> Array:
        """Return H on the points, shape (p, 3): the force on each per unit of tension."""
        unit, _ = self.directions(points)
        pulls = np.zeros_like(points)
        pulls[:-1] = unit
        pulls[1:] -= unit
        return pulls

    def coefficients(self, model: Model, state: State) -> Array:
        """Return the entries of the rows, shape (k, 3)."""
        points = self.points(model, state)
        return self.spread(model, state, points, self.pulls(points))

    def entry_points(self) -> IndexArray:
        """Return the point of each entry of the rows, shape (k,)."""
        layout, result = self.layout, np.zeros(len(self.layout.place), dtype=np.int64)
        result[layout.of_points] = np.repeat(np.arange(len(self.nodes)), 4)
        result[layout.levers] = layout.lever_points
        return result

    def spread(self, model: Model, state: State, points: Array, pulls: Array) -> Array:
        """Return vectors on the points (p, 3) as entries of the rows, shape (k, 3); see `pulls`."""
        layout, coefficient = self.layout, np.zeros((len(self.layout.place), 3))
        coefficient[layout.of_points] = (self.weights[:, :, None] * pulls[:, None, :]).reshape(-1, 3)
        if len(layout.levers):
            moved = self.outside_motion(model, state, points)
            coefficient[layout.levers, 0] = np.einsum("mi,mi->m", pulls[layout.lever_points], moved)
        return coefficient

    def outside_motion(self, model: Model, state: State, points: Array) -> Array:
        """Return the velocity of outside points per unit velocity of each joint that carries them, (m, 3)."""
        motion, k = model.motion_subspace(state), self.layout.lever_unknowns
        arms = points[self.layout.lever_points] - motion.origin[k]
        return cross(motion.angular[k], arms) + motion.linear[k]

    def tensions(self, state: State, multipliers: Array) -> Array:
        """Return the tension of the segment after each point in [N], 0 between cables, shape (p - 1,).

        `multipliers` (c,) are the tensions of the first segments.
        """
        tension = np.repeat(multipliers, np.diff(self.first))[:-1]
        tension[self.first[1:-1] - 1] = 0.0
        if self.passive is not None:
            tension += self.passive.tension_changes(state)
        return np.asarray(tension)

    def geometric_stiffness(
        self, model: Model, state: State, multipliers: Array, without_surfaces: bool = False
    ) -> GeometricStiffness:
        """Return two rows across each segment under tension, and rows for joints that rotate outside points.

        A segment of length l under tension t resists rotation with the transverse stiffness t / l. An outside
        point p with the force f on revolute joints of angles q adds -f d2p/dq2 to them.
        """
        points = self.points(model, state)
        unit, length = self.directions(points)
        tension = self.tensions(state, multipliers)
        taut = np.flatnonzero(tension * length)
        forces = np.zeros_like(points)
        forces[:-1] += tension[:, None] * unit
        forces[1:] -= tension[:, None] * unit
        turning = self._turning(model, state, points, forces)
        entries = list(self._across(model, state, points, taut, unit[taut]))
        for r, (turned, signs, _) in enumerate(turning, start=2 * len(taut)):
            coefficients = np.outer(signs, [1.0, 0.0, 0.0])
            entries.append(_Entries(np.full(len(turned), r), np.array(turned), coefficients))
        row, places, coefficient = (np.concatenate(each) for each in zip(*entries, strict=True))
        order = np.argsort(row, kind="stable")
        start = np.searchsorted(row[order], np.arange(2 * len(taut) + len(turning) + 1))
        stiffness = np.repeat(tension[taut] / length[taut], 2)
        return GeometricStiffness(
            Rows(start, places[order], coefficient[order]),
            np.concatenate([stiffness, [weight for *_, weight in turning]]),
        )

    def _across(
        self, model: Model, state: State, points: Array, taut: IndexArray, unit: Array
    ) -> Iterator[_Entries]:
        """Yield the entries of two rows across each of the segments `taut` (s,) of directions (s, 3)."""
        across, both = _across(unit), 2 * np.arange(len(taut))[:, None] + np.arange(2)
        for ahead, sign in ((1, 1.0), (0, -1.0)):  # at the ends, then at the beginnings of segments
            weights, nodes = self.weights[taut + ahead], self.nodes[taut + ahead]
            s, k = np.nonzero(weights)
            coefficient = sign * weights[s, k][:, None, None] * across[s]
            yield _Entries(both[s].ravel(), np.repeat(nodes[s, k], 2), coefficient.reshape(-1, 3))
        layout, moved = self.layout, self.outside_motion(model, state, points)
        for m, point in enumerate(layout.lever_points):
            for before, sign in ((1, 1.0), (0, -1.0)):  # the segments that end and begin there
                for segment in np.flatnonzero(taut == point - before):
                    coefficient = np.zeros((2, 3))
                    coefficient[:, 0] = sign * across[segment] @ moved[m]
                    unknown = len(model.rest) + layout.lever_unknowns[m]
                    yield _Entries(both[segment], np.full(2, unknown), coefficient)

    def _turning(
        self, model: Model, state: State, points: Array, forces: Array
    ) -> list[tuple[list[int], list[float], float]]:
        """Return -f d2p/dq2 of the joints that rotate outside points: places, their signs, and the weight.

        The outer joint rotates the inner motion. Two joints contribute by their sum and their difference.
        `forces` are those of the cables on all points in [N], shape (p, 3).
        """
        result: list[tuple[list[int], list[float], float]] = []
        layout = self.layout
        if not len(layout.levers):
            return result
        angular = model.motion_subspace(state).angular
        moved, count = self.outside_motion(model, state, points), len(model.rest)
        for m, (inner, point) in enumerate(zip(layout.lever_unknowns, layout.lever_points, strict=True)):
            for outer in layout.lever_unknowns[: m + 1][layout.lever_points[: m + 1] == point]:
                weight = -float(forces[point] @ cross(angular[outer], moved[m]))
                places = [count + int(outer), count + int(inner)]
                if outer == inner:
                    result.append((places[:1], [1.0], weight))
                else:  # a b + b a = ((a + b)^2 - (a - b)^2) / 2
                    result.append((places, [1.0, 1.0], 0.5 * weight))
                    result.append((places, [1.0, -1.0], -0.5 * weight))
        return [each for each in result if each[2] != 0.0]

    def surfaces(self) -> list[IndexArray]:
        """Return an empty list: cables press on no surface."""
        return []

    def surface_stiffness(self, state: State, multipliers: Array) -> list[Array]:
        """Return an empty list: cables press on no surface."""
        return []

    def views(self, model: Model, state: State, multipliers: Array) -> tuple[CableView, ...]:
        """Return the visible state of each cable at tensions (c,) in [N]."""
        points = self.points(model, state)
        lengths, outside = self.lengths(points), {point for point, _, _ in self.outside}
        tensions = self.tensions(state, multipliers)
        return tuple(
            CableView(
                name=name,
                kind="cable",
                points=points[self.first[c] : self.first[c + 1]],
                value=float(self.rest_length[c] - lengths[c]),
                multiplier=float(multipliers[c]),
                pulled_from_outside=int(self.first[c]) in outside,
                length=float(lengths[c]),
                tensions=tensions[self.first[c] : self.first[c + 1] - 1],
            )
            for c, name in enumerate(self.names)
        )

    def to_arrays(self) -> CableArrays:
        """Return the cables for the compiled kernels."""
        layout, points = self.layout, len(self.nodes)
        carrier, local = np.full(points, IN_BODY), np.zeros((points, 3))
        for point, joint, offset in self.outside:
            carrier[point], local[point] = (joint if joint >= 0 else IN_WORLD), offset
        return CableArrays(
            first=self.first,
            nodes=self.nodes,
            weights=self.weights,
            carrier=carrier,
            local=local,
            entry=layout.of_points[::4].copy(),
            levers=layout.levers,
            lever_points=layout.lever_points,
            lever_unknowns=layout.lever_unknowns,
            rest_length=self.rest_length,
            points=np.zeros((points, 3)),
            pulls=np.zeros((points, 3)),
        )


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
    def memory_size(self) -> int:
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

    def transmissions(self, model: Model, state: State, memory: Array) -> Transmissions:
        """Return the law of each guide, linearised at a state; see PassiveRows."""
        cables = self.cables
        unit, lengths = cables.directions(cables.points(model, state))
        shares, slid = self._shares(lengths, memory)
        loss = self._losses(unit)
        left = np.exp(-loss * shares)
        before = self._tensions_before(state, np.exp(-(loss * shares) @ self.beyond), lengths)
        resisting = before * loss > SMALLEST_CHANGE
        compliance = np.zeros(len(self.point))
        stiffness = (before * loss * left / self.presliding)[resisting]
        compliance[resisting] = 1.0 / stiffness
        force = np.where(resisting, before * (left - 1.0), 0.0)
        acting = np.where(resisting, before, 0.0)
        lower, upper = acting * np.expm1(-loss), acting * np.expm1(loss)
        return Transmissions(slid + compliance * force, compliance, lower, upper, np.zeros_like(compliance))

    def remember(self, model: Model, state: State, memory: Array) -> None:
        """Write z and s at the end of a motion into `memory`."""
        _, lengths = self.cables.directions(self.cables.points(model, state))
        memory[: len(self.point)] = self._shares(lengths, memory)[0]
        memory[len(self.point) :] = self.at_rest - self.beyond @ lengths

    def tension_changes(self, state: State) -> Array:
        """Return the sum of the tension changes before each segment in [N], shape (p - 1,)."""
        return np.asarray(state.extra[PASSIVE_EFFORTS] @ self.beyond)

    def _shares(self, lengths: Array, memory: Array) -> tuple[Array, Array]:
        """Return z, and s at which it is reached first in [m], shapes (m,), with segments of `lengths`."""
        began, place = memory.reshape(2, -1)
        moved = self.at_rest - self.beyond @ lengths - place
        shares = np.clip(began + moved / self.presliding, -1.0, 1.0)
        return shares, place + self.presliding * (shares - began)

    def _losses(self, unit: Array) -> Array:
        """Return l of each guide, with segments in the directions `unit` (p - 1, 3)."""
        before, after = unit[self.point - 1], unit[self.point]
        sine = np.linalg.norm(cross(before, after), axis=1)
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


def _across(unit: Array) -> Array:
    """Return two unit vectors normal to each of the unit vectors (s, 3), shape (s, 2, 3)."""
    axis = np.zeros_like(unit)
    axis[np.arange(len(unit)), np.abs(unit).argmin(axis=1)] = 1.0
    first = cross(unit, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, cross(unit, first)], axis=1)


def build_cables(placed: Sequence[Placed], surroundings: Surroundings) -> Cables:
    """Return all cables of a scene.

    Raises:
        SceneError: a point is outside its body, or all points of a cable coincide.
        ConfigError: a file of points cannot be read.
    """
    model = surroundings.model
    start = model.rest_state()
    nodes, weights, first, outside = [], [], [0], []
    descriptions: list[CableDescription] = [each.description for each in placed]
    for each, cable in zip(placed, descriptions, strict=True):
        bound = surroundings.bind(
            f"cable {each.name}", cable.body, cable.points_in(surroundings.meshes[cable.body])
        )
        if cable.pull_point is not None:
            on = -1 if cable.pull_on is None else surroundings.joint(cable.pull_on)
            places: Array = np.array([cable.pull_point, *cable.guides], dtype=float)
            if on >= 0:
                origin, rotation = model.joint_frame(on, start)
                places = (places - origin) @ rotation
            outside += [(first[-1] + k, on, each) for k, each in enumerate(places)]
            nodes.append(np.zeros((len(places), 4), dtype=np.int64))
            weights.append(np.zeros((len(places), 4)))
        nodes.append(bound.nodes)
        weights.append(bound.weights)
        first.append(sum(len(points) for points in nodes))
    ends, carried = np.array(first), np.concatenate(nodes)
    result = Cables(
        names=tuple(each.name for each in placed),
        joint=np.array([each.joint for each in placed], dtype=np.int64),
        first=ends,
        nodes=carried,
        weights=np.concatenate(weights),
        outside=tuple(outside),
        rest_length=np.array([each.rest_length or np.nan for each in descriptions], dtype=float),
        lower=np.array([0.0 if each.pull_only else -np.inf for each in descriptions]),
        upper=np.array([each.max_tension or np.inf for each in descriptions]),
        by_force=np.array([each.control == "force" for each in descriptions], dtype=np.bool_),
        compliance=np.array([each.compliance for each in descriptions], dtype=float),
        stretch=np.zeros(len(descriptions)),
        layout=row_layout(model, ends, carried, outside),
    )
    lengths = result.lengths(result.points(model, start))
    if not lengths.all():
        raise SceneError(
            f"cable {result.names[int(np.argmin(lengths))]}: all its points coincide; move them apart"
        )
    defined = ~np.isnan(result.rest_length)
    result.rest_length[~defined] = lengths[~defined]
    result.compliance[:] += result.rest_length / [each.axial_stiffness or np.inf for each in descriptions]
    result.stretch[:] = result.compliance * [each.pretension for each in descriptions]
    _, segments = result.directions(result.points(model, start))
    return replace(result, passive=build_guides(result, descriptions, segments))


CABLE: Final[ActuatorKind] = ActuatorKind("cable", CableDescription, build_cables)
