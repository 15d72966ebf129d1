"""Whether a point of one surface lies inside another, at any depth: for the start of a scene."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, BoolArray
from softsim_core.contact.surfaces import CollisionSurface, may_meet

_CHUNK = 1 << 18


def first_inside(surfaces: tuple[CollisionSurface, ...], points: Array) -> tuple[int, int] | None:
    """Numbers of a surface with a vertex inside another one, and of that other one; or None.

    Args:
        surfaces: Surfaces over the vertices.
        points: Vertex positions in [m], shape (v, 3).
    """
    for b, outer in enumerate(surfaces):
        for a, inner in enumerate(surfaces):
            if outer.closed and inner.owner != outer.owner and may_meet(inner, outer):
                corners = points[outer.triangles]
                if inside(points[inner.vertices], corners, points[outer.vertices], outer.radius).any():
                    return a, b
    return None


def inside(points: Array, corners: Array, vertices: Array, radius: float) -> BoolArray:
    """Which points (p, 3) lie inside closed triangles (k, 3, 3), or in the sphere about its vertex."""
    if radius > 0.0:
        return np.asarray(((points - vertices[0]) ** 2).sum(axis=1) < radius**2)
    result = np.zeros(len(points), dtype=bool)
    near = np.flatnonzero(((points > vertices.min(axis=0)) & (points < vertices.max(axis=0))).all(axis=1))
    step = max(1, _CHUNK // max(1, len(corners)))
    for some in np.split(near, range(step, len(near), step)):
        result[some] = np.abs(_winding(points[some], corners)) > 0.9  # on a face 0.5
    return result


def _winding(points: Array, corners: Array) -> Array:
    """Times that triangles wind around points: the sum of their solid angles over 4 pi, shape (p,).

    Source: Van Oosterom and Strackee 1983, The solid angle of a plane triangle.
    """
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    na, nb, nc = (np.sqrt((each**2).sum(axis=-1)) for each in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=-1)
    rest = na * nb * nc + (a * b).sum(axis=-1) * nc + (b * c).sum(axis=-1) * na + (c * a).sum(axis=-1) * nb
    return np.asarray(np.arctan2(volume, rest).sum(axis=1) / (2.0 * np.pi))
