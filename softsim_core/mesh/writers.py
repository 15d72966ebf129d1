"""Writing meshes: legacy VTK or Gmsh for tetrahedra, binary STL for surfaces."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from softsim_core.errors import MeshError
from softsim_core.file_writing import write_file
from softsim_core.mesh.surface import triangle_normals
from softsim_core.mesh.types import SurfaceMesh, TetMesh

_VTK_TETRAHEDRON, _VTK_QUADRATIC_TETRAHEDRON = 10, 24
_GMSH_TETRAHEDRON, _GMSH_QUADRATIC_TETRAHEDRON, _GMSH_POINT = 4, 11, 15


def write_tets(path: str | PathLike[str], mesh: TetMesh) -> Path:
    """Write tetrahedra; the suffix chooses the format, both lossless.

    `.msh` is Gmsh 2.2 as text, with the groups of the mesh as physical groups of points; anything else a
    binary legacy VTK 2.0 unstructured grid (big-endian float64 and int32), without groups.

    Returns:
        The path.

    Raises:
        MeshError: the file cannot be written.
    """
    path = Path(path)
    _write(path, *(_gmsh(mesh) if path.suffix.lower() == ".msh" else _vtk(mesh)))
    return path


def _vtk(mesh: TetMesh) -> list[bytes]:
    n, (m, corners) = len(mesh.points), mesh.tets.shape
    kind = _VTK_TETRAHEDRON if mesh.order == 1 else _VTK_QUADRATIC_TETRAHEDRON
    cells = np.column_stack([np.full(m, corners), mesh.tets]).astype(">i4")
    title = mesh.name.encode("ascii", "replace").splitlines()[0] if mesh.name else b"mesh"
    return [
        b"# vtk DataFile Version 2.0\n" + title[:255] + b"\nBINARY\nDATASET UNSTRUCTURED_GRID\n",
        f"POINTS {n} double\n".encode() + mesh.points.astype(">f8").tobytes(),
        f"\nCELLS {m} {cells.size}\n".encode() + cells.tobytes(),
        f"\nCELL_TYPES {m}\n".encode() + np.full(m, kind, ">i4").tobytes() + b"\n",
    ]


def _gmsh(mesh: TetMesh) -> list[bytes]:
    """Points of the groups, then cells of one volume; Gmsh has the last two nodes the other way."""
    kind = _GMSH_TETRAHEDRON if mesh.order == 1 else _GMSH_QUADRATIC_TETRAHEDRON
    cells = (mesh.tets if mesh.order == 1 else mesh.tets[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]) + 1
    nodes = (f"{k} {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(mesh.points.tolist(), start=1))
    names = [f'0 {g} "{name}"' for g, name in enumerate(mesh.groups, start=1)]
    points = [
        f"{_GMSH_POINT} 2 {g} {node + 1} {node + 1}"
        for g, members in enumerate(mesh.groups.values(), start=1)
        for node in members.tolist()
    ]
    solids = [f"{kind} 2 0 1 {' '.join(map(str, cell))}" for cell in cells.tolist()]
    elements = [f"{k} {each}" for k, each in enumerate((*points, *solids), start=1)]
    lines = [
        *("$MeshFormat", "2.2 0 8", "$EndMeshFormat"),
        *(("$PhysicalNames", str(len(names)), *names, "$EndPhysicalNames") if names else ()),
        *("$Nodes", str(len(mesh.points)), *nodes, "$EndNodes"),
        *("$Elements", str(len(elements)), *elements, "$EndElements", ""),
    ]
    return ["\n".join(lines).encode()]


def write_surface(path: str | PathLike[str], surface: SurfaceMesh, unit: str = "metres") -> Path:
    """Write triangles as binary STL (float32), whose header names the unit of the points.

    Returns:
        The path.

    Raises:
        MeshError: the file cannot be written.
    """
    path = Path(path)
    normals = triangle_normals(surface.points, surface.triangles)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets = np.zeros(len(normals), np.dtype([("vectors", "<f4", (4, 3)), ("attribute", "<u2")]))
    facets["vectors"][:, 0] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    facets["vectors"][:, 1:] = surface.points[surface.triangles]
    header = f"binary STL, lengths in {unit}".encode().ljust(80, b"\0")
    _write(path, header, np.uint32(len(normals)).astype("<u4").tobytes(), facets.tobytes())
    return path


def _write(path: Path, *parts: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, b"".join(parts))
    except OSError as error:
        raise MeshError(path, f"cannot be written: {error.strerror or error}") from error
