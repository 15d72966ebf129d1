"""Contacts of a scene: where collision surfaces are, what touches, and the rows of what touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.detection import Detector, Proximities
from softsim_core.contact.frames import contact_frames
from softsim_core.contact.rows import MOST_ENTRIES, Carried, contact_rows
from softsim_core.contact.surfaces import CollisionSurface
from softsim_core.dynamics.rows import Rows
from softsim_core.mechanics.model import Model, Screws
from softsim_core.mechanics.pose import rotation_log
from softsim_core.mechanics.state import MEMORY, State
from softsim_core.scene.objects import ContactSettings

KEYS = 1 << 52
"""Keys of contacts are kept below this, so that a float64 holds them."""


NO_SCREWS = Screws(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class Carrier:
    """What carries collision vertices that no deformable body carries.

    Attributes:
        vertices: Range of collision vertices.
        local: Positions in the carrier's frame in [m], shape (k, 3).
        rigid: Number of the free rigid body, or -1.
        frame: Number of the free frame, or -1.
        joint: Number of the joint that moves it, or -1.
        base: Number of the joint whose base it is, or -1; all four -1: the world.
    """

    vertices: slice
    local: Array
    rigid: int = -1
    frame: int = -1
    joint: int = -1
    base: int = -1


@dataclass(frozen=True, slots=True, eq=False)
class Touching:
    """Contacts of one step: three rows each, along the normal and two tangents.

    Attributes:
        rows: On nodes and border unknowns, 3 k rows.
        on_rigid: On velocities and spins of the rigid bodies, shape (3 k, 6 r).
        gap: After free motion: the gap beyond the contact distance, then the slip, in [m], shape (3 k,).
        directions: Normal and tangents, shape (k, 3, 3).
        points: Middle of each contact in [m], shape (k, 3).
        pairs: Numbers of the two surfaces, shape (k, 2).
        keys: What touches, shape (k,).
        vertices: Positions of the collision vertices at the start of the step in [m], shape (v, 3).
        travel: How far those of each surface were taken to move in the step, in [m], shape (s,).
    """

    rows: Rows
    on_rigid: Array
    gap: Array
    directions: Array
    points: Array
    pairs: IndexArray
    keys: Array
    vertices: Array
    travel: Array

    def __len__(self) -> int:
        return len(self.keys)

    def remembered(self, memory: Array) -> Array:
        """Forces (3 k,) in [N] to start from: those of the same contacts in State.memory."""
        start = np.zeros((len(self), 3))
        if len(memory) and len(self):
            place = np.minimum(np.searchsorted(memory[:, 0], self.keys), len(memory) - 1)
            known = memory[place, 0] == self.keys
            start[known] = memory[place[known], 1:]
        return start.ravel()

    def memory(self, forces: Array) -> Array:
        """State.memory of this step's forces (3 k,) in [N], sorted by key."""
        rows = np.column_stack([self.keys, forces.reshape(-1, 3)])
        return rows[np.argsort(self.keys, kind="stable")]


class Contacts:
    """The collision surfaces of a scene, and what carries their vertices.

    Args:
        surfaces: The surfaces, over one array of vertices.
        settings: Distances and friction.
        nodes, weights: Nodes that carry each vertex, and weights; zeros where a carrier does, (v, 4) each.
        carriers: What carries the other vertices.
    """

    def __init__(
        self,
        surfaces: tuple[CollisionSurface, ...],
        settings: ContactSettings,
        nodes: IndexArray,
        weights: Array,
        carriers: tuple[Carrier, ...],
        model: Model,
    ) -> None:
        self.surfaces, self.settings, self.carriers = surfaces, settings, carriers
        self._soft = np.flatnonzero(weights.any(axis=1))
        self._nodes, self._weights = nodes[self._soft], weights[self._soft]
        if (self._weights.max(axis=1, initial=0.0) == 1.0).all():  # on nodes, not between them
            heaviest = self._weights.argmax(axis=1)
            self._nodes = self._nodes[np.arange(len(heaviest)), heaviest]
        self._carried = _carried(surfaces, nodes, weights, carriers, model)
        self._first = [each.vertices.start for each in surfaces]
        self._still = np.zeros((len(nodes), 3))
        self._spheres = tuple(each for each in carriers if self._carried.radius[each.vertices].any())
        self._moving = any(max(each.frame, each.joint, each.base) >= 0 for each in carriers)
        start = self.points(model, model.rest_state())
        self._detector = Detector(surfaces, start, settings)

    def points(self, model: Model, state: State) -> Array:
        """Positions of the collision vertices in [m], shape (v, 3)."""
        points = np.zeros((len(self._carried.soft), 3))
        points[self._soft] = self._followed(state.positions)
        for carrier in self.carriers:
            origin, rotation = _pose(carrier, model, state)
            points[carrier.vertices] = origin + carrier.local @ rotation.T
        return points

    def _followed(self, nodal: Array) -> Array:
        """What soft vertices take from the nodes' positions or velocities (n, 3), shape (soft, 3)."""
        if self._nodes.ndim == 1:
            return nodal[self._nodes]
        return np.asarray(np.einsum("vk,vki->vi", self._weights, nodal[self._nodes]))

    def near(self, points: Array, reach: float) -> Proximities:
        """What is nearer than `reach` [m] for vertices at `points` (v, 3)."""
        return self._detector.detect(points, reach)

    def find(self, model: Model, before: State, free: State, at_least: Array | float = 0.0) -> Touching:
        """What touches in a step from `before` that moves freely to `free`.

        The vertices of each surface are taken to move `at_least` this far, in [m], shape (s,).
        """
        points, moved = self.points(model, before), self.points(model, free)
        moved -= points
        travel = np.maximum(self._expected(moved, model, before), at_least)
        near = self._detector.detect(points, self.settings.alarm_distance, travel)
        count = len(near.key)
        vertices = np.concatenate([near.a, near.b], axis=1)
        shares = np.concatenate([near.a_weights, -near.b_weights], axis=1)
        directions, gap, middle = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3))
        contact_frames(
            vertices,
            shares,
            near.normal,
            near.distance,
            points,
            moved,
            self._rolled(model, before, free),
            self.settings.contact_distance,
            directions,
            gap,
            middle,
        )
        rows, on_rigid = self._rows(vertices, shares, directions, points, model, before)
        keys = (near.key % KEYS).astype(float)
        return Touching(rows, on_rigid, gap.ravel(), directions, middle, near.pair, keys, points, travel)

    def find_farther(self, nothing: Touching, model: Model, before: State, free: State) -> Touching:
        """Look anew where nothing touches but a force throws something farther than its speed had told."""
        travel = self._farthest(self.points(model, free) - nothing.vertices)
        beyond = sorted((travel - nothing.travel).tolist())[-2:]
        slack = self.settings.alarm_distance - self.settings.contact_distance
        if sum(max(each, 0.0) for each in beyond) <= slack:
            return nothing
        return self.find(model, before, free, travel)

    def _expected(self, moved: Array, model: Model, before: State) -> Array:
        """How far the vertices of each surface will move in the step, in [m], shape (s,).

        Soft ones by their velocity at its start: what pushes will be held.
        """
        expected = moved.copy()
        expected[self._soft] = self._followed(before.velocities) * model.dt
        return self._farthest(expected)

    def _farthest(self, moved: Array) -> Array:
        """The longest way of a vertex of each surface in [m], shape (s,), of ways (v, 3)."""
        squares = np.einsum("vi,vi->v", moved, moved)
        return np.sqrt(np.maximum.reduceat(squares, self._first))

    def _rolled(self, model: Model, before: State, free: State) -> Array:
        """Radius times rotation vector of each sphere within the step in [m], zeros elsewhere, (v, 3)."""
        rolled = self._still
        if not self._spheres:
            return rolled
        rolled = rolled.copy()
        for carrier in self._spheres:
            if carrier.rigid >= 0:  # not from its rotation: it may turn by more than half a turn a step
                turn = model.dt * free.rigid_velocities[carrier.rigid, 3:]
            else:
                turn = rotation_log(_pose(carrier, model, free)[1] @ _pose(carrier, model, before)[1].T)
            rolled[carrier.vertices] = self._carried.radius[carrier.vertices][:, None] * turn
        return rolled

    def _rows(
        self,
        vertices: IndexArray,
        shares: Array,
        directions: Array,
        points: Array,
        model: Model,
        state: State,
    ) -> tuple[Rows, Array]:
        """Rows of all contacts on nodes and border unknowns, and the rigid bodies' part."""
        count = 3 * len(vertices)
        screws = model.screws(state) if self._moving else NO_SCREWS
        start = np.zeros(count + 1, dtype=np.int64)
        place = np.empty(count * MOST_ENTRIES, dtype=np.int64)
        coefficient = np.empty((count * MOST_ENTRIES, 3))
        on_rigid = np.zeros((count, 6 * len(model.rigid.names)))
        entries = contact_rows(
            vertices,
            shares,
            directions,
            points,
            self._carried,
            state.rigid_positions,
            screws.angular,
            screws.linear,
            screws.origin,
            len(model.rest),
            start,
            place,
            coefficient,
            on_rigid,
        )
        return Rows(start, place[:entries], coefficient[:entries]), on_rigid


def _pose(carrier: Carrier, model: Model, state: State) -> tuple[Array, Array]:
    """Origin (3,) and rotation (3, 3) of a carrier."""
    if carrier.rigid >= 0:
        return state.rigid_positions[carrier.rigid], state.rigid_rotations[carrier.rigid]
    if carrier.frame >= 0:
        return state.frame_positions[carrier.frame], state.frame_rotations[carrier.frame]
    if carrier.joint >= 0:
        return model.joint_frame(carrier.joint, state)
    if carrier.base >= 0:
        return model.base_frame(carrier.base, state)
    return np.zeros(3), np.eye(3)


def _carried(
    surfaces: tuple[CollisionSurface, ...],
    nodes: IndexArray,
    weights: Array,
    carriers: tuple[Carrier, ...],
    model: Model,
) -> Carried:
    """What carries each vertex, as arrays."""
    count = len(nodes)
    radius, rigid, border = np.zeros(count), np.full(count, -1), np.full((count, 6), -1)
    for surface in surfaces:
        radius[surface.vertices] = surface.radius
    for carrier in carriers:
        rigid[carrier.vertices] = carrier.rigid
        unknowns = _border(carrier, model)
        border[carrier.vertices, : len(unknowns)] = unknowns
    return Carried(weights.any(axis=1), nodes, weights, radius, rigid, border)


def _border(carrier: Carrier, model: Model) -> list[int]:
    """Border unknowns that move a carrier."""
    if carrier.frame >= 0:
        return list(range(6 * carrier.frame, 6 * carrier.frame + 6))
    if carrier.joint >= 0:
        return [6 * len(model.frame_names) + j for j in model.chain(carrier.joint)]
    if carrier.base >= 0:
        return [6 * len(model.frame_names) + j for j in model.chain(carrier.base)[:-1]]
    return []


def no_memory() -> Array:
    """State.memory when nothing touches."""
    return np.zeros((0, MEMORY))
