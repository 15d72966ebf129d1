"""Mesh files: formats, units and axes, and what is said about files that are no meshes."""

from __future__ import annotations

import base64
import lzma
import subprocess
import sys
import tracemalloc
import warnings
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import meshio
import numpy as np
import pytest

from softsim_core.base import MeshError, Placement
from softsim_core.physics.mesh import (
    TetMesh,
    boundary_surface,
    box_mesh,
    enclosed_volume,
    read_surface,
    read_tets,
    write_surface,
    write_tets,
)

GID = """MESH dimension 3 ElemType Tetrahedra Nnode 4
Coordinates
    1  0 0 0
    2  1 0 0
    3  0 1 0
    4  0 0 1
    5  1 1 1
End Coordinates

Elements
1 1 2 3 4
2 2 3 4 5
End Elements
"""
TETRAHEDRON_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
ONE_FACET = """facet normal 0 0 1
 outer loop
  vertex 0 0 0
  vertex 1 0 0
  vertex 0 1 0
 endloop
endfacet
"""


@pytest.fixture
def box() -> TetMesh:
    return box_mesh((1.0, 2.0, 3.0), (1, 2, 2))


def written(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("box.vtk", {"file_format": "vtk42", "binary": True}),
        ("box.vtk", {"file_format": "vtk42", "binary": False}),
        ("box.vtk", {"file_format": "vtk51", "binary": True}),
        ("box.vtu", {"binary": False}),
        ("box.vtu", {"binary": True}),
        ("box.vtu", {"binary": True, "compression": "lzma"}),
        ("box.vtu", {"binary": True, "compression": None}),
        ("box.vtu", {"binary": True, "header_type": "UInt64"}),
        ("box.msh", {"file_format": "gmsh"}),
        ("box.msh", {"file_format": "gmsh22", "binary": False}),
        ("box.inp", {}),
        ("box.mesh", {}),
        ("BOX.VTU", {"file_format": "vtu", "binary": False}),
    ],
)
def test_tetrahedra_survive_every_format(tmp_path: Path, box: TetMesh, name: str, options: dict) -> None:
    meshio.write(tmp_path / name, meshio.Mesh(box.points, [("tetra", box.tets)]), **options)
    mesh = read_tets(tmp_path / name)
    np.testing.assert_array_equal(mesh.tets, box.tets)
    np.testing.assert_allclose(mesh.points, box.points, atol=1e-12)
    for array, kind in ((mesh.points, np.float64), (mesh.tets, np.int64)):
        assert array.dtype == kind
        assert array.dtype.isnative
        assert array.flags.c_contiguous
    assert mesh.name == str(tmp_path / name)


def packed_zeros(megabytes: int, compress: Callable[[bytes], bytes]) -> str:
    """A compressed array of a VTU file: one block of a mebibyte of zeros, so many times."""
    block = compress(bytes(1 << 20))
    header = np.array([megabytes, 1 << 20, 0, *[len(block)] * megabytes], dtype=np.uint32)
    return (base64.b64encode(header.tobytes()) + base64.b64encode(megabytes * block)).decode()


@pytest.mark.slow
@pytest.mark.parametrize("declared", [8, 25_000_000, 10**17], ids=["few", "as many as there are", "too many"])
@pytest.mark.parametrize(
    ("compressor", "compress"), [("ZLib", zlib.compress), ("LZMA", lzma.compress)], ids=["zlib", "lzma"]
)
def test_a_small_file_that_unpacks_to_much_is_refused_before_it_has(
    tmp_path: Path, compressor: str, compress: Callable[[bytes], bytes], declared: int
) -> None:
    """572 MiB of points in less than a megabyte, whatever the header says of their number."""
    file = written(
        tmp_path,
        "large.vtu",
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" '
        f'compressor="vtk{compressor}DataCompressor"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{declared}" NumberOfCells="1"><Points><DataArray type="Float64" '
        f'Name="Points" NumberOfComponents="3" format="binary">{packed_zeros(572, compress)}</DataArray>'
        "</Points></Piece></UnstructuredGrid></VTKFile>",
    )
    assert file.stat().st_size < 1_000_000
    tracemalloc.start()
    try:
        with pytest.raises(MeshError, match=r"holds compressed arrays of more than [\d,]+ bytes"):
            read_tets(file)
        assert tracemalloc.get_traced_memory()[1] < 350 << 20
    finally:
        tracemalloc.stop()


def test_own_vtk_is_lossless(tmp_path: Path, box: TetMesh) -> None:
    points = box.points + np.random.default_rng(1).normal(scale=0.01, size=box.points.shape)
    mesh = read_tets(write_tets(tmp_path / "mesh.vtk", TetMesh(points, box.tets)))
    assert mesh.points.tobytes() == points.tobytes()
    assert mesh.tets.tobytes() == box.tets.tobytes()


def test_other_cells_are_skipped(tmp_path: Path, box: TetMesh) -> None:
    cells = [("vertex", [[0]]), ("line", [[0, 1]]), ("triangle", [[0, 1, 2]]), ("tetra", box.tets)]
    meshio.write(tmp_path / "mixed.vtk", meshio.Mesh(box.points, cells), file_format="vtk42")
    np.testing.assert_array_equal(read_tets(tmp_path / "mixed.vtk").tets, box.tets)


def test_surface_of_a_volume_file_is_its_boundary(tmp_path: Path, box: TetMesh) -> None:
    surface = read_surface(write_tets(tmp_path / "mesh.vtk", box))
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(6.0)


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_gid_text_by_either_suffix(tmp_path: Path, ending: str) -> None:
    for name in ("part.gidmsh", "part.MSH"):
        mesh = read_tets(written(tmp_path, name, GID.replace("\n", ending)))
        assert mesh.tets.tolist() == [[0, 1, 2, 3], [1, 2, 3, 4]]
        assert mesh.points[4].tolist() == [1.0, 1.0, 1.0]


def test_gid_node_numbers_may_have_gaps(tmp_path: Path) -> None:
    text = GID.replace("    5  1 1 1", "   50  1 1 1").replace("2 2 3 4 5", "2 2 3 4 50 7")  # 7: a material
    assert read_tets(written(tmp_path, "part.gidmsh", text)).tets.tolist() == [[0, 1, 2, 3], [1, 2, 3, 4]]


def test_placement_scales_rotates_and_shifts(tmp_path: Path) -> None:
    placement = Placement(scale=0.001, rotation_deg=(90.0, 0.0, 0.0), translation=(0.0, 0.0, 0.025))
    mesh = read_tets(written(tmp_path, "part.gidmsh", GID), placement)
    np.testing.assert_allclose(mesh.points[2], [0.0, 0.0, 0.026], atol=1e-17)  # y became z
    np.testing.assert_allclose(mesh.points[3], [0.0, -0.001, 0.025], atol=1e-17)


def test_stl_text_with_carriage_returns_and_upper_case(tmp_path: Path) -> None:
    text = f"solid part vertex\n{ONE_FACET}{ONE_FACET.replace('1 0 0', '0 -1 -0.0')}endsolid part\n"
    for content in (text, text.replace("\n", "\r\n"), text.replace("\n", "\r"), text.upper()):
        surface = read_surface(written(tmp_path, "PART.STL", content))
        assert surface.triangles.tolist() == [[0, 1, 2], [0, 3, 2]]
        assert surface.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0]]


def test_stl_binary_with_attributes_and_a_header_that_says_solid(tmp_path: Path, box: TetMesh) -> None:
    path = write_surface(tmp_path / "box.stl", boundary_surface(box))
    data = bytearray(path.read_bytes())
    data[:80] = b"solid COLOR=".ljust(80)
    data[84 + 48 : 84 + 50] = b"\x12\x34"
    path.write_bytes(data)
    surface = read_surface(path)
    assert (len(surface.points), len(surface.triangles)) == (len(boundary_surface(box).points), 40 - 8)
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(6.0, rel=1e-6)


@pytest.mark.parametrize("header", [b"binary", b"solid part"])
@pytest.mark.parametrize("rest", [b"", b"\0" * 7, b"made by a scanner"])
def test_binary_stl_is_told_by_its_count_of_triangles(
    tmp_path: Path, box: TetMesh, header: bytes, rest: bytes
) -> None:
    data = write_surface(tmp_path / "box.stl", boundary_surface(box)).read_bytes()
    path = written(tmp_path, "box.stl", header.ljust(80, b"\0") + data[80:] + rest)
    surface = read_surface(path)
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(6.0)


def test_a_cut_off_binary_stl_whose_header_says_solid_is_called_that(tmp_path: Path, box: TetMesh) -> None:
    data = write_surface(tmp_path / "box.stl", boundary_surface(box)).read_bytes()
    path = written(tmp_path, "box.stl", b"solid part".ljust(80, b"\0") + data[80:-20])
    with pytest.raises(MeshError, match="damaged or cut off"):
        read_surface(path)


@pytest.mark.parametrize(
    ("options", "suffix"),
    [
        ({"file_format": "vtu", "binary": False}, ".vtk"),
        ({"file_format": "vtu", "binary": True}, ".vtk"),
        ({"file_format": "vtk42", "binary": True}, ".vtu"),
        ({"file_format": "vtk51", "binary": True}, ".msh"),
        ({"file_format": "gmsh22", "binary": False}, ".vtk"),
        ({"file_format": "gmsh"}, ".mesh"),
    ],
)
def test_the_content_chooses_the_format_where_the_suffix_is_wrong(
    tmp_path: Path, box: TetMesh, options: dict, suffix: str
) -> None:
    meshio.write(tmp_path / f"box{suffix}", meshio.Mesh(box.points, [("tetra", box.tets)]), **options)
    np.testing.assert_array_equal(read_tets(tmp_path / f"box{suffix}").tets, box.tets)


POLYDATA = "# vtk DataFile Version 3.0\npart\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\n"
XML_POLYDATA = '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="0.1"><PolyData/></VTKFile>\n'


@pytest.mark.parametrize(
    ("name", "content", "kind"),
    [
        ("part.vtk", POLYDATA, "POLYDATA"),
        ("part.vtp", XML_POLYDATA, "PolyData"),
        ("part.vtk", XML_POLYDATA, "PolyData"),
        ("part.vtu", XML_POLYDATA.replace("PolyData", "ImageData"), "ImageData"),
    ],
)
def test_a_vtk_file_of_another_kind_is_called_that(
    tmp_path: Path, name: str, content: str, kind: str
) -> None:
    path = written(tmp_path, name, content)
    for read in (read_tets, read_surface):
        with pytest.raises(MeshError, match=f"is a VTK file of kind {kind}, which is not read; allowed are"):
            read(path)


@pytest.mark.parametrize(
    ("name", "content", "format_name"),
    [
        ("part.msh", '(1 "fluent")\n(2 3)\n(10 (0 1 a2 0))\n', "ANSYS Fluent"),
        ("part.stl", "ISO-10303-21;\nHEADER;\n", "STEP"),
        ("part.ply", "PK\x03\x04 and more", "zip"),
        ("part.glb", "glTF and more", "binary glTF"),
    ],
)
def test_a_file_of_another_format_is_called_that(
    tmp_path: Path, name: str, content: str, format_name: str
) -> None:
    path = written(tmp_path, name, content)
    for read in (read_tets, read_surface):
        with pytest.raises(MeshError, match=f"is a file of the format {format_name}"):
            read(path)


def test_stl_triangle_without_area_is_dropped_with_a_warning(tmp_path: Path) -> None:
    text = f"solid\n{ONE_FACET}{ONE_FACET.replace('1 0 0', '0 0 0')}endsolid\n"
    with pytest.warns(UserWarning, match=r"part\.stl: 1 of 2 triangles with two equal corners dropped"):
        surface = read_surface(written(tmp_path, "part.stl", text))
    assert surface.triangles.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    "faces",
    [
        "f 1 2 3\nf 1 2 4",
        "f 1//7 2//7 3//7\nf 1/9 2/9 4/9",
        "f 1/1/1 2/1/1 3/1/1\nf -4 -3 -1",
        "g a\nf 1 2 3\ng b\nf 1 2 4",
    ],
)
def test_obj_face_forms(tmp_path: Path, faces: str) -> None:
    surface = read_surface(
        written(tmp_path, "part.obj", f"# text\nvt 0 0\nvn 0 0 1\n{TETRAHEDRON_OBJ}{faces}\n")
    )
    assert surface.triangles.tolist() == [[0, 1, 2], [0, 1, 3]]


def test_obj_polygons_become_fans(tmp_path: Path) -> None:
    surface = read_surface(written(tmp_path, "part.obj", f"{TETRAHEDRON_OBJ}f 1 2 3 4\n"))
    assert surface.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]


BROKEN = {
    "missing.vtk": (None, "does not exist"),
    "folder.vtk": ("folder", "cannot be read"),
    "part.docx": ("x", "known are .gidmsh, .stl, .obj, .vtk"),
    "empty.vtk": (" \n", "is empty"),
    "garbage.vtk": ("hello world\n" * 9, "no valid .vtk file"),
    "garbage.vtu": ("<a><b></a>", "no valid .vtu file"),
    "garbage.msh": ("hello world\n", "no valid .msh file"),
    "garbage.inp": (bytes(range(256)), "no"),
    "garbage.mesh": ("hello world\n", "no"),
    "garbage.gidmsh": ("hello world\n", "line 1: expected a header like MESH dimension 3"),
    "kind.gidmsh": (GID.replace("Tetrahedra", "Prism"), "line 1: .*prism with 4 nodes is not supported"),
    "cut.gidmsh": (GID[: GID.index("End E")], "End Elements; the file is cut off"),
    "cut_early.gidmsh": (GID[: GID.index("End C")], "End Coordinates; the file is cut off"),
    "cut_line.gidmsh": (GID[: GID.index("4 5\n")], "line 12: an element of tetrahedra needs"),
    "counts.gidmsh": (GID.replace("1 1 2 3 4", "1 1 2 3"), "line 11: an element of tetrahedra needs"),
    "index.gidmsh": (GID.replace("2 2 3 4 5", "2 2 3 4 9"), "1 of 2 tetrahedra .* element 2 with node 9"),
    "word.gidmsh": (GID.replace("1 1 1", "1 one 1"), "line 7: 'one' is not a number"),
    "huge.gidmsh": (GID.replace("2 2 3 4 5", "2 2 3 4 99999999999999999999"), "damaged"),
    "twice.gidmsh": (GID.replace("    5 ", "    4 "), "node number 4 occurs twice"),
    "nan.gidmsh": (GID.replace("1 1 1", "1 nan 1"), "1 of 5 points .* not finite, the first is point 4"),
    "triangles.gidmsh": (
        GID.replace("Tetrahedra Nnode 4", "Triangle Nnode 3").replace(" 4\n", "\n").replace(" 5\n", "\n"),
        "holds no tetrahedra .found 2 triangle.",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_said_about_a_broken_volume_file(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture
) -> None:
    content, reason = BROKEN[name]
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content is not None:
        written(tmp_path, name, content)
    with pytest.raises(MeshError, match=reason) as caught:
        read_tets(path)
    assert caught.value.source == str(path)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("short.stl", b"\0" * 40, "too few for binary STL"),
        (
            "cut.stl",
            b"binary".ljust(80) + b"\x02\0\0\0" + b"\0" * 50,
            "of 2 triangles needs 184 bytes, not 134",
        ),
        ("cut_text.stl", f"solid\n{ONE_FACET}", "without endsolid; the file is cut off"),
        ("words.stl", f"solid\nhello\n{ONE_FACET}endsolid", "line 2: 'hello' is no word"),
        (
            "number.stl",
            f"solid\n{ONE_FACET}endsolid".replace("1 0 0", "1 0 x"),
            "line 5: a vertex needs three",
        ),
        ("corners.stl", f"solid\n{ONE_FACET}endsolid".replace("  vertex 1 0 0\n", ""), "exactly 3 vertices"),
        ("none.stl", "solid\nendsolid\n", "holds no points"),
        ("nan.stl", f"solid\n{ONE_FACET}endsolid".replace("vertex 1 0 0", "vertex 1 nan 0"), "not finite"),
        ("text.obj", "hello world\n", "holds no points"),
        ("vertices.obj", TETRAHEDRON_OBJ, "holds no triangles"),
        ("index.obj", f"{TETRAHEDRON_OBJ}f 1 2 5\n", "outside 0..3, the first is number 0"),
        ("zero.obj", f"{TETRAHEDRON_OBJ}f 0 1 2\n", "line 5: a face needs"),
        ("word.obj", f"{TETRAHEDRON_OBJ}f a b c\n", "line 5: 'f a b c' is no vertex"),
        ("flat.obj", f"{TETRAHEDRON_OBJ}f 1 1 2\n", "only triangles with two corners"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*equal corners")
def test_what_is_said_about_a_broken_surface_file(
    tmp_path: Path, name: str, content: str | bytes, reason: str
) -> None:
    with pytest.raises(MeshError, match=reason) as caught:
        read_surface(written(tmp_path, name, content))
    assert caught.value.source == str(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("own.vtk", None),
        ("ascii.vtk", {"file_format": "vtk42", "binary": False}),
        ("new.vtk", {"file_format": "vtk51", "binary": True}),
        ("ascii.vtu", {"binary": False}),
        ("two.msh", {"file_format": "gmsh22", "binary": False}),
        ("gid.gidmsh", "gid"),
    ],
)
def test_a_file_cut_off_anywhere_is_refused_or_complete(
    tmp_path: Path, name: str, options: dict | str | None, capfd: pytest.CaptureFixture
) -> None:
    mesh = box_mesh((1.0, 1.0, 1.0), (1, 1, 1))
    if options is None:
        write_tets(tmp_path / name, mesh)
    elif isinstance(options, dict):
        meshio.write(tmp_path / name, meshio.Mesh(mesh.points, [("tetra", mesh.tets)]), **options)
    else:
        mesh = read_tets(written(tmp_path, name, GID))
    data = (tmp_path / name).read_bytes()
    capfd.readouterr()
    refused = 0
    for length in range(0, len(data), 3):
        try:
            cut = read_tets(written(tmp_path, f"cut{Path(name).suffix}", data[:length]))
        except MeshError:
            refused += 1
        else:
            np.testing.assert_array_equal(cut.tets, mesh.tets)
            np.testing.assert_allclose(cut.points, mesh.points, atol=1e-12)
    assert refused >= (len(data) - 20) // 3
    assert capfd.readouterr() == ("", "")


def test_meshio_is_imported_only_for_a_file_that_needs_it() -> None:
    code = "import sys, softsim_core.physics.mesh; assert not {'meshio', 'scipy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).resolve().parents[2])


def test_writers_take_a_path_as_text(tmp_path: Path, box: TetMesh) -> None:
    surface = read_surface(write_surface(str(tmp_path / "box.stl"), boundary_surface(box)))
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(6.0)
    assert len(read_tets(write_tets(str(tmp_path / "box.vtk"), box)).tets) == len(box.tets)


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path, box: TetMesh) -> None:
    written(tmp_path, "file", "x")
    with pytest.raises(MeshError, match="cannot be written"):
        write_tets(tmp_path / "file" / "mesh.vtk", box)


PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 1 2
3 0 2 3
"""


@pytest.mark.parametrize(
    ("found", "put"),
    [
        ("3 0 1 2\n3 0 2 3\n", "2 0 1\n2 1 2\n"),
        ("3 0 1 2\n3 0 2 3\n", "1 0\n1 1\n"),
        ("3 0 2 3\n", "3 0 2 77\n"),
        ("end_header\n", ""),
        ("element face 2", "element face 2000000"),
        ("uchar int", "x y"),
    ],
)
def test_a_damaged_ply_is_one_error(tmp_path: Path, found: str, put: str) -> None:
    file = tmp_path / "a.ply"
    file.write_text(PLY)
    assert len(read_surface(file).triangles) == 2
    assert found in PLY
    file.write_text(PLY.replace(found, put))
    with pytest.raises(MeshError) as caught:
        read_surface(file)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".ply", ".off", ".stl", ".obj", ".gidmsh"])
def test_random_damage_is_a_mesh_error_or_none(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(9)
    file = tmp_path / f"a{suffix}"
    if suffix == ".gidmsh":
        file.write_text(GID)
    else:
        write_surface(file, boundary_surface(box_mesh((1.0, 1.0, 1.0), (1, 1, 1))))
    whole = file.read_bytes()
    for number in range(60):
        broken = bytearray(whole)
        for place in rng.integers(0, len(broken), 1 + number % 6):
            broken[int(place)] = broken[int(rng.integers(len(broken)))]
        file.write_bytes(broken if number % 4 else broken[: int(rng.integers(len(broken)))])
        with suppress(MeshError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read_surface(file)
