"""Gaps between triangle surfaces by brute force: an oracle for contact tests that shares no code with it."""

from __future__ import annotations

import numpy as np

from softsim_core import Simulation
from softsim_core.base import Array, IndexArray

_CHUNK = 1 << 16


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def edges_of(triangles: IndexArray) -> IndexArray:
    """Edges of triangles (k, 3), each once, shape (e, 2)."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(pairs, axis=1), axis=0)


def to_segments(points: Array, start: Array, end: Array) -> Array:
    """Distance in [m] of points (..., 3) from segments (..., 3), broadcast."""
    along = end - start
    share = ((points - start) * along).sum(axis=-1) / np.maximum((along * along).sum(axis=-1), 1e-300)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points - nearest, axis=-1))


def to_triangles(points: Array, corners: Array) -> Array:
    """Distance in [m] of each point (p, 3) from each triangle (t, 3, 3), shape (p, t)."""
    p = points[:, None]
    a, b, c = corners[None, :, 0], corners[None, :, 1], corners[None, :, 2]
    distance = np.minimum(to_segments(p, a, b), np.minimum(to_segments(p, b, c), to_segments(p, c, a)))
    normal = _unit(np.cross(b - a, c - a))
    above = np.ones(distance.shape, dtype=bool)
    for start, end in ((a, b), (b, c), (c, a)):
        above &= (np.cross(end - start, p - start) * normal).sum(axis=-1) >= 0.0
    height = np.abs(((p - a) * normal).sum(axis=-1))
    return np.where(above, np.minimum(height, distance), distance)


def between_segments(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Distance in [m] between segments a b and c d, broadcast over (..., 3)."""
    ends = np.minimum(
        np.minimum(to_segments(a, c, d), to_segments(b, c, d)),
        np.minimum(to_segments(c, a, b), to_segments(d, a, b)),
    )
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (u * u).sum(axis=-1), (v * v).sum(axis=-1), (u * v).sum(axis=-1)
    uw, vw = (u * w).sum(axis=-1), (v * w).sum(axis=-1)
    determinant = uu * vv - uv * uv
    safe = np.where(determinant > 1e-12 * uu * vv, determinant, 1.0)
    s, t = (uv * vw - vv * uw) / safe, (uu * vw - uv * uw) / safe
    within = (determinant > 1e-12 * uu * vv) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    inner = np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
    return np.where(within, np.minimum(inner, ends), ends)


def winding(points: Array, corners: Array) -> Array:
    """Winding number of a closed surface (t, 3, 3) around each point (p, 3), shape (p,)."""
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(each, axis=-1) for each in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=-1)
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.asarray(np.arctan2(above, below).sum(axis=1) / (2.0 * np.pi))


def signed_distances(points: Array, corners: Array, *, closed: bool) -> Array:
    """Distance in [m] of points (p, 3) from a surface (t, 3, 3), negative inside or behind it, shape (p,)."""
    distance = to_triangles(points, corners)
    if closed:
        inside = winding(points, corners) > 0.5
    else:
        nearest = distance.argmin(axis=1)
        a, b, c = corners[nearest].transpose(1, 0, 2)
        inside = ((points - a) * np.cross(b - a, c - a)).sum(axis=1) < 0.0
    return np.where(inside, -1.0, 1.0) * distance.min(axis=1)


def smallest_gap(sim: Simulation, first: int, second: int) -> tuple[float, float]:
    """Smallest signed gap of the vertices, and of vertices and edges, of two collision surfaces, in [m].

    Spheres are not known here.
    """
    points, surfaces = sim.collision_points, sim.collision_surfaces
    a, b = surfaces[first], surfaces[second]
    ta, tb = points[a.triangles], points[b.triangles]
    vertices = min(
        signed_distances(points[a.vertices], tb, closed=b.closed).min(),
        signed_distances(points[b.vertices], ta, closed=a.closed).min(),
    )
    p, q = points[edges_of(a.triangles)], points[edges_of(b.triangles)]
    edges = np.inf
    for at in range(0, len(p), max(1, _CHUNK // len(q))):
        part = p[at : at + max(1, _CHUNK // len(q)), None]
        edges = min(edges, between_segments(part[:, :, 0], part[:, :, 1], q[None, :, 0], q[None, :, 1]).min())
    return float(vertices), float(min(vertices, edges))
