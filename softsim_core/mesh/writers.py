"""Writing meshes: legacy VTK for tetrahedra, binary STL for surfaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from softsim_core.errors import MeshError
from softsim_core.mesh.surface import triangle_normals
from softsim_core.mesh.types import SurfaceMesh, TetMesh

_VTK_TETRAHEDRON, _VTK_QUADRATIC_TETRAHEDRON = 10, 24


def write_tets(path: Path, mesh: TetMesh) -> Path:
    """Write tetrahedra as a binary legacy VTK 2.0 unstructured grid (big-endian float64 and int32, lossless).

    Returns:
        The path.

    Raises:
        MeshError: the file cannot be written.
    """
    n, (m, corners) = len(mesh.points), mesh.tets.shape
    kind = _VTK_TETRAHEDRON if mesh.order == 1 else _VTK_QUADRATIC_TETRAHEDRON
    cells = np.column_stack([np.full(m, corners), mesh.tets]).astype(">i4")
    title = mesh.name.encode("ascii", "replace").splitlines()[0] if mesh.name else b"mesh"
    _write(
        path,
        b"# vtk DataFile Version 2.0\n" + title[:255] + b"\nBINARY\nDATASET UNSTRUCTURED_GRID\n",
        f"POINTS {n} double\n".encode() + mesh.points.astype(">f8").tobytes(),
        f"\nCELLS {m} {cells.size}\n".encode() + cells.tobytes(),
        f"\nCELL_TYPES {m}\n".encode() + np.full(m, kind, ">i4").tobytes() + b"\n",
    )
    return path


def write_surface(path: Path, surface: SurfaceMesh) -> Path:
    """Write triangles as binary STL (float32).

    Returns:
        The path.

    Raises:
        MeshError: the file cannot be written.
    """
    normals = triangle_normals(surface.points, surface.triangles)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets = np.zeros(len(normals), np.dtype([("vectors", "<f4", (4, 3)), ("attribute", "<u2")]))
    facets["vectors"][:, 0] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    facets["vectors"][:, 1:] = surface.points[surface.triangles]
    header = b"binary STL, lengths in metres".ljust(80, b"\0")
    _write(path, header, np.uint32(len(normals)).astype("<u4").tobytes(), facets.tobytes())
    return path


def _write(path: Path, *parts: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"".join(parts))
    except OSError as error:
        raise MeshError(path, f"cannot be written: {error.strerror or error}") from error
