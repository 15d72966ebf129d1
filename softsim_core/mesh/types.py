"""Meshes as immutable arrays in [m]."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from softsim_core.arrays import Array, IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class TetMesh:
    """A mesh of linear or quadratic tetrahedra.

    Attributes:
        points: Node positions in [m], shape (n, 3).
        tets: Node indices, shape (m, 4), or (m, 10) with nodes on the edges, see mesh.quadratic; positively
            oriented or not (the volume is taken absolute).
        name: Where it came from, for messages.
        surfaces: Faces by the names that the file gives them, by the indices of their corners, shapes (k, 3).
        groups: Nodes by the names that the file gives to what they belong to: points, lines, faces or cells.
        cell_groups: Cells by the names that the file gives to volumes: rows of `tets`, ascending.
        around: How far outside, in heights of a cell, a point may lie that an actuator binds to it.
    """

    points: Array
    tets: IndexArray
    name: str = "mesh"
    surfaces: Mapping[str, IndexArray] = field(default_factory=dict)
    groups: Mapping[str, IndexArray] = field(default_factory=dict)
    cell_groups: Mapping[str, IndexArray] = field(default_factory=dict)
    around: float = 0.02

    @property
    def order(self) -> int:
        """1 for linear cells, 2 for quadratic ones."""
        return 2 if self.tets.shape[1:] == (10,) else 1


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMesh:
    """A mesh of triangles, outward where closed.

    Attributes:
        points: Vertex positions in [m], shape (n, 3).
        triangles: Vertex indices, shape (k, 3).
        name: Where it came from, for messages.
    """

    points: Array
    triangles: IndexArray
    name: str = "surface"
