"""Gaps of contacts on the true shapes, where the surfaces are at the end of a step."""

from __future__ import annotations

from math import inf

import numpy as np

from softsim_core.arrays import Array
from softsim_core.contact.detection.compile import kernel
from softsim_core.contact.detection.detector import Proximities
from softsim_core.contact.detection.geometry import (
    Vector,
    add,
    closest_on_segments,
    closest_on_triangle,
    dot,
    length,
    minus,
    row,
    scaled,
)


def measured_gaps(
    contacts: Proximities, near: Proximities, points: Array, radius: Array, reach: float
) -> tuple[Array, Proximities]:
    """Gaps in [m] of contacts, shape (k,), and what else is nearer than `reach` [m].

    A vertex is measured against all of the other surface; two edges, or a place that is no longer among what
    is near, feature against feature.

    Args:
        contacts: Contacts, found where the surfaces were earlier in the step.
        near: What is close now.
        points: Collision vertices now in [m], shape (v, 3).
        radius: Radius of each that is a sphere in [m], else 0, shape (v,).
        reach: Largest gap of what else is told.
    """
    meeting, others = contacts.meeting, near.meeting
    order = np.lexsort((near.distance, others))
    known = others[order]
    gaps, found = np.empty(len(meeting)), np.zeros(len(meeting), dtype=np.bool_)
    if len(known):
        place = np.minimum(np.searchsorted(known, meeting), len(known) - 1)
        found = known[place] == meeting
        gaps[found] = near.distance[order[place[found]]]
    if not found.all():
        lost = contacts.chosen(np.flatnonzero(~found))
        gaps[~found] = feature_gaps(lost, points, radius)
    told = near.distance <= min(reach, near.distance[near.foremost].min(initial=inf))
    told |= near.foremost & (near.distance <= reach)
    return gaps, near.chosen(np.flatnonzero(told & ~np.isin(others, meeting)))


@kernel
def feature_gaps(contacts: Proximities, points: Array, radius: Array) -> Array:
    """Gap in [m] between the two features of each contact, shape (k,); negative behind, along its normal."""
    gaps = np.empty(contacts.key.shape[0])
    for c in range(gaps.shape[0]):
        a, b = contacts.a[c], contacts.b[c]
        normal = row(contacts.normal, c)
        if a[0] == a[1] and b[0] == b[1]:
            gap = length(minus(row(points, a[0]), row(points, b[0])))
        elif a[0] == a[1]:
            gap = _to_triangle(row(points, a[0]), b[0], b[1], b[2], normal, points)
        elif b[0] == b[1]:
            gap = _to_triangle(row(points, b[0]), a[0], a[1], a[2], scaled(normal, -1.0), points)
        else:
            gap = _between_edges(a[0], a[1], b[0], b[1], normal, points)
        gaps[c] = gap - radius[a[0]] - radius[b[0]]
    return gaps


@kernel
def _to_triangle(p: Vector, i: int, j: int, k: int, normal: Vector, points: Array) -> float:
    """Distance of p from a triangle, negative where it lies against `normal` from there."""
    a, b, c = row(points, i), row(points, j), row(points, k)
    wi, wj, wk, _ = closest_on_triangle(p, a, b, c)
    gap = minus(p, add(add(scaled(a, wi), scaled(b, wj)), scaled(c, wk)))
    return length(gap) if dot(gap, normal) >= 0.0 else -length(gap)


@kernel
def _between_edges(i: int, j: int, k: int, m: int, normal: Vector, points: Array) -> float:
    """Distance of two edges, negative where they have crossed against `normal`."""
    p0, p1, q0, q1 = row(points, i), row(points, j), row(points, k), row(points, m)
    s, t = closest_on_segments(p0, p1, q0, q1)
    gap = minus(add(p0, scaled(minus(p1, p0), s)), add(q0, scaled(minus(q1, q0), t)))
    crossed = min(s, t) > 0.0 and max(s, t) < 1.0 and dot(gap, normal) < 0.0
    return -length(gap) if crossed else length(gap)
