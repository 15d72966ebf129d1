"""Which contacts may hold in a step, and how far linearised gaps close though the true ones do not."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.contact.detection.candidates import mixed
from softsim_core.contact.detection.compile import kernel
from softsim_core.contact.detection.geometry import Vector, dot, minus, row


class Closeness(NamedTuple):
    """Distances in [m] that decide which contacts take part.

    Attributes:
        alarm: What is foremost takes part from here on.
        arrived: Vertices that would come nearer than this take part.
        close: What is nearer than this takes part, foremost or not.
        stray: By how much a linearised gap may close though the true one does not.
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
    points: Array,
    ahead: Array,
    slides: Array,
    ring_start: IndexArray,
    ring: IndexArray,
    closeness: Closeness,
    strays: bool,
    foremost_strays: bool,
) -> BoolArray:
    """Return which contacts take part, (k,): the foremost, vertices that would arrive, what is too close.

    See Detector.may_hold; fields of Proximities and Topology come one by one, since to pass all takes longer
    than to compute.

    Args:
        a: As in Proximities.
        a_weights: As in Proximities.
        b: As in Proximities.
        b_weights: As in Proximities.
        normal: As in Proximities.
        distance: As in Proximities.
        foremost: As in Proximities.
        seeker: As in Proximities.
        points: Vertex positions in [m], shape (v, 3).
        ahead: How far they would still go freely in [m], shape (v, 3).
        slides: How far they slide in the step in [m], shape (v, 3).
        ring_start: As in Topology.
        ring: As in Topology.
        closeness: What is close.
        strays: Whether gaps that close only because they are linearised are left out.
        foremost_strays: Whether also those of foremost contacts are.
    """
    holds = np.zeros(distance.shape[0], dtype=np.bool_)
    for c in range(distance.shape[0]):
        n = row(normal, c)
        arriving = distance[c] + dot(minus(mixed(a, a_weights, c, ahead), mixed(b, b_weights, c, ahead)), n)
        close = foremost[c] and min(distance[c], arriving) < closeness.alarm
        close = close or (seeker[c] >= 0 and arriving < closeness.arrived) or distance[c] < closeness.close
        if close and strays and (foremost_strays or not foremost[c]):
            slip = minus(mixed(a, a_weights, c, slides), mixed(b, b_weights, c, slides))
            close = _false_closing(a[c], b[c], n, slip, points, ring_start, ring) < closeness.stray
        holds[c] = close
    return holds


@kernel
def held_astray(
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
    """Whether a contact with a force has closed by more than `limit` [m] though the true gap has not.

    Args:
        a: As in Proximities.
        a_weights: As in Proximities.
        b: As in Proximities.
        b_weights: As in Proximities.
        normal: As in Proximities.
        forces: Along the normal and two tangents in [N], shape (3 k,).
        points: Vertex positions in [m], shape (v, 3).
        slides: How far they have slid in the step in [m], shape (v, 3).
        ring_start: As in Topology.
        ring: As in Topology.
        limit: In [m].
    """
    for c in range(normal.shape[0]):
        if forces[3 * c] > 0.0:
            slip = minus(mixed(a, a_weights, c, slides), mixed(b, b_weights, c, slides))
            if _false_closing(a[c], b[c], row(normal, c), slip, points, ring_start, ring) > limit:
                return True
    return False


@kernel
def _false_closing(
    a: IndexArray, b: IndexArray, normal: Vector, slip: Vector, points: Array, ring_start: IndexArray,
    ring: IndexArray,
) -> float:  # fmt: skip
    """Return by how much in [m] the gap of a contact closes outside the cone of its vertex as it slips.

    The cone of a vertex holds the directions in which no neighbour lies farther; on a flat surface it is the
    normal alone. The direction to the edge of a body that slides towards the vertex is outside: a neighbour
    under that body rises along it. By the time the body gets from the neighbour to the vertex, its edge is no
    longer what is nearest, so the linearised gap closes while the true one stays.
    """
    most, closing = -dot(slip, normal), 0.0
    if most <= 0.0:
        return closing
    for side in range(2):
        nodes, sign = (a, -1.0) if side == 0 else (b, 1.0)
        v = nodes[0]
        if v != nodes[1]:
            continue  # a face or an edge: its contact lies inside its cone
        for at in range(ring_start[v], ring_start[v + 1]):
            off = minus(row(points, ring[at]), row(points, v))
            rise, towards = sign * dot(off, normal), -sign * dot(off, slip)
            if rise > 0.0 and towards > 0.0:
                closing = max(closing, min(rise * towards / dot(off, off), most))
    return closing
