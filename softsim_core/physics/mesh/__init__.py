"""Meshes: types, readers, checks, surfaces, embedding, and generators of our own robots.

`softsim_core.robots.tripod_mesh` makes the Tripod's silicone; meshio is imported only when a file needs it.
"""

from softsim_core.physics.mesh.checks import MeshReport, check_tets, drop_unused_nodes
from softsim_core.physics.mesh.embedding import Embedding, embed, place, rotation_matrix
from softsim_core.physics.mesh.generators import box_mesh
from softsim_core.physics.mesh.readers import read_surface, read_tets, write_surface, write_tets
from softsim_core.physics.mesh.surface import (
    boundary,
    boundary_surface,
    closest_point,
    enclosed_volume,
    euler_number,
    is_closed,
    vertex_normals,
)
from softsim_core.physics.mesh.types import SurfaceMesh, TetMesh, linear, quadratic, subdivided

__all__ = [
    "Embedding",
    "MeshReport",
    "SurfaceMesh",
    "TetMesh",
    "boundary",
    "boundary_surface",
    "box_mesh",
    "check_tets",
    "closest_point",
    "drop_unused_nodes",
    "embed",
    "enclosed_volume",
    "euler_number",
    "is_closed",
    "linear",
    "place",
    "quadratic",
    "read_surface",
    "read_tets",
    "rotation_matrix",
    "subdivided",
    "vertex_normals",
    "write_surface",
    "write_tets",
]
