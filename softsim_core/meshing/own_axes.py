"""The axes of a part that lies askew in its file: those of the smallest box around it."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from softsim_core.arrays import Array
from softsim_core.mesh.surface import triangle_normals
from softsim_core.mesh.types import SurfaceMesh

_SMALLER = 0.9  # a box along other axes is that much smaller, or the part lies along those of its file
_ALONG = 0.999  # cosine of the angle between a face and an axis that it is cut along
_NORMALS = 30


def own_axes(surface: SurfaceMesh) -> Array:
    """Axes along which a part is cut and long, as columns, shape (3, 3); proper, next to x, y and z.

    Those of the file, unless a box along others is clearly smaller and more of the part's faces lie along
    these. Tried are the largest faces of the convex hull and the principal axes of its corners, each with the
    best turn around it.

    Args:
        surface: Of the part, closed.
    """
    points = surface.points[np.unique(surface.triangles)]
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat
        return np.eye(3)
    corners = points[hull.vertices]
    best, found = _SMALLER * float(np.prod(np.ptp(corners, axis=0))), np.eye(3)
    for direction in _directions(corners, points[hull.simplices]):
        axes = _turned_about(direction, corners)
        volume = float(np.prod(np.ptp(corners @ axes, axis=0)))
        if volume < best * (1.0 - 1e-6):
            best, found = volume, axes
    return _next_to_file(found) if _along(surface, found) > _along(surface, np.eye(3)) else np.eye(3)


def _along(surface: SurfaceMesh, axes: Array) -> float:
    """Area in [m^2] of the faces that axes stand on."""
    normals = triangle_normals(surface.points, surface.triangles)
    sizes = np.linalg.norm(normals, axis=1)
    return float(sizes[np.abs(normals @ axes).max(axis=1) > _ALONG * sizes].sum())


def _directions(corners: Array, faces: Array) -> Array:
    """Directions in which the box is tried, shape (k, 3), unit."""
    areas = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    sizes = np.linalg.norm(areas, axis=1)
    normals = areas[sizes > 0.0] / sizes[sizes > 0.0, None]
    normals[normals[:, 2] < 0.0] *= -1.0
    _, group = np.unique(np.round(normals, 3), axis=0, return_inverse=True)
    weights = np.bincount(group.reshape(-1), sizes[sizes > 0.0])
    largest = np.argsort(-weights, kind="stable")[:_NORMALS]
    sums = [normals[group.reshape(-1) == each].sum(axis=0) for each in largest]
    principal = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]
    chosen = np.concatenate([np.array(sums).reshape(-1, 3), principal])
    return np.asarray(chosen / np.linalg.norm(chosen, axis=1, keepdims=True))


def _turned_about(direction: Array, corners: Array) -> Array:
    """A direction, and the two across it along which the rectangle around the corners is smallest, (3, 3)."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    seen = corners @ np.stack([first, second], axis=1)
    flat = seen[ConvexHull(seen).vertices]
    sides = np.roll(flat, -1, axis=0) - flat
    angles = np.arctan2(sides[:, 1], sides[:, 0])
    along, across = (np.stack([np.cos(a), np.sin(a)]) for a in (angles, angles + 0.5 * np.pi))
    areas = np.ptp(flat @ along, axis=0) * np.ptp(flat @ across, axis=0)
    k = int(areas.argmin())
    turned = np.stack([first, second], axis=1) @ np.stack([along[:, k], across[:, k]], axis=1)
    return np.column_stack([turned, direction])


def _next_to_file(axes: Array) -> Array:
    """The same three axes in the order and with the signs in which they are nearest to x, y and z."""
    order = list(max(permutations(range(3)), key=lambda each: float(np.abs(axes[:, list(each)]).trace())))
    result = axes[:, order] * np.sign(np.diag(axes[:, order]) + 1e-300)
    if np.linalg.det(result) < 0.0:
        weakest = int(np.abs(np.diag(result)).argmin())
        result[:, weakest] *= -1.0
    return np.asarray(result)
