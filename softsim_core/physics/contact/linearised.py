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
    VertexWays,
    allocate_contacts,
    contact_frames,
    contact_rows,
    gaps_after,
)
from softsim_core.physics.contact.settings import ContactLimits
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.mechanics import MotionSubspace, Rows, cross_matrix

_FORESEEN = 0.1
"""Gap beyond the contact distance, as a share of it, below which a contact is foreseen to close."""
_frames, _fill_rows, _gaps_after = (OneSignature(each) for each in (contact_frames, contact_rows, gaps_after))
NO_MOTION = MotionSubspace(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))


@dataclass(slots=True, eq=False)
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
        forces: Initial forces in [N]: those of the same contacts in the warm start, else zero, shape (k, 3).
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
    forces: Array

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def settings(self) -> ContactLimits:
        """Limits of the contact solver."""
        return self.collisions.settings

    def warm_start(self, forces: Array) -> Array:
        """Return State.warm_start for this step's forces (k, 3) in [N], sorted by key."""
        rows = np.empty((len(self), 4))
        rows[:, 0], rows[:, 1:] = self.keys, forces
        return rows.take(np.argsort(self.keys, kind="stable"), axis=0)

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
        return _rows(self, which)


def linearise(
    collisions: CollisionModel,
    near: Proximities,
    start: Place,
    at: Place,
    free: Place,
    slides: Array | None,
    earlier: IndexArray,
    warm_start: Array,
) -> LinearisedContacts:
    """Return the contacts that may bear a force in a step from `start` to `free`, linearised about `at`.

    `near` are the contacts at `at`. `slides` is the displacement of the vertices from `at` to the end found
    last, in [m], shape (v, 3); None where `at` is that end. With q the motion since the start, the gap at the
    end of the step is taken as g(q_at) + H (q - q_at), and the slip likewise.

    Contacts of an `earlier` solution, given by their keys (ascending, unique), take part again, even where
    detection now finds another feature closer, because the contact force keeps them apart: pairs of edges
    always, a vertex only after the first solution of a step. About the start itself, the free motion of rigid
    bodies is used without linearisation. `warm_start` has the initial forces; see State.warm_start.
    """
    settings = collisions.settings
    ahead = free.points - at.points
    chosen, found_again = collisions.may_hold(near, earlier, at, ahead, slides, first=at is start)
    lost = np.setdiff1d(earlier, near.key) if found_again < len(earlier) else earlier[:0]
    near = near.select(chosen)
    if len(lost):
        near = near.join(collisions.again(lost, at, edges_only=at is start))
    anew = at is not start
    if anew:
        ahead[collisions.carried.rigid >= 0] = 0.0  # their rows account for it, below
    rolled = collisions.compute_rolling(start, at if anew else free)
    way = VertexWays(at.points, at.moved, ahead, collisions.still if slides is None else slides, rolled)
    contacts = allocate_contacts(len(near.key))
    apart = settings.contact_distance
    _frames(near, way, collisions.friction, apart, _FORESEEN * apart, warm_start, contacts)
    subspace = collisions.motion_subspace(at) or NO_MOTION
    motions = Motions(
        at.state.rigid_positions.copy(),
        subspace.angular,
        subspace.linear,
        subspace.origin,
        len(collisions.model.rest),
    )
    result = LinearisedContacts(collisions, near, at, motions, anew, *contacts)
    if anew and len(collisions.model.rigid.names):
        _, on_rigid = _rows(result, np.ones(len(result), dtype=np.bool_))
        result.gap[:] += (on_rigid @ (free.turned - at.turned).ravel()).reshape(-1, 3)
    result.closing[:] &= result.gap[:, 0] < 0.0
    return result


def _rows(contacts: LinearisedContacts, which: BoolArray) -> tuple[Rows, Array]:
    """Return the rows of contacts on nodes and reduced coordinates, and those on the rigid bodies."""
    collisions, at, carried = contacts.collisions, contacts.at, contacts.collisions.carried
    count = 3 * int(np.count_nonzero(which))
    start = np.zeros(count + 1, dtype=np.int64)
    most = CORNERS * max(NODES, carried.reduced.shape[1])  # entries of a row
    place = np.empty(count * most, dtype=np.int64)
    coefficient = np.empty((count * most, 3))
    on_rigid = np.zeros((count, 6 * len(collisions.model.rigid.names)))
    entries = _fill_rows(
        which, contacts.vertices, contacts.shares, contacts.directions, at.points, carried, contacts.motions,
        start, place, coefficient, on_rigid,
    )  # fmt: skip
    if contacts.anew and on_rigid.size:
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
