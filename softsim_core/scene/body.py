"""A deformable body of a scene, compiled."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_core.arrays import IndexArray
from softsim_core.mesh import Embedding, SurfaceMesh, TetMesh


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A body within the model: its nodes and elements are contiguous.

    Attributes:
        name: Name of the body.
        nodes: Slice of the model's nodes.
        mesh: Its tetrahedra, with its own node numbers.
        boundary: Boundary triangles with the model's node numbers, shape (k, 3).
        surface: Visual surface at rest.
        embedding: How the visual surface follows the body's nodes.
    """

    name: str
    nodes: slice
    mesh: TetMesh
    boundary: IndexArray
    surface: SurfaceMesh
    embedding: Embedding
