"""Meshes: types, readers, checks, surfaces, embedding, and generators of our own robots."""

from softsim_core.mesh.types import SurfaceMesh, TetMesh

__all__ = ["SurfaceMesh", "TetMesh"]
