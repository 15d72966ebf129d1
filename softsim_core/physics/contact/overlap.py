"""Overlap of surfaces at any depth, for the start of a scene."""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from softsim_core.base import Array, BoolArray
from softsim_core.physics.contact.surfaces import CollisionSurface, may_meet, surfaces_cross

_TOUCH = 1.0e-7
"""Share of the smaller surface's size up to which an overlap counts as touching."""
_CHUNK = 1 << 18
_WITHIN = 1.0e-5
"""Depth of the probes behind a surface's triangles, as a share of their size."""


def first_overlap(
    surfaces: tuple[CollisionSurface, ...], points: Array, owners: Container[int] | None = None
) -> tuple[int, int] | None:
    """Return two surfaces of different bodies that cross, or of which the first is inside the second.

    Else None.

    Surfaces that only touch do not overlap. A point is inside where all surfaces of a body together enclose
    it; an open surface has no inside.

    Args:
        surfaces: Surfaces over the vertices.
        points: Vertex positions in [m], shape (v, 3).
        owners: Bodies, one of which must be in the pair; None: any.
    """

    def is_candidate_pair(a: CollisionSurface, b: CollisionSurface) -> bool:
        chosen = owners is None or a.owner in owners or b.owner in owners
        return chosen and a.owner != b.owner and may_meet(a, b)

    for i, a in enumerate(surfaces):
        for j, b in enumerate(surfaces[:i]):
            if is_candidate_pair(a, b) and _cross(a, b, points):
                return j, i
    for i, a in enumerate(surfaces):
        probes = _probes(a, points)
        for j, b in enumerate(surfaces):
            if b.radius > 0.0 or not is_candidate_pair(a, b):
                continue
            shell = np.concatenate([each.triangles for each in surfaces if each.owner == b.owner])
            if _find_enclosed(probes, points[shell]).any():
                return i, j
    return None


def touching(a: CollisionSurface, b: CollisionSurface, points: Array) -> float:
    """Return the overlap in [m] up to which two surfaces over vertices (v, 3) only touch."""
    sizes = (2.0 * s.radius or float(np.linalg.norm(np.ptp(points[s.vertices], axis=0))) for s in (a, b))
    return _TOUCH * min(sizes)


def _cross(a: CollisionSurface, b: CollisionSurface, points: Array) -> bool:
    """Return whether two surfaces cross; a sphere counts as solid."""
    if a.radius > 0.0 and b.radius > 0.0:
        apart = float(np.linalg.norm(points[a.vertices] - points[b.vertices]))
        return apart < a.radius + b.radius - touching(a, b, points)
    if a.radius > 0.0 or b.radius > 0.0:
        ball, other = (a, b) if a.radius > 0.0 else (b, a)
        gap = _distance(points[ball.vertices][0], points[other.triangles]) - ball.radius
        return gap < -touching(a, b, points)
    return surfaces_cross(points[a.triangles], points[b.triangles])


def _distance(point: Array, corners: Array) -> float:
    """Return the distance in [m] of a point (3,) to triangles (k, 3, 3)."""
    along = np.roll(corners, -1, axis=1) - corners
    off = point - corners
    share = np.clip((off * along).sum(axis=2) / (along * along).sum(axis=2), 0.0, 1.0)
    to_edges = np.linalg.norm(off - share[..., None] * along, axis=2).min(axis=1)
    normals = np.cross(along[:, 0], along[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    over = ((np.cross(along, off) * normals[:, None]).sum(axis=2) >= 0.0).all(axis=1)
    return float(np.where(over, np.abs((off[:, 0] * normals).sum(axis=1)), to_edges).min())


def _probes(surface: CollisionSurface, points: Array) -> Array:
    """Return a point close behind each triangle, or the centre of a sphere, shape (p, 3)."""
    if surface.radius > 0.0:
        return np.asarray(points[surface.vertices])
    corners = points[surface.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.sqrt(np.linalg.norm(normals, axis=1, keepdims=True))  # about the edges' length
    return np.asarray(corners.mean(axis=1) - _WITHIN * normals)


def _find_enclosed(points: Array, corners: Array) -> BoolArray:
    """Return which points (p, 3) are inside closed triangles (k, 3, 3)."""
    result = np.zeros(len(points), dtype=bool)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    near = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
    step = max(1, _CHUNK // len(corners))
    for some in np.split(near, range(step, len(near), step)):
        result[some] = np.abs(_winding(points[some], corners)) > 0.999  # smaller where the surface has holes
    return result


def _winding(points: Array, corners: Array) -> Array:
    """Return the winding number of triangles around points: the sum of solid angles over 4 pi, shape (p,).

    Source: Van Oosterom and Strackee 1983, The solid angle of a plane triangle.
    """
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    na, nb, nc = (np.sqrt((each**2).sum(axis=-1)) for each in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=-1)
    rest = na * nb * nc + (a * b).sum(axis=-1) * nc + (b * c).sum(axis=-1) * na + (c * a).sum(axis=-1) * nb
    return np.asarray(np.arctan2(volume, rest).sum(axis=1) / (2.0 * np.pi))
