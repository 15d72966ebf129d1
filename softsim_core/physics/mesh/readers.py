"""Readers and writers of mesh files; any error in a file is a MeshError."""

from __future__ import annotations

import contextlib
import importlib
import io
import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray, MeshError, Placement, write_file
from softsim_core.physics.mesh.checks import check_arrays, drop_unused_nodes
from softsim_core.physics.mesh.embedding import place
from softsim_core.physics.mesh.formats import (
    Block,
    drop_degenerate,
    is_gid,
    is_gmsh_41,
    parse_gid,
    parse_gmsh,
    parse_obj,
    parse_stl,
    read_vtu,
)
from softsim_core.physics.mesh.generators import FACES, cell_mesh
from softsim_core.physics.mesh.surface import boundary, triangle_normals
from softsim_core.physics.mesh.types import SurfaceMesh, TetMesh

_MESHIO_MODULES = {
    ".vtk": "vtk",
    ".vtu": "vtu",
    ".msh": "gmsh",
    ".inp": "abaqus",
    ".mesh": "medit",
    ".meshb": "medit",
    ".ply": "ply",
    ".off": "off",
    ".bdf": "nastran",
    ".nas": "nastran",
    ".vol": "netgen",
    ".xdmf": "xdmf",
    ".su2": "su2",
}
SUFFIXES = (".gidmsh", ".stl", ".obj", *_MESHIO_MODULES)
"""Suffixes of the readable formats, in lower case (upper case is read as well)."""

LONGEST_DETAIL = 150
"""Longest part of a parser's own message in an error, in characters."""

_KINDS = (
    ("vertex",),
    ("line", "line3"),
    ("triangle", "triangle6", "quad"),
    ("tetra", "tetra10", *FACES),
)
_DIMENSIONS = {kind: dimension for dimension, kinds in enumerate(_KINDS) for kind in kinds}
"""Dimensions of meshio's kinds of cells, as Gmsh counts them in the names of groups."""
_GID_NAMES = {"tetrahedra": "tetra", "hexahedra": "hexahedron", "quadrilateral": "quad"}
_NO_VOLUME = re.compile(r"vertex|line|triangle|quad|polygon|pixel|empty")
"""Beginnings of the names of kinds of cells that enclose no volume."""
_VTK_KINDS = ("UNSTRUCTURED_GRID", "STRUCTURED_POINTS", "STRUCTURED_GRID", "RECTILINEAR_GRID")
"""Readable data sets of legacy VTK files."""
_MAGIC = ((b"ply\n", ".ply"), (b"ply\r", ".ply"), (b"$MeshFormat", ".msh"))
"""First bytes of formats that these bytes alone identify."""
_NOT_READ = (
    (rb"ISO-10303-21;", "STEP"),
    (rb"glTF", "binary glTF"),
    (rb"PK\x03\x04", "zip, which 3MF and others are"),
    (rb"\x89HDF", "HDF5, which MED, CGNS and others are"),
    (rb"\x1f\x8b", "gzip"),
    (rb"\(\d+ ", "ANSYS Fluent"),
)
"""First bytes of formats that are not read, as patterns, and their names."""
_Cells = dict[str, list[IndexArray]]


class _Contents(NamedTuple):
    """Contents of a mesh file.

    Attributes:
        points: Shape (n, 3).
        cells: Index blocks by meshio's name of their kind ("tetra", "triangle", "quad", ...).
        surfaces: Corners (k, 3) of triangles by the name of their group.
        groups: Nodes by the name of the group of their points, lines, faces or cells, ascending.
        cell_groups: Cells by the name of their group and by their kind: their numbers among all of that kind,
            ascending.
    """

    points: Array
    cells: _Cells
    surfaces: dict[str, IndexArray]
    groups: dict[str, IndexArray]
    cell_groups: dict[str, dict[str, IndexArray]]


def read_tets(path: str | PathLike[str], placement: Placement | None = None) -> TetMesh:
    """Return the tetrahedra of a mesh file, linear or quadratic.

    Linear hexahedra, wedges and pyramids are split into tetrahedra, see `split_cells`; the mesh also holds
    them whole. Points, lines and faces are skipped. Nodes that no cell uses are dropped with a warning.

    Args:
        path: File in one of the formats of SUFFIXES.
        placement: From file units and axes to [m] in the world; None: the file is in metres already.

    Returns:
        The mesh, nodes and elements in file order, those of split cells after the others, named after the
        file.

    Raises:
        MeshError: the file is missing, unreadable, damaged, of an unknown format, or has no cells with a
            volume, both linear and quadratic ones, or some of a kind that is not read.
    """
    file = Path(path)
    with _one_error(file):
        mesh = _tet_mesh(_read(file), file)
        return replace(mesh, points=place(mesh.points, placement))


def _tet_mesh(contents: _Contents, file: Path) -> TetMesh:
    points, cells, surfaces, groups, cell_groups = contents
    supported = ("tetra", "tetra10", *FACES)
    unknown = [kind for kind in cells if kind not in supported and not _NO_VOLUME.match(kind)]
    if unknown:
        raise MeshError(
            file,
            f"holds cells of kinds that are not read: {', '.join(unknown)} ({_describe_cells(cells)}); "
            "export linear cells or quadratic tetrahedra",
        )
    blocks = {kind: np.concatenate(cells[kind]).astype(np.int64) for kind in supported if kind in cells}
    if not blocks:
        raise MeshError(
            file, f"holds no tetrahedra ({_describe_cells(cells)}); export a tetrahedral volume mesh"
        )
    if "tetra10" in blocks and len(blocks) > 1:
        raise MeshError(
            file, f"mixes linear and quadratic cells ({_describe_cells(cells)}); export all of one order"
        )
    corners = 10 if "tetra10" in blocks else 4
    tets = blocks.pop("tetra10", blocks.pop("tetra", np.empty((0, 4), dtype=np.int64)))
    for kind, block in blocks.items():
        check_arrays(points, block, block.shape[1], str(file), f"cells of kind {kind}")
    if len(tets):
        check_arrays(points, tets, corners, str(file))
    mesh = cell_mesh(points, tets, blocks, file, cell_groups)
    return drop_unused_nodes(replace(mesh, surfaces=surfaces, groups=groups))


def read_surface(path: str | PathLike[str], placement: Placement | None = None) -> SurfaceMesh:
    """Return triangles of a mesh file, or the boundary of its tetrahedra; faces with more corners are split.

    Points that no triangle uses are left out. Triangles with two corners in one point are dropped with a
    warning.

    Args:
        path: File in one of the formats of SUFFIXES.
        placement: From file units and axes to [m] in the world; None: the file is in metres already.

    Returns:
        The surface, vertices in file order (STL: in order of first appearance), named after the file.

    Raises:
        MeshError: the file is missing, unreadable, damaged, of an unknown format, or has no faces.
    """
    file = Path(path)
    with _one_error(file):
        return _surface(file, placement)


def _surface(file: Path, placement: Placement | None) -> SurfaceMesh:
    contents = _read(file)
    points, cells = contents.points, contents.cells
    polygons = [block for kind in ("triangle", "quad", "polygon") for block in cells.get(kind, [])]
    if polygons:  # as fans (a, b, c), (a, c, d), ...
        fans = (
            np.stack([block[:, [0, k, k + 1]] for k in range(1, block.shape[1] - 1)], axis=1)
            for block in polygons
        )
        triangles = np.concatenate([fan.reshape(-1, 3) for fan in fans]).astype(np.int64)
    elif any(not _NO_VOLUME.match(kind) for kind in cells):
        mesh = _tet_mesh(contents, file)
        points, triangles = mesh.points, boundary(mesh)
    else:
        raise MeshError(file, f"holds no triangles ({_describe_cells(cells)}); export a surface mesh")
    check_arrays(points, triangles, 3, str(file))
    triangles = drop_degenerate(triangles, file)
    if not len(triangles):
        raise MeshError(file, "holds only triangles with two corners in one point; the file is damaged")
    used, renumbered = np.unique(triangles, return_inverse=True)
    return SurfaceMesh(
        place(points[used], placement),
        np.ascontiguousarray(renumbered.reshape(-1, 3), dtype=np.int64),
        str(file),
    )


def _read(file: Path) -> _Contents:
    suffix = file.suffix.lower()
    if suffix not in (*SUFFIXES, ".vtp"):
        if file.is_file():
            with file.open("rb") as stream:
                _refuse_other_formats(stream.read(64), file)
        raise MeshError(
            file, f"suffix {file.suffix!r} names no known format; known are {', '.join(SUFFIXES)}"
        )
    if not file.exists():
        raise MeshError(file, "does not exist; check the path and the folder it is relative to")
    try:
        data = file.read_bytes()
    except OSError as error:
        raise MeshError(file, f"cannot be read: {error.strerror or error}") from error
    if not data.strip():
        raise MeshError(file, "is empty; export the mesh again")
    _refuse_other_formats(data, file)
    suffix = _suffix_of_content(data, file) or suffix
    if suffix == ".stl":
        points, triangles = parse_stl(data, file)
        return _Contents(points, {"triangle": [triangles]}, {}, {}, {})
    if suffix == ".obj":
        points, triangles = parse_obj(data, file)
        return _Contents(points, {"triangle": [triangles]}, {}, {}, {})
    if suffix == ".gidmsh" or (suffix == ".msh" and is_gid(data)):
        points, elements = parse_gid(data, file)
        blocks = {_GID_NAMES.get(kind, kind): [block] for kind, block in elements.items()}
        return _Contents(points, blocks, {}, {}, {})
    if suffix == ".msh" and is_gmsh_41(data):
        return _collect(*parse_gmsh(data, file))
    if suffix == ".ply" and not re.search(rb"^\s*end_header\s*$", data, re.MULTILINE):
        raise MeshError(file, "has no line end_header; the file is cut off")  # meshio would never end
    contents = _read_with_meshio(file, _MESHIO_MODULES[suffix], data)
    if suffix == ".vtk":  # meshio accepts files that end in the last section of VTK and Gmsh
        declared = re.findall(rb"^CELL_TYPES\s+(\d+)", data, re.MULTILINE)
        found = sum(len(block) for blocks in contents.cells.values() for block in blocks)
        if declared and int(declared[-1]) != found:
            raise MeshError(
                file, f"declares {int(declared[-1])} cells but holds {found}; the file is cut off"
            )
    elif suffix == ".msh" and b"$EndElements" not in data:
        raise MeshError(file, "ends without $EndElements; the file is cut off")
    return contents


def _refuse_other_formats(data: bytes, file: Path) -> None:
    name = next((name for pattern, name in _NOT_READ if re.match(pattern, data)), None)
    if name is not None:
        raise MeshError(
            file,
            f"is a file of the format {name}, which is not read; export a surface as STL, OBJ or PLY, "
            "a volume mesh for Gmsh or VTK",
        )


def _suffix_of_content(data: bytes, file: Path) -> str | None:
    """Return the suffix of the format that the first bytes identify, or None.

    Raises:
        MeshError: a VTK file of a kind that is not read, such as polygons.
    """
    start = data[:4096].lstrip()
    if start.startswith(b"# vtk DataFile"):
        found = re.search(rb"^\s*DATASET\s+(\w+)", start, re.MULTILINE)
        kind = found[1].decode() if found else None
        supported: tuple[str, ...] = _VTK_KINDS
        suffix = ".vtk"
    elif start.startswith(b"<") and (xml := re.search(rb"<VTKFile\b[^>]*?\btype\s*=\s*[\"'](\w+)", start)):
        kind, supported, suffix = xml[1].decode(), ("UnstructuredGrid",), ".vtu"
    else:
        return next((suffix for magic, suffix in _MAGIC if start.startswith(magic)), None)
    if kind is not None and kind not in supported:
        raise MeshError(
            file,
            f"is a VTK file of kind {kind}, which is not read; allowed are {', '.join(supported)}; save a "
            "surface as STL, OBJ or PLY",
        )
    return suffix


@contextlib.contextmanager
def _one_error(file: Path) -> Iterator[None]:
    """Raise any error inside as one MeshError, since parsers fail in many ways on damaged files."""
    try:
        yield
    except MeshError:
        raise
    except ImportError as error:
        suffix = file.suffix.lower()
        raise MeshError(file, f"a {suffix} file needs the Python package {error.name or 'meshio'}") from error
    except (Exception, SystemExit) as error:
        detail = " ".join(str(error).split())[:LONGEST_DETAIL]
        reason = f"{type(error).__name__}: {detail}" if detail else type(error).__name__
        what = f"is no valid {file.suffix.lower()} file, or damaged or cut off ({reason})"
        raise MeshError(file, what) from error


def _read_with_meshio(file: Path, module: str, data: bytes) -> _Contents:
    # The format's own reader, not meshio.read: that one prints, and ends the process with sys.exit on a
    # damaged file. Readers print warnings about fields we do not use; NumPy warns where text data end early,
    # which is an error here.
    reader = importlib.import_module(f"meshio.{module}")
    sink = io.StringIO()
    with contextlib.redirect_stdout(sink), contextlib.redirect_stderr(sink), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message="string or file could not be read to its end")
        mesh = read_vtu(file, data) if module == "vtu" else reader.read(str(file))
    names = {(dimension, tag): name for name, (tag, dimension) in mesh.field_data.items()}
    tags = [*mesh.cell_data.get("gmsh:physical", ()), *[None] * len(mesh.cells)]
    # Legacy VTK is big-endian and STL-like formats are float32: the core gets native float64.
    points = np.ascontiguousarray(mesh.points, dtype=np.float64)
    return _collect(points, map(partial(_grouped, names), mesh.cells, tags))


def _grouped(names: dict[tuple[int, int], str], block: Any, tags: Any) -> Block:
    """Return a block of meshio with its physical groups of Gmsh by their names, or else their numbers."""
    dimension = _DIMENSIONS.get(block.type, -1)
    groups = [] if tags is None else np.unique(tags[tags > 0]).tolist()
    named = [(names.get((dimension, tag), str(tag)), np.flatnonzero(tags == tag)) for tag in groups]
    return block.type, np.asarray(block.data, dtype=np.int64), named


def _collect(points: Array, blocks: Iterable[Block]) -> _Contents:
    """Return the contents of a file with blocks of cells."""
    contents, solids = _Contents(points, {}, {}, {}, {}), ("tetra", "tetra10", *FACES)
    faces: dict[str, list[IndexArray]] = {}
    nodes: dict[str, list[IndexArray]] = {}
    numbers: dict[str, dict[str, list[IndexArray]]] = {}
    for kind, cells, groups in blocks:
        first = sum(map(len, contents.cells.get(kind, [])))
        contents.cells.setdefault(kind, []).append(cells)
        for name, inside in groups:
            nodes.setdefault(name, []).append(cells[inside].reshape(-1))
            if kind in ("triangle", "triangle6"):
                faces.setdefault(name, []).append(cells[inside, :3])
            if kind in solids:
                numbers.setdefault(name, {}).setdefault(kind, []).append(first + inside)
    contents.surfaces.update({name: np.concatenate(each) for name, each in faces.items()})
    contents.groups.update({name: np.unique(np.concatenate(each)) for name, each in nodes.items()})
    for name, kinds in numbers.items():
        contents.cell_groups[name] = {kind: np.unique(np.concatenate(each)) for kind, each in kinds.items()}
    return contents


def _describe_cells(cells: _Cells) -> str:
    kinds = [f"{sum(len(block) for block in blocks)} {kind}" for kind, blocks in cells.items()]
    return f"found {', '.join(kinds)}" if kinds else "found no elements"


_VTK_TETRAHEDRON, _VTK_QUADRATIC_TETRAHEDRON = 10, 24
_GMSH_TETRAHEDRON, _GMSH_QUADRATIC_TETRAHEDRON, _GMSH_POINT = 4, 11, 15


def write_tets(path: str | PathLike[str], mesh: TetMesh) -> Path:
    """Write tetrahedra, and return the path; the suffix chooses the format, both lossless.

    `.msh` is Gmsh 2.2 as text, with the groups of the mesh as physical groups of points; any other suffix is
    a binary legacy VTK 2.0 unstructured grid (big-endian float64 and int32), without groups.

    Raises:
        MeshError: the file cannot be written.
    """
    path = Path(path)
    _write(path, *(_gmsh_text(mesh) if path.suffix.lower() == ".msh" else _vtk_text(mesh)))
    return path


def _vtk_text(mesh: TetMesh) -> list[bytes]:
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


def _gmsh_text(mesh: TetMesh) -> list[bytes]:
    """Return text of the groups' points, then of the cells of one volume; Gmsh swaps the last two nodes."""
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
    """Write triangles as binary STL (float32) and return the path; the header names the unit of the points.

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
