"""A deformable body of a scene, compiled."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_core.arrays import Array, IndexArray
from softsim_core.fem.rods import RodSections
from softsim_core.mesh import Embedding, SurfaceMesh, TetMesh
from softsim_core.mesh.rods import RodMesh


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A body within the model: its nodes and elements are contiguous.

    Attributes:
        name: Name of the body.
        nodes: Slice of the model's nodes.
        mesh: Its tetrahedra, or the sections of a rod, with its own node numbers.
        boundary: Boundary triangles with the model's node numbers, shape (k, 3).
        surface: Visual surface at rest.
        embedding: How the visual surface follows the body's nodes.
        sections: How stiff the sections of a rod are; None: it is none.
        unloaded: Where the nodes of its tetrahedra are without load in [m], shape (n, 3); None: as in `mesh`.
        ends: Nodes of the ends of a slender body, with its own numbers; None: it has none.
    """

    name: str
    nodes: slice
    mesh: TetMesh | RodMesh
    boundary: IndexArray
    surface: SurfaceMesh
    embedding: Embedding
    sections: RodSections | None = None
    unloaded: Array | None = None
    ends: tuple[IndexArray, IndexArray] | None = None

    @property
    def cells(self) -> IndexArray:
        """Nodes of its cells, with its own numbers, shape (m, a)."""
        return self.mesh.cells if isinstance(self.mesh, RodMesh) else self.mesh.tets

    @property
    def outside(self) -> SurfaceMesh:
        """What others touch at rest: the boundary of its tetrahedra, or the surface of a rod."""
        if isinstance(self.mesh, RodMesh):
            return self.surface
        return SurfaceMesh(self.mesh.points, self.boundary - self.nodes.start, self.name)

    @property
    def solid(self) -> TetMesh:
        """Tetrahedra that points are bound to: its cells, or those between the nodes of a rod."""
        return self.mesh.solid if isinstance(self.mesh, RodMesh) else self.mesh

    @property
    def region_points(self) -> Array:
        """Where each node is at rest for regions that choose nodes, in [m]: of a rod its section's centre."""
        return self.mesh.region_points if isinstance(self.mesh, RodMesh) else self.mesh.points
