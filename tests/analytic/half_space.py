"""A half ball whose nodes stand close around the middle of its flat side: a half space to press on."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from softsim_core.physics.mesh import TetMesh, orient_tets

CORE = 1.5
"""Radius of the evenly meshed core over the radius of contact."""


def half_ball(radius: float, outer: float, spacing: float, growth: float) -> TetMesh:
    """Half ball below z = 0 around the origin.

    Args:
        radius: Expected radius of contact in [m].
        outer: Radius of the half ball in [m].
        spacing: Distance of nodes in the core in [m].
        growth: Distance of nodes outside, over their distance from the origin.
    """
    random, core = np.random.default_rng(1), CORE * radius
    count = int(core / spacing)
    along = np.arange(-count, count + 1) * spacing
    grid = np.stack(np.meshgrid(along, along, along[: count + 1], indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[np.linalg.norm(grid, axis=1) <= core]
    deep = grid[:, 2] < -0.5 * spacing
    grid[deep] += random.uniform(-0.15, 0.15, (deep.sum(), 3)) * spacing  # no cubes: Delaunay would be torn
    points, shell = [grid], core + 0.8 * spacing
    while shell < outer:
        points.append(_shell(shell, growth, random))
        shell *= 1.0 + 0.85 * growth
    points.append(_shell(outer, growth, random))
    nodes = np.concatenate(points)
    tets = Delaunay(nodes).simplices
    edges = nodes[tets[:, 1:]] - nodes[tets[:, :1]]
    flat = np.abs(np.linalg.det(edges)) < 1e-3 * np.linalg.norm(edges, axis=2).max(axis=1) ** 3
    used, numbered = np.unique(tets[~flat], return_inverse=True)
    return TetMesh(nodes[used], orient_tets(nodes[used], numbered.reshape(-1, 4)), "half_ball")


def _shell(radius: float, growth: float, random: np.random.Generator) -> np.ndarray:
    """Nodes on a half sphere: a rim, and a Fibonacci lattice below it."""
    rim = max(8, round(2.0 * np.pi / growth))
    turn = 2.0 * np.pi * (np.arange(rim) + random.uniform()) / rim
    count = int(2.2 * np.pi / growth**2)
    index = np.arange(count) + 0.5
    z = -index / count
    index, z = index[z < -0.4 * growth], z[z < -0.4 * growth]
    around, wide = index * np.pi * (1.0 + 5.0**0.5), np.sqrt(1.0 - z * z)
    return radius * np.concatenate(
        [
            np.column_stack([np.cos(turn), np.sin(turn), np.zeros(rim)]),
            np.column_stack([wide * np.cos(around), wide * np.sin(around), z]),
        ]
    )
