"""Contacts linearised about a configuration within a step: rows, and gaps and slips without contact force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.contact.collision_model import CollisionModel, Place
from softsim_core.physics.contact.detection import Proximities
from softsim_core.physics.contact.rows import (
    CORNERS,
    NODES,
    Motions,
    contact_frames,
    contact_rows,
    gaps_after,
)
from softsim_core.physics.contact.settings import ContactLimits
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.mechanics import MotionSubspace, Rows, cross_matrix

KEYS = 1 << 52
"""Keys of contacts are reduced modulo this, so that a float64 represents them exactly."""
_FORESEEN = 0.1
"""Gap beyond the contact distance, as a share of it, below which a contact is foreseen to close."""
_frames, _fill_rows, _gaps_after = (OneSignature(each) for each in (contact_frames, contact_rows, gaps_after))
NO_MOTION = MotionSubspace(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class LinearisedContacts:
    """Contacts of one step: three rows each, along the normal and two tangents.

    Attributes:
        collisions: The surfaces.
        near: Closest points of the surfaces.
        at: Configuration about which they are linearised; its state may have moved on.
        motions: Motion of the rigid bodies, frames and joints there.
        anew: Whether `at` is not the start of the step.
        vertices: Vertices of both sides, shape (k, 6).
        shares: Weights of these vertices, negative on the second side, shape (k, 6).
        gap: Gap beyond the contact distance, then the slips, without contact forces, in [m], shape (k, 3).
        directions: Normal and tangents, shape (k, 3, 3).
        points: Middle of each contact in [m], shape (k, 3).
        friction: Coulomb coefficient of each contact, shape (k,).
        keys: Key of each contact's feature pair, shape (k,).
        closing: Whether surfaces meet there, as far as can be foreseen without the forces, shape (k,).
    """

    collisions: CollisionModel
    near: Proximities
    at: Place
    motions: Motions
    anew: bool
    vertices: IndexArray
    shares: Array
    gap: Array
    directions: Array
    points: Array
    friction: Array
    keys: Array
    closing: BoolArray

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def settings(self) -> ContactLimits:
        """Limits of the contact solver."""
        return self.collisions.settings

    def first_forces(self, warm_start: Array) -> Array:
        """Return initial forces (k, 3) in [N]: those of the same contacts in State.warm_start, else zero."""
        start = np.zeros((len(self), 3))
        if len(warm_start) and len(self):
            place = np.minimum(np.searchsorted(warm_start[:, 0], self.keys), len(warm_start) - 1)
            matched = warm_start[place, 0] == self.keys
            start[matched] = warm_start[place[matched], 1:]
        return start

    def warm_start(self, forces: Array) -> Array:
        """Return State.warm_start for this step's forces (k, 3) in [N], sorted by key."""
        rows = np.column_stack([self.keys, forces])
        return rows[np.argsort(self.keys, kind="stable")]

    def too_close(self, end: Place) -> BoolArray:
        """Return which contacts are closer than allowed at a configuration, as linearised, shape (k,)."""
        gaps = self.near.distance - self.settings.contact_distance
        moved = end.points - self.at.points
        gaps = _gaps_after(self.vertices, self.shares, self.near.normal, gaps, moved)
        return np.asarray(gaps < -self.settings.tolerance)

    def rows(self, which: BoolArray) -> tuple[Rows, Array]:
        """Return three rows for each of the contacts `which` (k,).

        Returns:
            Rows on nodes and reduced coordinates, and rows on velocities and spins of the rigid bodies.
        """
        sides = self.vertices[which], self.shares[which]
        return _rows(self.collisions, *sides, self.directions[which], self.at, self.motions, self.anew)


def linearise(
    collisions: CollisionModel,
    near: Proximities,
    start: Place,
    at: Place,
    free: Place,
    slides: Array | None,
    earlier: IndexArray,
) -> LinearisedContacts:
    """Return the contacts that may bear a force in a step from `start` to `free`, linearised about `at`.

    `near` are the contacts at `at`. `slides` is the displacement of the vertices from `at` to the end found
    last, in [m], shape (v, 3); None where `at` is that end. With q the motion since the start, the gap at the
    end of the step is taken as g(q_at) + H (q - q_at), and the slip likewise.

    Contacts of an `earlier` solution, given by their keys (ascending, unique), take part again, even where
    detection now finds another feature closer, because the contact force keeps them apart: pairs of edges
    always, a vertex only after the first solution of a step. About the start itself, the free motion of rigid
    bodies is used without linearisation.
    """
    settings = collisions.settings
    ahead = free.points - at.points
    lost = earlier[~_among(near.key, earlier)]
    chosen = collisions.may_hold(near, at, ahead, slides, first=at is start) | _among(earlier, near.key)
    near = near.select(chosen)
    if len(lost):
        near = near.join(collisions.again(lost, at, edges_only=at is start))
    vertices = np.concatenate([near.a, near.b], axis=1)
    shares = np.concatenate([near.a_weights, -near.b_weights], axis=1)
    count, anew = len(near.key), at is not start
    directions, gap, middle = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3))
    if anew:
        ahead[collisions.carried.rigid >= 0] = 0.0  # their rows account for it, below
    rolled = collisions.compute_rolling(start, at if anew else free)
    _frames(
        vertices, shares, near.normal, near.distance, at.points, at.moved, ahead, rolled,
        settings.contact_distance, directions, gap, middle,
    )  # fmt: skip
    foreseen = near.distance - settings.contact_distance
    if slides is not None:
        foreseen = _gaps_after(vertices, shares, near.normal, foreseen, slides)
    keys = (near.key % KEYS).astype(float)
    friction = collisions.friction[near.pair[:, 0], near.pair[:, 1]]
    subspace = collisions.motion_subspace(at) or NO_MOTION
    motions = Motions(
        at.state.rigid_positions.copy(),
        subspace.angular,
        subspace.linear,
        subspace.origin,
        len(collisions.model.rest),
    )
    if anew and len(collisions.model.rigid.names):
        _, on_rigid = _rows(collisions, vertices, shares, directions, at, motions, anew)
        gap += (on_rigid @ (free.turned - at.turned).ravel()).reshape(-1, 3)
    closing = (foreseen < _FORESEEN * settings.contact_distance) & (gap[:, 0] < 0.0)
    return LinearisedContacts(
        collisions,
        near,
        at,
        motions,
        anew,
        vertices,
        shares,
        gap,
        directions,
        middle,
        friction,
        keys,
        closing,
    )


def _among(keys: IndexArray, requested: IndexArray) -> BoolArray:
    """Return which of the `requested` (w,) are among `keys` (k,), ascending."""
    if not len(keys):
        return np.zeros(len(requested), dtype=np.bool_)
    place = np.minimum(np.searchsorted(keys, requested), len(keys) - 1)
    return np.asarray(keys[place] == requested)


def _rows(
    collisions: CollisionModel,
    vertices: IndexArray,
    shares: Array,
    directions: Array,
    at: Place,
    motions: Motions,
    anew: bool,
) -> tuple[Rows, Array]:
    """Return the rows of contacts on nodes and reduced coordinates, and those on the rigid bodies."""
    model, carried, count = collisions.model, collisions.carried, 3 * len(vertices)
    start = np.zeros(count + 1, dtype=np.int64)
    most = CORNERS * max(NODES, carried.reduced.shape[1])  # entries of a row
    place = np.empty(count * most, dtype=np.int64)
    coefficient = np.empty((count * most, 3))
    on_rigid = np.zeros((count, 6 * len(model.rigid.names)))
    entries = _fill_rows(
        vertices, shares, directions, at.points, carried, motions, start, place, coefficient, on_rigid
    )
    if anew and on_rigid.size:
        _follow_turn(on_rigid, collisions, at)
    return Rows(start, place[:entries], coefficient[:entries]), on_rigid


def _follow_turn(on_rigid: Array, collisions: CollisionModel, at: Place) -> None:
    """Convert rows on spins, in place, to rows on the rotation vector since the start, which may be long.

    The change dw of a rotation vector w rotates the body by J(w) dw, with J the left Jacobian of the
    exponential map. Rows of spheres remain on spins.
    """
    for carrier in collisions.carriers:
        r = carrier.rigid
        if r < 0 or collisions.carried.radius[carrier.vertices].any():
            continue
        spin = slice(6 * r + 3, 6 * r + 6)
        on_rigid[:, spin] = on_rigid[:, spin] @ _left_jacobian(at.turned[r, 3:])


def _left_jacobian(turn: Array) -> Array:
    """Return the left Jacobian (3, 3) of the exponential map at a rotation vector (3,)."""
    angle, matrix = float(np.linalg.norm(turn)), cross_matrix(turn)
    if angle < 1e-4:
        return np.eye(3) + 0.5 * matrix
    first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * matrix + second * matrix @ matrix)
