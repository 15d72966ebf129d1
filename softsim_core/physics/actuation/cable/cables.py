"""Cables: lines through points of a body, pulled at one end.

The length L is the sum of the straight segments. The coordinate s = L0 - L, the cable displacement, is the
shortening relative to the rest length. Its row is H = ds/dx = -dL/dx: at each point the unit vectors towards
both neighbours, so that one tension acts in all segments. A pull-only cable enforces s >= the commanded
displacement, with a tension >= 0 that is zero where the cable is slack. A cable that stretches by c per
tension t, from its pretension t0, enforces s + c (t - t0) in place of s. With friction, t is the tension of
the first segment; what it loses at the points is in rows of their own, see guides.
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
from softsim_core.physics.actuation.cable.guides import Guides, build_guides
from softsim_core.physics.mechanics import Model, Rows, State, Transmissions

IN_BODY, IN_WORLD = -2, -1
"""Carriers of a cable's points that no joint carries."""


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
        tensions: Tension of each segment between its points in [N], shape (k - 1,); see `tension`.
    """

    length: float = 0.0
    tensions: Array = field(default_factory=lambda: np.zeros(0))

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
        return np.cross(motion.angular[k], arms) + motion.linear[k]

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
                weight = -float(forces[point] @ np.cross(angular[outer], moved[m]))
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


def _across(unit: Array) -> Array:
    """Return two unit vectors normal to each of the unit vectors (s, 3), shape (s, 2, 3)."""
    axis = np.zeros_like(unit)
    axis[np.arange(len(unit)), np.abs(unit).argmin(axis=1)] = 1.0
    first = np.cross(unit, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(unit, first)], axis=1)


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
