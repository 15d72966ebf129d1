"""Linear tetrahedra at rest: volumes and shape-function gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.fem.corotational import element_frames


@dataclass(frozen=True, slots=True, eq=False)
class Tetrahedra:
    """Rest data of linear tetrahedra, each in a frame of its own.

    The frame (first edge, plane of the first three nodes) makes the `qr` rotation law plain: at rest every
    element's rotation is its frame. Isotropic elasticity does not see the choice, so the `polar` law uses the
    same data.

    Attributes:
        nodes: Node indices, shape (m, 4).
        volumes: Rest volumes in [m^3], shape (m,), all > 0.
        gradients: Gradients of the four shape functions in the element frame in [1/m], shape (m, 4, 3).
    """

    nodes: IndexArray
    volumes: Array
    gradients: Array


def rest_tetrahedra(points: Array, tets: IndexArray) -> Tetrahedra:
    """Rest data of the tetrahedra `tets` (m, 4) on `points` (n, 3) in [m]; orientation does not matter."""
    corners = points[tets]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)  # columns: edges from the first node
    frames = element_frames(corners)
    inverse = np.linalg.inv(
        np.swapaxes(frames, 1, 2) @ edges
    )  # rows: gradients of nodes 1, 2, 3 in the frame
    gradients = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    volumes = np.abs(np.linalg.det(edges)) / 6.0
    return Tetrahedra(nodes=tets, volumes=volumes, gradients=np.ascontiguousarray(gradients))
