"""Wire frames of regions, and edges of tetrahedra, as line segments (k, 2, 3)."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from softsim_core.arrays import Array, IndexArray
from softsim_core.mechanics.pose import rotation_euler

CIRCLE_STEPS = 32


def box_lines(center: tuple[float, ...], size: tuple[float, ...], rotation_deg: tuple[float, ...]) -> Array:
    """The 12 edges of an oriented box, shape (12, 2, 3), in the unit of the arguments."""
    corners = np.array(list(product((-0.5, 0.5), repeat=3)))
    pairs = [(a, b) for a in range(8) for b in range(a + 1, 8) if (corners[a] != corners[b]).sum() == 1]
    placed = np.array(center) + (corners * np.array(size)) @ rotation_euler(np.radians(rotation_deg)).T
    return np.asarray(placed[np.array(pairs)])


def sphere_lines(center: tuple[float, ...], radius: float) -> Array:
    """Three circles of a sphere, shape (3 CIRCLE_STEPS, 2, 3)."""
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_STEPS + 1)
    lines = []
    for axis in range(3):
        circle = np.zeros((len(angle), 3))
        circle[:, (axis + 1) % 3], circle[:, (axis + 2) % 3] = np.cos(angle), np.sin(angle)
        lines.append(np.stack([circle[:-1], circle[1:]], axis=1))
    return np.asarray(np.array(center) + radius * np.concatenate(lines))


def tetrahedra_edges(tetrahedra: IndexArray) -> IndexArray:
    """Every edge of some tetrahedra once, as pairs of node indices, shape (e, 2)."""
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    edges = (
        np.concatenate([tetrahedra[:, pair] for pair in pairs]) if len(tetrahedra) else np.zeros((0, 2), int)
    )
    return np.asarray(np.unique(np.sort(edges, axis=1), axis=0))


def shrunk_faces(points: Array, tetrahedra: IndexArray, share: float) -> tuple[Array, IndexArray]:
    """Tetrahedra shrunk about their centres to `share`: vertices (4 m, 3), faces (4 m, 3)."""
    corners = points[tetrahedra]
    centre = corners.mean(axis=1, keepdims=True)
    vertices = (centre + share * (corners - centre)).reshape(-1, 3)
    sides = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    faces = (4 * np.arange(len(tetrahedra))[:, None, None] + sides).reshape(-1, 3)
    return vertices, faces


def normal_lines(points: NDArray[np.float32], triangles: IndexArray, length: float) -> NDArray[np.float32]:
    """From the middle of each triangle (k, 3) along its normal, shape (k, 2, 3); flat triangles have none."""
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1)
    keep = size > 0.0
    start = corners[keep].mean(axis=1)
    end = start + length * normals[keep] / size[keep, None]
    return np.stack([start, end], axis=1).astype(np.float32)
