"""Meshes from numbers: extruded triangulations and boxes, split into tetrahedra that mirror images share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import MeshError
from softsim_core.mesh.types import TetMesh

_KUHN_PATHS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


def oriented(points: Array, tets: IndexArray) -> IndexArray:
    """The same tetrahedra, the last two nodes swapped where the signed volume is negative, shape (m, 4)."""
    corners = points[tets]
    edges = corners[:, 1:] - corners[:, :1]
    negative = np.linalg.det(edges) < 0.0
    result = np.array(tets, dtype=np.int64, order="C")
    result[negative, 2], result[negative, 3] = tets[negative, 3], tets[negative, 2]
    return result


def extrude(
    points: Array, triangles: IndexArray, labels: IndexArray, heights: Array
) -> tuple[Array, IndexArray]:
    """Tetrahedra of a plane triangulation swept along z: three for the prism of each triangle and layer.

    A prism is cut along the diagonals that rise from the lower to the higher label (the other way round in
    every second layer), so prisms that share a face agree on it, and triangles that are mirror images of each
    other with equal labels are cut into mirror images.

    Args:
        points: Coordinates in [m], shape (n, 2).
        triangles: Index triples, shape (k, 3).
        labels: One integer a point, shape (n,); the three labels of a triangle differ.
        heights: Rising z of the layers in [m], shape (layers + 1,).

    Returns:
        Points, shape ((layers + 1) n, 3), layer by layer; positively oriented tets, shape (3 k layers, 4).
    """
    n, layers = len(points), len(heights) - 1
    solid = np.column_stack([np.tile(points, (layers + 1, 1)), np.repeat(heights, n)])
    order = np.take_along_axis(triangles, np.argsort(labels[triangles], axis=1), axis=1)
    tets = []
    for layer in range(layers):
        a, b, c = (order if layer % 2 == 0 else order[:, ::-1]).T + layer * n
        for tet in ((a, b, c, c + n), (a, b, b + n, c + n), (a, a + n, b + n, c + n)):
            tets.append(np.column_stack(tet))
    return solid, oriented(solid, np.concatenate(tets))


def box_mesh(
    lengths: Sequence[float],
    cells: Sequence[int],
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    name: str = "box",
) -> TetMesh:
    """Structured box: every cell six tetrahedra around a space diagonal (Kuhn), mirrored from cell to cell.

    With even numbers of cells the mesh is its own mirror image in the three middle planes.

    Args:
        lengths: Edge lengths along x, y, z in [m], > 0.
        cells: Numbers of cells along x, y, z, >= 1.
        origin: Corner with the smallest coordinates in [m].
        name: Name of the mesh.

    Returns:
        Positively oriented mesh; node (i, j, k) has index (i (cells_y + 1) + j) (cells_z + 1) + k.

    Raises:
        MeshError: a length is not > 0 or a number of cells not >= 1.
    """
    if len(lengths) != 3 or not all(0.0 < length < np.inf for length in lengths):
        raise MeshError(name, f"lengths {list(lengths)} must be three numbers > 0 m")
    if len(cells) != 3 or not all(count >= 1 for count in cells):
        raise MeshError(name, f"cells {list(cells)} must be three whole numbers >= 1")
    axes = [
        start + np.linspace(0.0, length, count + 1)
        for start, length, count in zip(origin, lengths, cells, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    node = np.arange(len(points)).reshape([count + 1 for count in cells])
    cell = np.stack(np.meshgrid(*[np.arange(count) for count in cells], indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    low, step = (
        cell + cell % 2,
        1 - 2 * (cell % 2),
    )  # odd cells start at their far corner: neighbours are mirrored
    tets = []
    for path in _KUHN_PATHS:
        corner = low.copy()
        corners = [node[tuple(corner.T)]]
        for axis in path:
            corner[:, axis] += step[:, axis]
            corners.append(node[tuple(corner.T)])
        tets.append(np.column_stack(corners))
    return TetMesh(points, oriented(points, np.stack(tets, axis=1).reshape(-1, 4)), name)
