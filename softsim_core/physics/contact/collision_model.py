"""Collision surfaces of a scene: positions and displacements of their vertices, and pairs that are close."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.contact.compile import kernel
from softsim_core.physics.contact.detection import Closeness, Detector, Proximities
from softsim_core.physics.contact.rows import NODES, Carried
from softsim_core.physics.contact.settings import ContactLimits
from softsim_core.physics.contact.surfaces import CollisionSurface
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.mechanics import Carrier, Model, MotionSubspace, State, rotation_exp, rotation_log

_SHORTFALL = 0.9e-3
"""Share of the contact distance by which a gap may fall short of it at the end of a step; see _TOLERANCES."""
_TOLERANCES = 5.0
"""Alternative limit to _SHORTFALL in tolerances of the contact solver; the larger one counts."""
_CLOSE = 1.02
"""Contacts closer than this many contact distances take part in a step, local minimum or not."""
_STRAY = 1.0e-4
"""Share of the contact distance by which a linearised gap may close although the true gap does not."""
_ASTRAY = 0.1
"""The same share for a contact that bears a force; above it, the step is linearised again at its end."""
_SPARE = 0.05
"""Share of the alarm distance added to the expected travel of a surface in the next step."""


@kernel
def longest_of_each(vectors: Array, first: IndexArray) -> Array:
    """Return the length of the longest vector of each group (s,); group s of (v, 3) begins at first[s]."""
    result = np.empty(len(first))
    for s in range(len(first)):
        end = first[s + 1] if s + 1 < len(first) else len(vectors)
        most = 0.0
        for v in range(first[s], end):
            square = vectors[v, 0] ** 2 + vectors[v, 1] ** 2 + vectors[v, 2] ** 2
            if not square <= most:  # also takes NaN
                most = square
        result[s] = math.sqrt(most)
    return result


@kernel
def interpolate_vertices(soft: IndexArray, carried: Carried, nodal: Array, scale: float, out: Array) -> None:
    """Write `scale` times the interpolated nodal vectors (n, 3) of the soft vertices into `out` (v, 3)."""
    for v in soft:
        for i in range(3):
            total = 0.0
            for k in range(NODES):
                weight = carried.weights[v, k]
                if weight != 0.0:
                    total += weight * nodal[carried.nodes[v, k], i]
            out[v, i] = scale * total


@kernel
def smallest_gap(pair: IndexArray, distance: Array, parts: BoolArray, most: float) -> float:
    """Return the smallest distance in [m] of the pairs of surfaces with one of `parts` (s,), or `most`."""
    least = most
    for c in range(len(distance)):
        if parts[pair[c, 0]] or parts[pair[c, 1]]:
            least = min(least, distance[c])
    return least


_longest, _interpolate, _smallest_gap = (
    OneSignature(each) for each in (longest_of_each, interpolate_vertices, smallest_gap)
)


@dataclass(frozen=True, slots=True, eq=False)
class VertexCarrier(Carrier):
    """Carrier of collision vertices that do not belong to a deformable body.

    Attributes:
        vertices: Range of collision vertices.
        local: Positions in the carrier's frame in [m], shape (k, 3).
    """

    vertices: slice
    local: Array


class Place(NamedTuple):
    """Configuration of all collision vertices after some share of a step.

    Attributes:
        state: State at that moment.
        points: Collision vertices in [m], shape (v, 3).
        moved: Displacement of the vertices since the start of the step in [m], shape (v, 3).
        turned: Displacement in [m] and rotation vector in [rad] of the free rigid bodies since the start, as
            if their velocities had been constant, shape (r, 6).
    """

    state: State
    points: Array
    moved: Array
    turned: Array


class LastDetection(NamedTuple):
    """Configuration at which detection last ran, and its result.

    Attributes:
        buffer: State at that moment: the bytes of State.buffer.
        place: The configuration.
        travel: Travel that was assumed for each surface from there on, in [m], shape (s,).
        near: Contacts that were found.
        motion_subspace: Motion subspace of the reduced coordinates; None where they carry no surface.
    """

    buffer: bytes
    place: Place
    travel: Array
    near: Proximities
    motion_subspace: MotionSubspace | None


class Turning(NamedTuple):
    """A surface that rotates with a rigid body, a frame or joints.

    Attributes:
        surface: Number of the surface.
        rigid: Number of the free rigid body, or -1.
        reduced: Reduced coordinates that move it.
        corner: First vertex of the surface.
        radius: Largest distance in [m] of its vertices from the body's centre, or from `corner`.
    """

    surface: int
    rigid: int
    reduced: list[int]
    corner: int
    radius: float


class CollisionModel:
    """Collision surfaces of a scene, with the carriers of their vertices.

    Args:
        surfaces: The surfaces, over one array of vertices.
        settings: Distances and tolerance.
        nodes, weights: Nodes that carry each vertex, and weights, (v, 4) each; zeros for vertices of a
        carrier.
        carriers: Carriers of the other vertices.
        model: The model they belong to.
        friction: Coulomb coefficient of each pair of surfaces, shape (s, s).
        body_names: Names of the bodies, in the numbering of the surfaces' `owner`.

    Attributes:
        carried: Carrier of each vertex, as arrays.
        soft: Vertices that nodes carry, shape (k,).
        moving: Whether frames or joints carry surfaces.
        owner: Number of the body of each surface, shape (s,).
        still: Displacement of vertices that do not move: zeros, shape (v, 3).
        size: Diagonal of the box around all surfaces at rest in [m].
        least_gap: Smallest gap in [m] that is allowed anywhere at the end of a step.
    """

    def __init__(
        self,
        surfaces: tuple[CollisionSurface, ...],
        settings: ContactLimits,
        nodes: IndexArray,
        weights: Array,
        carriers: tuple[VertexCarrier, ...],
        model: Model,
        friction: Array,
        body_names: tuple[str, ...],
    ) -> None:
        self.surfaces, self.settings, self.carriers, self.model = surfaces, settings, carriers, model
        self.friction, self.body_names = friction, body_names
        self.owner = np.array([each.owner for each in surfaces], dtype=np.int64)
        self.soft = np.flatnonzero(weights.any(axis=1))
        self.carried = _stack_carriers(surfaces, nodes, weights, carriers, model)
        self.moving = any(each.list_reduced_coordinates(model) for each in carriers)
        shortfall = max(_SHORTFALL * settings.contact_distance, _TOLERANCES * settings.tolerance)
        self.least_gap = settings.contact_distance - shortfall
        self._falling = np.flatnonzero(self.carried.rigid >= 0)
        distance = settings.contact_distance
        self._closeness = Closeness(settings.alarm_distance, distance, _CLOSE * distance, _STRAY * distance)
        self._first = np.array([each.vertices.start for each in surfaces], dtype=np.int64)
        self.still = np.zeros((len(nodes), 3))
        self._fixed = self.still.copy()
        for each in carriers:
            self._fixed[each.vertices] = each.local
        movable = [each for each in carriers if max(each.rigid, each.frame, each.joint, each.base) >= 0]
        on_ground = [each for each in movable if each.base >= 0 and not each.list_reduced_coordinates(model)]
        self._on_ground = tuple(on_ground)  # moves only when its base is moved
        self._bases = b""
        self._movable = tuple(each for each in movable if each not in on_ground)
        self._spheres = tuple(each for each in carriers if self.carried.radius[each.vertices].any())
        start = self.points(model.rest_state())
        self._detector = Detector(surfaces, start, settings)
        self.size = float(np.linalg.norm(np.ptp(start, axis=0)))
        self._parts = np.array([self._yields(each) for each in surfaces])
        self._parted = self._parts[self._detector.pairs].any(axis=1)
        self._spare = np.where([each.moving for each in surfaces], _SPARE * settings.alarm_distance, 0.0)
        self._drop = model.dt**2 * model.gravity
        self._fall = model.dt * float(np.linalg.norm(model.gravity))
        self._turning = tuple(
            _turning(s, each, model)
            for s, surface in enumerate(surfaces)
            for each in self._movable
            if each.vertices.start == surface.vertices.start
        )
        self._last: LastDetection | None = None

    def of_another_copy(self) -> CollisionModel:
        """Return the same surfaces for another copy of the scene; both share the detector's buffers."""
        other = copy(self)
        other._fixed, other._bases, other._last = self._fixed.copy(), b"", None
        return other

    # --- positions ---

    def points(self, state: State) -> Array:
        """Return the positions of the collision vertices in [m], shape (v, 3)."""
        if self._on_ground:
            self._follow_bases(state)
        points = self._fixed.copy()
        _interpolate(self.soft, self.carried, state.positions, 1.0, points)
        for carrier in self._movable:
            origin, rotation = carrier.pose(self.model, state)
            points[carrier.vertices] = origin + carrier.local @ rotation.T
        return points

    def _follow_bases(self, state: State) -> None:
        """Update the vertices of carriers on bases that stand on the ground, if a base has moved."""
        bases = state.base_positions.tobytes() + state.base_shift.tobytes()
        if bases == self._bases:
            return
        self._bases = bases
        for carrier in self._on_ground:
            origin, rotation = carrier.pose(self.model, state)
            self._fixed[carrier.vertices] = origin + carrier.local @ rotation.T

    def start(self, before: State) -> Place:
        """Return the configuration at the start of a step; usually this is the end of the previous step."""
        last, still = self._last, np.zeros_like(before.rigid_velocities)
        if last is not None and last.buffer == before.buffer.tobytes():
            return Place(before, last.place.points, self.still, still)
        return Place(before, self.points(before), self.still, still)

    def end(self, start: Place, state: State) -> Place:
        """Return the configuration at the end of a step from `start` to `state`.

        The rigid bodies' positions in `state` need not be final; their rotation follows from the velocities.
        """
        points = self.points(state)
        turned = self.model.dt * state.rigid_velocities
        return Place(state, points, points - start.points, turned)

    def motion_subspace(self, place: Place) -> MotionSubspace | None:
        """Return the motion subspace of the reduced coordinates; None where they carry no surface."""
        if not self.moving:
            return None
        last = self._last
        if last is not None and last.place.points is place.points:
            return last.motion_subspace
        return self.model.motion_subspace(place.state)

    def between(self, start: Place, end: Place, share: float) -> Place:
        """Return the configuration after a share of the step from `start` to `end`."""
        a, b, model = start.state, end.state, self.model
        state = model.empty_state()
        state.buffer[:] = a.buffer + share * (b.buffer - a.buffer)
        for f, rotation in enumerate(a.frame_rotations):
            turn = rotation_log(b.frame_rotations[f] @ rotation.T)
            state.frame_rotations[f] = rotation_exp(share * turn) @ rotation
        if model.rigid.names:
            state.rigid_velocities[:] = end.turned / model.dt
            model.rigid.advance(state, a, share * model.dt)
        points = self.points(state)
        return Place(state, points, points - start.points, share * end.turned)

    def _farthest(self, moved: Array) -> Array:
        """Return the longest displacement of a vertex of each surface in [m], shape (s,)."""
        return np.asarray(_longest(moved, self._first))

    # --- proximity ---

    def near(self, points: Array, reach: float) -> Proximities:
        """Return the contacts closer than `reach` [m] of surfaces with vertices at `points` (v, 3)."""
        return self._detector.detect(points, reach)

    def at_start(self, start: Place, free: Place) -> tuple[Proximities, Array]:
        """Return the contacts of a step that leads from `start` to `free` if there is no contact force.

        Also return the displacement of the vertices in the step at their initial velocities in [m], shape (v,
        3); vertices on frames and joints have their free displacement.
        """
        last = self._last
        if last is None or last.place.points is not start.points:
            last = self._last = self._run_detection(start)
        needed = free.moved.copy()
        _interpolate(self.soft, self.carried, start.state.velocities, self.model.dt, needed)
        farther, near = self._farthest(needed), last.near
        if (farther > last.travel).any():
            travel = np.maximum(farther, last.travel)
            near = self._detector.candidates(start.points, self.settings.alarm_distance, travel)
        needed[self._falling] -= self._drop
        return near, needed

    def at_end(self, end: Place) -> Proximities:
        """Return the contacts at the end of a step, including those that may close in the next one."""
        self._last = self._run_detection(end)
        return self._last.near

    def at(self, place: Place, free: Place, end: Place) -> Proximities:
        """Return the contacts at a configuration within a step that continues to `free` and to `end`."""
        ways = self._farthest(free.points - place.points), self._farthest(end.points - place.points)
        return self._detector.candidates(place.points, self.settings.alarm_distance, np.maximum(*ways))

    def again(self, keys: IndexArray, place: Place, edges_only: bool) -> Proximities:
        """Return earlier contacts (keys (k,)) at their current closest points; see Detector.again."""
        return self._detector.again(keys, place.points, edges_only)

    def may_hold(
        self,
        near: Proximities,
        earlier: IndexArray,
        at: Place,
        ahead: Array,
        slides: Array | None,
        *,
        first: bool,
    ) -> tuple[BoolArray, int]:
        """Return which contacts take part in a step, shape (k,), and the number of earlier ones among them.

        Contacts whose gaps close only because they are linearised far from the end are left out. If one of
        them is too close at the end, the step is linearised there again and includes it.

        Args:
            near: Contacts at the configuration.
            earlier: Keys of contacts that take part in any case, ascending, shape (w,).
            at: Configuration about which the step is linearised.
            ahead: Displacement of the vertices from there without contact in [m], shape (v, 3).
            slides: Displacement from there to the end found last in [m], shape (v, 3); None: the
                configuration is that end.
            first: Whether the configuration is the start of the step.
        """
        strays, way = slides is not None, at.moved if slides is None else slides
        return self._detector.may_hold(near, earlier, at.points, ahead, way, self._closeness, strays, first)

    def any_astray(self, active: Proximities, forces: Array, at: Place, end: Place) -> bool:
        """Return whether a contact bore a force although its bodies had slid past each other by the end.

        `forces` (k, 3) in [N] are those of the `active` contacts along their normals and two tangents.
        """
        limit = _ASTRAY * self.settings.contact_distance
        return self._detector.any_astray(active, forces, at.points, end.points - at.points, limit)

    def free_share(self, start: Place, end: Place) -> float:
        """Return the share of the motion from `start` to `end` without passing through a surface."""
        farthest = self._farthest(end.moved)
        if 2.0 * farthest.max(initial=0.0) <= self.least_gap:  # no pair comes closer by more than this
            return 1.0
        travel = farthest[self._detector.pairs].sum(axis=1)
        watched = self._parted & (travel > self.least_gap)
        if not watched.any():
            return 1.0
        return self._detector.free_share(start.points, end.points, watched)

    def clearance(self, near: Proximities) -> float:
        """Return the smallest gap in [m] of surfaces that a force can part, at most the alarm distance."""
        return float(_smallest_gap(near.pair, near.distance, self._parts, self.settings.alarm_distance))

    def _run_detection(self, place: Place) -> LastDetection:
        """Run detection at a configuration, with a margin for the next step at about the current speed."""
        motion_subspace = self.motion_subspace(place)
        travel = self._bound_travel(place, motion_subspace)
        near = self._detector.candidates(place.points, self.settings.alarm_distance, travel)
        return LastDetection(place.state.buffer.tobytes(), place, travel, near, motion_subspace)

    def _bound_travel(self, place: Place, motion_subspace: MotionSubspace | None) -> Array:
        """Return a bound on the travel of each surface's vertices in the next step in [m], shape (s,).

        It depends on the state only (velocities and the size of rotating surfaces), so that it is the same at
        the end of a step and at the start of the next one.
        """
        state, h = place.state, self.model.dt
        travel = np.zeros(len(self.surfaces))
        if len(self.soft):
            ways = self.still.copy()
            _interpolate(self.soft, self.carried, state.velocities, h, ways)
            travel = self._farthest(ways)
        for turning in self._turning:
            if turning.rigid >= 0:
                x, y, z, a, b, c = state.rigid_velocities[turning.rigid].tolist()
                spin = turning.radius * math.sqrt(a * a + b * b + c * c)
                travel[turning.surface] = h * (self._fall + math.sqrt(x * x + y * y + z * z) + spin)
            elif motion_subspace is not None:
                corner = place.points[turning.corner]
                for b in turning.reduced:
                    pace = h * abs(float(state.reduced_velocities[b]))
                    if pace > 0.0:
                        arm = math.dist(corner, motion_subspace.origin[b]) + turning.radius
                        turn = math.hypot(*motion_subspace.angular[b])
                        slide = math.hypot(*motion_subspace.linear[b])
                        travel[turning.surface] += pace * (turn * arm + slide)
        return travel + self._spare

    # --- motion ---

    def compute_rolling(self, start: Place, place: Place) -> Array:
        """Return radius times rotation vector of spheres since the start in [m], else zeros, shape (v, 3)."""
        rolled = self.still
        if not self._spheres:
            return rolled
        rolled = rolled.copy()
        for carrier in self._spheres:
            if carrier.rigid >= 0:  # not from matrices: it may turn by more than half a turn
                turn = place.turned[carrier.rigid, 3:]
            else:
                now, then = (carrier.pose(self.model, each.state)[1] for each in (place, start))
                turn = rotation_log(now @ then.T)
            rolled[carrier.vertices] = self.carried.radius[carrier.vertices][:, None] * turn
        return rolled

    def _yields(self, surface: CollisionSurface) -> bool:
        """Return whether a force can move a surface: it deforms, or its carrier is free or compliant."""
        if surface.soft:
            return surface.moving
        model = self.model
        carrier = next(each for each in self.carriers if each.vertices.start == surface.vertices.start)
        if carrier.rigid >= 0 or carrier.frame >= 0:
            return True
        joints = [b - 6 * len(model.frame_names) for b in carrier.list_reduced_coordinates(model)]
        return any(model.joints[j].stiffness is not None for j in joints)


def _stack_carriers(
    surfaces: tuple[CollisionSurface, ...],
    nodes: IndexArray,
    weights: Array,
    carriers: tuple[VertexCarrier, ...],
    model: Model,
) -> Carried:
    """Return the carrier of each vertex, as arrays."""
    count = len(nodes)
    widest = max((len(carrier.list_reduced_coordinates(model)) for carrier in carriers), default=0)
    radius, rigid, reduced = np.zeros(count), np.full(count, -1), np.full((count, max(widest, 1)), -1)
    for surface in surfaces:
        radius[surface.vertices] = surface.radius
    for carrier in carriers:
        rigid[carrier.vertices] = carrier.rigid
        unknowns = carrier.list_reduced_coordinates(model)
        reduced[carrier.vertices, : len(unknowns)] = unknowns
    return Carried(weights.any(axis=1), nodes, weights, radius, rigid, reduced)


def _turning(surface: int, carrier: VertexCarrier, model: Model) -> Turning:
    """Return a rotating surface and the coordinates that move it."""
    centre = np.zeros(3) if carrier.rigid >= 0 else carrier.local[0]
    radius = float(np.linalg.norm(carrier.local - centre, axis=1).max())
    return Turning(
        surface, carrier.rigid, carrier.list_reduced_coordinates(model), carrier.vertices.start, radius
    )
