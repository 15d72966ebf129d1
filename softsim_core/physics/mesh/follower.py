"""The visual surfaces of several bodies, joined into one surface that follows the nodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from softsim_core.base import Array, IndexArray
from softsim_core.physics.mesh.embedding import Embedding
from softsim_core.physics.mesh.types import SurfaceMesh


class SurfaceFollower:
    """Surfaces bound to nodes.

    Args:
        parts: For each body its surface at rest, its embedding, and the number of the body's first node.
        count: Number of nodes of all bodies, n.

    Attributes:
        triangles: Vertex indices of all surfaces, shape (k, 3).
        rest_points: Vertices at rest in [m], shape (p, 3).
    """

    def __init__(self, parts: Sequence[tuple[SurfaceMesh, Embedding, int]], count: int) -> None:
        starts = np.cumsum([0] + [len(surface.points) for surface, _, _ in parts])
        self.triangles: IndexArray = np.concatenate(
            [np.zeros((0, 3), np.int64)]
            + [surface.triangles + start for (surface, _, _), start in zip(parts, starts, strict=False)]
        )
        self.rest_points: Array = np.concatenate(
            [np.zeros((0, 3))] + [surface.points for surface, _, _ in parts]
        )
        nodes = [np.zeros((0, 4), np.int64)] + [embedding.nodes + first for _, embedding, first in parts]
        weights = [np.zeros((0, 4))] + [embedding.weights for _, embedding, _ in parts]
        points = len(self.rest_points)
        self._weights = csr_array(
            (np.concatenate(weights).ravel(), np.concatenate(nodes).ravel(), 4 * np.arange(points + 1)),
            shape=(points, count),
        )

    def follow(self, nodal: Array) -> Array:
        """Return nodal values (n,) or vectors (n, 3) interpolated at the vertices, shape (p,) or (p, 3)."""
        return np.asarray(self._weights @ nodal)
