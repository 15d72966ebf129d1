"""Tetrahedra along a curve: a slender body as it lies there, and the same body straight."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.mesh.generators import box_mesh
from softsim_core.mesh.quadratic import quadratic
from softsim_core.mesh.types import TetMesh


@dataclass(frozen=True, slots=True, eq=False)
class SweptMesh:
    """A body with rectangular cross-sections along a curve.

    Attributes:
        mesh: Its tetrahedra as they lie along the curve.
        straight: Places of its nodes in [m] where it is straight, along x from the origin on, shape (n, 3).
        ends: Nodes of its first and of its last cross-section.
    """

    mesh: TetMesh
    straight: Array
    ends: tuple[IndexArray, IndexArray]


def swept_mesh(
    centres: Array, axes: Array, sizes: Array, length: float, across: tuple[int, int], order: int, name: str
) -> SweptMesh:
    """Tetrahedra between cross-sections: boxes of six, mirrored from box to box; see generators.box_mesh.

    Args:
        centres: Of 2 m + 1 cross-sections in [m], ends and middles of m boxes in order, shape (2 m + 1, 3).
        axes: Rotation of each: tangent, first and second axis, as columns, shape (2 m + 1, 3, 3).
        sizes: Full extent of each along both axes in [m], shape (2 m + 1, 2).
        length: In [m], where it is straight.
        across: Boxes along the first and the second axis.
        order: 1, or 2 with nodes on the edges, which then lie on the curve, too.
        name: For messages.
    """
    last = len(centres) - 1
    boxes = box_mesh((last, 2.0, 2.0), (last // 2, *across), (0.0, -1.0, -1.0), name)
    boxes = quadratic(boxes) if order == 2 else boxes
    section = np.rint(boxes.points[:, 0]).astype(np.int64)
    place = 0.5 * boxes.points[:, 1:] * sizes[section]
    drawn = centres[section] + np.einsum("nij,nj->ni", axes[section][..., 1:], place)
    straight = np.column_stack([length / last * section, place])
    ends = np.flatnonzero(section == 0), np.flatnonzero(section == last)
    return SweptMesh(replace(boxes, points=drawn), straight, ends)
