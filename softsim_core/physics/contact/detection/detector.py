"""Contact detection: pairs of locally closest points within a reach, and which of them may bear a force."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, DetectionOverflowError, IndexArray
from softsim_core.physics.contact import CollisionSurface, ContactLimits, kernel
from softsim_core.physics.contact.detection.broad_phase import allocate
from softsim_core.physics.contact.detection.candidates import (
    ContactBuffers,
    allocate_found,
    allocate_near,
    interpolate_side,
)
from softsim_core.physics.contact.detection.geometry import (
    Vector,
    add,
    closest_on_segments,
    closest_on_triangle,
    dot,
    length,
    minus,
    row,
    scale,
)
from softsim_core.physics.contact.detection.narrow_phase import KnownPairs, meet_known_pairs, sweep
from softsim_core.physics.contact.detection.passage import VertexMotion, free_share
from softsim_core.physics.contact.detection.topology import build_topology
from softsim_core.physics.kernels import OneSignature


class Closeness(NamedTuple):
    """Distances in [m] that decide which contacts take part in a step.

    Attributes:
        alarm: Local minima of the distance take part below this distance.
        arrived: Vertices that would come closer than this take part.
        close: Contacts closer than this take part, local minimum or not.
        stray: Closing of a linearised gap that is tolerated although the true gap does not close.
    """

    alarm: float
    arrived: float
    close: float
    stray: float


@kernel
def may_hold(
    a: IndexArray,
    a_weights: Array,
    b: IndexArray,
    b_weights: Array,
    normal: Array,
    distance: Array,
    foremost: BoolArray,
    seeker: IndexArray,
    key: IndexArray,
    earlier: IndexArray,
    points: Array,
    ahead: Array,
    slides: Array,
    ring_start: IndexArray,
    ring: IndexArray,
    closeness: Closeness,
    strays: bool,
    foremost_strays: bool,
) -> tuple[BoolArray, int]:
    """Return which contacts take part, (k,), and the number of earlier ones among them.

    These are local minima, vertices that would arrive, close contacts, and earlier contacts. For the
    arguments see Detector.may_hold. Fields of Proximities and Topology are passed one by one, because
    passing the whole tuples takes longer than the computation.
    """
    holds = np.zeros(distance.shape[0], dtype=np.bool_)
    passed, again = 0, 0  # earlier keys with a smaller key than contact c; earlier ones found again
    for c in range(distance.shape[0]):
        while passed < len(earlier) and earlier[passed] < key[c]:
            passed += 1
        if passed < len(earlier) and earlier[passed] == key[c]:
            holds[c] = True
            again += 1
            continue
        n = row(normal, c)
        arriving = distance[c] + dot(
            minus(interpolate_side(a, a_weights, c, ahead), interpolate_side(b, b_weights, c, ahead)), n
        )
        close = foremost[c] and min(distance[c], arriving) < closeness.alarm
        close = close or (seeker[c] >= 0 and arriving < closeness.arrived) or distance[c] < closeness.close
        if close and strays and (foremost_strays or not foremost[c]):
            slip = minus(interpolate_side(a, a_weights, c, slides), interpolate_side(b, b_weights, c, slides))
            close = _false_closing(a[c], b[c], n, slip, points, ring_start, ring) < closeness.stray
        holds[c] = close
    return holds, again


@kernel
def any_astray(
    a: IndexArray,
    a_weights: Array,
    b: IndexArray,
    b_weights: Array,
    normal: Array,
    forces: Array,
    points: Array,
    slides: Array,
    ring_start: IndexArray,
    ring: IndexArray,
    limit: float,
) -> bool:
    """Return whether a contact with a force closed by more than `limit` [m] although the true gap did not.

    For the arguments see Detector.any_astray, and Proximities and Topology.
    """
    for c in range(normal.shape[0]):
        if forces[c, 0] > 0.0:
            slip = minus(interpolate_side(a, a_weights, c, slides), interpolate_side(b, b_weights, c, slides))
            if _false_closing(a[c], b[c], row(normal, c), slip, points, ring_start, ring) > limit:
                return True
    return False


@kernel
def _false_closing(
    a: IndexArray, b: IndexArray, normal: Vector, slip: Vector, points: Array, ring_start: IndexArray,
    ring: IndexArray,
) -> float:  # fmt: skip
    """Return the closing in [m] of a contact's linearised gap outside its vertex's normal cone.

    The normal cone of a vertex contains the directions along which no neighbour extends farther; on a flat
    surface it is the normal alone. The direction to the edge of a body that slides towards the vertex is
    outside it, because a neighbour under that body rises along that direction. When the body has moved from
    the neighbour to the vertex, its edge is no longer the closest feature. The linearised gap therefore
    closes while the true gap does not.
    """
    most, closing = -dot(slip, normal), 0.0
    if most <= 0.0:
        return closing
    for side in range(2):
        nodes, sign = (a, -1.0) if side == 0 else (b, 1.0)
        v = nodes[0]
        if v != nodes[1]:
            continue  # a face or an edge: the contact direction is inside its normal cone
        for at in range(ring_start[v], ring_start[v + 1]):
            off = minus(row(points, ring[at]), row(points, v))
            rise, towards = sign * dot(off, normal), -sign * dot(off, slip)
            if rise > 0.0 and towards > 0.0:
                closing = max(closing, min(rise * towards / dot(off, off), most))
    return closing


_INITIAL_PAIRS = 1024  # initial number of feature pairs; the buffers grow when a scene needs more
_MOST_PAIRS = 1 << 20
"""Largest number of feature pairs in the buffers: about 300 MB."""
_MOST_SURFACES = 1 << 20


class Proximities(NamedTuple):
    """Proximities of surfaces: k contacts, each between point P on side a and point Q on side b.

    Attributes:
        a: Vertices of P on the pair's first surface, shape (k, 3); a vertex of weight 0 repeats another one.
        a_weights: Weights of these vertices, rows sum to 1, shape (k, 3).
        b: Vertices of Q on the pair's second surface, shape (k, 3).
        b_weights: Weights of these vertices, shape (k, 3).
        normal: Unit vector from side b to side a, shape (k, 3). For a sphere, P or Q is the centre, and the
            sphere touches at `radius` from there along the normal.
        distance: Gap between the surfaces along the normal in [m], radii subtracted; negative where they
            overlap, shape (k,).
        foremost: Whether this is a local minimum of the distance between the surfaces, shape (k,). Other
            contacts may become one while surfaces turn, or are only measured.
        seeker: Vertex (or sphere) for which the nearest point of the other surface was sought; -1 for two
            edges or two spheres, shape (k,).
        pair: Numbers of the surfaces, first < second, shape (k, 2).
        key: Number of the pair of features; the same from step to step, unique, shape (k,).
    """

    a: IndexArray
    a_weights: Array
    b: IndexArray
    b_weights: Array
    normal: Array
    distance: Array
    foremost: BoolArray
    seeker: IndexArray
    pair: IndexArray
    key: IndexArray

    def select(self, which: BoolArray) -> Proximities:
        """Return the contacts `which` (k,)."""
        (chosen,) = which.nonzero()
        return Proximities._make([each.take(chosen, axis=0) for each in self])

    def join(self, other: Proximities) -> Proximities:
        """Return these contacts, followed by others."""
        return Proximities(*(np.concatenate(both) for both in zip(self, other, strict=True)))

    @property
    def meeting(self) -> IndexArray:
        """Identifier of what meets, shape (k,): vertex and other surface, or the key without a vertex."""
        first = self.a[:, 0] == self.seeker
        other = np.where(first, self.pair[:, 1], self.pair[:, 0])
        return np.where(self.seeker >= 0, -1 - self.seeker * _MOST_SURFACES - other, self.key)


class Detector:
    """Detector of close surfaces.

    A foremost contact is a local minimum of the distance: a vertex against a face, an edge or a vertex, or
    two edges. So that a sphere may lie in a dent, every vertex of a deformable surface whose distance from
    the sphere is hardly more than the contact distance is foremost, too. A vertex of one surface that is
    inside the other, up to half the reach deep and with its own surface facing the face that it went through,
    gives a negative distance along that face's outward normal.

    Args:
        surfaces: The surfaces, over disjoint ranges of the vertices.
        rest_points: Vertex positions at rest in [m], shape (v, 3).
        settings: Contact limits. Points of one body within the contact distance at rest never meet.

    Source: local minimal distance, Johnson and Willemsen 2003; one triangle per feature, Curtis, Tamstorf and
    Manocha 2008.
    """

    def __init__(
        self, surfaces: tuple[CollisionSurface, ...], rest_points: Array, settings: ContactLimits
    ) -> None:
        self.surfaces = surfaces
        self._rest = np.ascontiguousarray(rest_points, dtype=np.float64)
        self._contact_distance = float(settings.contact_distance)
        self._topology = build_topology(surfaces, self._rest)
        self._boxes = allocate(self._topology)
        self._near, self._found = allocate_near(_INITIAL_PAIRS), allocate_found(_INITIAL_PAIRS)
        self._owner = np.array([each.owner for each in surfaces], dtype=np.int64)
        self._sweep, self._free_share = OneSignature(sweep), OneSignature(free_share)
        self._may_hold, self._any_astray = OneSignature(may_hold), OneSignature(any_astray)
        self._known_pairs = OneSignature(meet_known_pairs)
        topology = self._topology
        self._first_vertex = np.concatenate(  # of each feature
            [np.arange(len(topology.radius)), topology.edges[:, 0], topology.triangles[:, 0]]
        )

    def detect(self, points: Array, reach: float) -> Proximities:
        """Return foremost contacts closer than `reach` [m] of surfaces with vertices at `points` (v, 3).

        Raises:
            DetectionOverflowError: more feature pairs are close than the buffers may hold.
        """
        near = self.candidates(points, reach)
        return near.select(near.foremost)

    def candidates(self, points: Array, reach: float, travel: Array | None = None) -> Proximities:
        """Return all contacts with a gap of at most `reach` plus the travel of both surfaces.

        Args:
            points: Vertex positions in [m], shape (v, 3).
            reach: Largest gap in [m] of surfaces at rest: the alarm distance.
            travel: Largest displacement of each surface within the step in [m], shape (s,); None: zero.

        Raises:
            DetectionOverflowError: more feature pairs are close than the buffers may hold.
        """
        travel = np.zeros(len(self.surfaces)) if travel is None else travel
        travel = np.ascontiguousarray(travel, dtype=np.float64)
        points = np.ascontiguousarray(points, dtype=np.float64)
        while True:
            near, found = self._near, self._found
            needed = self._sweep(
                points, self._rest, float(reach), travel, self._contact_distance, self._topology, self._boxes,
                near, found,
            )  # fmt: skip
            if needed <= len(found.distance):
                break
            self._widen(needed)
        return _copy_contacts(found)

    def again(self, keys: IndexArray, points: Array, edges_only: bool = False) -> Proximities:
        """Return earlier contacts at their current closest points, at any distance; see `meet_known_pairs`.

        `candidates` no longer lists a pair when another feature of either surface becomes closer. Such a pair
        may still have to bear a force, because the other feature may be closer only as a result of that
        force.

        Args:
            keys: Keys of contacts, shape (k,); pairs of vertices are left out, because they are found anyway.
            points: Vertex positions in [m], shape (v, 3).
            edges_only: Whether vertices are left out, too.
        """
        topology = self._topology
        vertices, edges = len(topology.radius), len(topology.edges)
        pairs = np.stack(np.divmod(keys, vertices + edges + len(topology.triangles)), axis=1)
        if edges_only:
            pairs = pairs[(pairs >= vertices).all(axis=1) & (pairs < vertices + edges).all(axis=1)]
        first = self._first_vertex[pairs]
        surfaces = np.searchsorted(topology.surface_vertex[:, 0], first, side="right") - 1
        owner = self._owner[surfaces]
        together = np.where(owner[:, 0] == owner[:, 1], self._contact_distance, -1.0)
        found = allocate_found(len(pairs))
        self._known_pairs(KnownPairs(pairs, surfaces, together), points, self._rest, topology, found)
        return _copy_contacts(found)

    def may_hold(
        self, near: Proximities, earlier: IndexArray, points: Array, ahead: Array, slides: Array,
        closeness: Closeness, strays: bool, foremost_strays: bool,
    ) -> tuple[BoolArray, int]:  # fmt: skip
        """Return which contacts take part in a step, shape (k,), and the number of earlier ones found again.

        Args:
            near: The contacts, with ascending keys.
            earlier: Keys of contacts that take part in any case, ascending, shape (w,).
            points: Vertex positions in [m], shape (v, 3).
            ahead: Remaining displacement without contact in [m], shape (v, 3).
            slides: Displacement in the step in [m], shape (v, 3).
            closeness: Distances that decide.
            strays: Whether to leave out gaps that close only because they are linearised.
            foremost_strays: Whether to leave them out for local minima, too.
        """
        holds, again = self._may_hold(
            near.a, near.a_weights, near.b, near.b_weights, near.normal, near.distance, near.foremost,
            near.seeker, near.key, earlier, points, ahead, slides, self._topology.ring_start,
            self._topology.ring, closeness, strays, foremost_strays,
        )  # fmt: skip
        return holds, again

    def any_astray(
        self, active: Proximities, forces: Array, points: Array, slides: Array, limit: float
    ) -> bool:
        """Return whether a contact with a force closed by more than `limit` [m] but the true gap did not.

        Args:
            active: The contacts, k of them.
            forces: Along their normals and two tangents in [N], shape (k, 3).
            points: Vertex positions where they were found in [m], shape (v, 3).
            slides: How far vertices have slid from there in [m], shape (v, 3).
            limit: In [m].
        """
        return bool(
            self._any_astray(
                active.a, active.a_weights, active.b, active.b_weights, active.normal, forces, points, slides,
                self._topology.ring_start, self._topology.ring, limit,
            )
        )  # fmt: skip

    def free_share(self, before: Array, after: Array, watched: BoolArray) -> float:
        """Return the share of the motion from `before` to `after` without passing through a surface, in 0..1.

        Args:
            before: Vertex positions at the start of the step in [m], shape (v, 3).
            after: The same at its end; each moves along a line.
            watched: Which pairs of `pairs` are looked at, shape (p,).

        Raises:
            DetectionOverflowError: more pairs of features come close than are ever listed.
        """
        way = VertexMotion(self._rest, before, after, watched, self._contact_distance)
        while True:
            share, needed = self._free_share(way, self._topology, self._boxes, self._near)
            if needed <= len(self._near.leaves):
                return float(share)
            self._widen(needed)

    @property
    def pairs(self) -> IndexArray:
        """Numbers of the surfaces that may meet, shape (p, 2)."""
        return self._topology.pairs

    def _widen(self, needed: int) -> None:
        """Replace the buffers by larger ones, for twice as many feature pairs as are needed now."""
        if needed > _MOST_PAIRS:
            raise DetectionOverflowError(needed, _MOST_PAIRS)
        self._near, self._found = allocate_near(2 * needed), allocate_found(2 * needed)


def _copy_contacts(found: ContactBuffers) -> Proximities:
    """Return copies of the contacts that were found, sorted by key."""
    order = np.argsort(found.key[: found.counter[0]], kind="stable")
    return Proximities._make([getattr(found, name).take(order, axis=0) for name in Proximities._fields])


def measured_gaps(
    contacts: Proximities, near: Proximities, points: Array, radius: Array, reach: float
) -> tuple[Array, Proximities]:
    """Return the gaps in [m] of contacts, shape (k,), and the other contacts closer than `reach` [m].

    A vertex is measured against the whole other surface. Two edges, and a vertex whose other surface is no
    longer near, are measured feature against feature.

    Args:
        contacts: Contacts found at an earlier configuration in the step.
        near: Contacts at the current configuration.
        points: Current collision vertices in [m], shape (v, 3).
        radius: Radius of each vertex that is a sphere in [m], else 0, shape (v,).
        reach: Largest gap of the other contacts that are returned.
    """
    meeting, others = contacts.meeting, near.meeting
    order = np.lexsort((near.distance, others))
    sorted_others = others[order]
    gaps, found = np.empty(len(meeting)), np.zeros(len(meeting), dtype=np.bool_)
    if len(sorted_others):
        place = np.minimum(np.searchsorted(sorted_others, meeting), len(sorted_others) - 1)
        found = sorted_others[place] == meeting
        gaps[found] = near.distance[order[place[found]]]
    if not found.all():
        lost = contacts.select(~found)
        gaps[~found] = feature_gaps(lost, points, radius)
    reported = near.distance <= min(reach, near.distance[near.foremost].min(initial=inf))
    reported |= near.foremost & (near.distance <= reach)
    return gaps, near.select(reported & ~np.isin(others, meeting))


@kernel
def feature_gaps(contacts: Proximities, points: Array, radius: Array) -> Array:
    """Return the gap in [m] between the features of each contact, negative behind the normal, shape (k,)."""
    gaps = np.empty(contacts.key.shape[0])
    for c in range(gaps.shape[0]):
        a, b = contacts.a[c], contacts.b[c]
        normal = row(contacts.normal, c)
        if a[0] == a[1] and b[0] == b[1]:
            gap = length(minus(row(points, a[0]), row(points, b[0])))
        elif a[0] == a[1]:
            gap = _to_triangle(row(points, a[0]), b[0], b[1], b[2], normal, points)
        elif b[0] == b[1]:
            gap = _to_triangle(row(points, b[0]), a[0], a[1], a[2], scale(normal, -1.0), points)
        else:
            gap = _between_edges(a[0], a[1], b[0], b[1], normal, points)
        gaps[c] = gap - radius[a[0]] - radius[b[0]]
    return gaps


@kernel
def _to_triangle(p: Vector, i: int, j: int, k: int, normal: Vector, points: Array) -> float:
    """Return the distance of p from a triangle, negative where p is behind it with respect to `normal`."""
    a, b, c = row(points, i), row(points, j), row(points, k)
    wi, wj, wk, _ = closest_on_triangle(p, a, b, c)
    gap = minus(p, add(add(scale(a, wi), scale(b, wj)), scale(c, wk)))
    return length(gap) if dot(gap, normal) >= 0.0 else -length(gap)


@kernel
def _between_edges(i: int, j: int, k: int, m: int, normal: Vector, points: Array) -> float:
    """Return the distance of two edges, negative where they have crossed against `normal`."""
    p0, p1, q0, q1 = row(points, i), row(points, j), row(points, k), row(points, m)
    s, t = closest_on_segments(p0, p1, q0, q1)
    gap = minus(add(p0, scale(minus(p1, p0), s)), add(q0, scale(minus(q1, q0), t)))
    crossed = min(s, t) > 0.0 and max(s, t) < 1.0 and dot(gap, normal) < 0.0
    return -length(gap) if crossed else length(gap)
