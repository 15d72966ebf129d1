"""Gmsh files of format 4.1, text and binary: nodes, cells and every group of every entity."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import MeshError
from softsim_core.physics.mesh import TetMesh, boundary_faces, box_mesh, quadratic, read_tets

TAGS = {"corner": (0, 9), "clamp": (2, 1), "skin": (2, 3), "heavy": (3, 4)}
STEP = 7
"""Tags of nodes are so far from each other, and fall."""


def parts(mesh: TetMesh) -> list[tuple[int, int, int, np.ndarray, list[int]]]:
    """Dimension, entity, Gmsh's type, cells and groups: an entity of two groups, and some of none."""
    faces = boundary_faces(mesh)
    left = np.isclose(mesh.points[faces][..., 0], 0.0).all(axis=1)
    outer = mesh.points[mesh.tets][..., 0].min(axis=1) > 0.03 - 1e-9
    tets = mesh.tets if mesh.order == 1 else mesh.tets[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]
    face, solid = (2, 4) if mesh.order == 1 else (9, 11)
    return [
        (0, 1, 15, np.array([[0]]), [9]),
        (2, 1, face, faces[left], [1, 3]),
        (2, 2, face, faces[~left], []),
        (3, 1, solid, tets[outer], [4]),
        (3, 2, solid, tets[~outer], []),
    ]


def sections(mesh: TetMesh) -> Iterator[tuple[str, list[tuple[str, list[float]]]]]:
    """Numbers of each section with their types: i4, i8 and f8."""
    entities = parts(mesh)
    numbers = [("i8", [sum(part[0] == dimension for part in entities) for dimension in range(4)])]
    for dimension, tag, _, _, groups in entities:
        box = [0.0] * (6 if dimension else 3)
        numbers += [("i4", [tag]), ("f8", box), ("i8", [len(groups)]), ("i4", groups)]
        numbers += [("i8", [1]), ("i4", [1])] if dimension else []
    yield "Entities", numbers
    n = len(mesh.points)
    half = n // 2  # two blocks, the second one with parameters
    tags = [STEP * (n - k) for k in range(n)]
    numbers = [("i8", [2, n, min(tags), max(tags)])]
    numbers += [
        ("i4", [3, 1, 0]),
        ("i8", [half]),
        ("i8", tags[:half]),
        ("f8", mesh.points[:half].ravel().tolist()),
    ]
    more = np.hstack([mesh.points[half:], np.full((n - half, 2), 0.5)])
    numbers += [("i4", [2, 1, 1]), ("i8", [n - half]), ("i8", tags[half:]), ("f8", more.ravel().tolist())]
    yield "Nodes", numbers
    count = sum(len(part[3]) for part in entities)
    numbers, number = [("i8", [len(entities), count, 1, count])], 1
    for dimension, tag, kind, cells, _ in entities:
        numbers += [("i4", [dimension, tag, kind]), ("i8", [len(cells)])]
        for cell in cells.tolist():
            numbers.append(("i8", [number, *(tags[node] for node in cell)]))
            number += 1
    yield "Elements", numbers


def gmsh_41(mesh: TetMesh, order: str | None) -> bytes:
    """The file as text, or as bytes in the given order."""
    named = [f'{dimension} {tag} "{name}"' for name, (dimension, tag) in TAGS.items()]
    data = f"$MeshFormat\n4.1 {int(order is not None)} 8\n".encode()
    data += b"" if order is None else np.array([1], f"{order}i4").tobytes() + b"\n"
    data += "\n".join(
        ["$EndMeshFormat", "$PhysicalNames", str(len(named)), *named, "$EndPhysicalNames"]
    ).encode()
    for name, numbers in sections(mesh):
        data += f"\n${name}\n".encode()
        if order is None:
            data += "\n".join(" ".join(map(repr, values)) for _, values in numbers).encode()
        else:
            data += b"".join(np.array(values, order + kind).tobytes() for kind, values in numbers)
        data += f"\n$End{name}".encode()
    return data + b"\n"


@pytest.mark.parametrize("bytes_in", [None, "<", ">"], ids=["text", "little", "big"])
@pytest.mark.parametrize("order", [1, 2])
def test_nodes_cells_and_groups_are_read(bytes_in: str | None, order: int, tmp_path: Path) -> None:
    mesh = box_mesh((0.06, 0.02, 0.02), (6, 2, 2))
    mesh = quadratic(mesh) if order == 2 else mesh
    file = tmp_path / "beam.msh"
    file.write_bytes(gmsh_41(mesh, bytes_in))
    read = read_tets(file)
    assert np.array_equal(read.points, mesh.points)
    assert np.array_equal(np.sort(read.tets, axis=0), np.sort(mesh.tets, axis=0))
    assert {tuple(cell) for cell in read.tets.tolist()} == {tuple(cell) for cell in mesh.tets.tolist()}
    left = np.flatnonzero(np.isclose(mesh.points[:, 0], 0.0)).tolist()
    outer = np.flatnonzero(mesh.points[:, 0] > 0.03 - 1e-9).tolist()
    groups = {name: nodes.tolist() for name, nodes in read.groups.items()}
    assert groups == {"corner": [0], "clamp": left, "skin": left, "heavy": outer}
    assert set(read.surfaces) == {"clamp", "skin"}


@pytest.mark.parametrize("bytes_in", [None, "<"])
def test_damaged_files_are_one_sentence(bytes_in: str | None, tmp_path: Path) -> None:
    whole = gmsh_41(box_mesh((0.06, 0.02, 0.02), (6, 2, 2)), bytes_in)
    rng = np.random.default_rng(1)
    file = tmp_path / "beam.msh"
    for _ in range(60):
        data = bytearray(whole[: rng.integers(20, len(whole))] if rng.random() < 0.5 else whole)
        for _ in range(rng.integers(0, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        file.write_bytes(bytes(data))
        try:
            read_tets(file)
        except MeshError as refusal:
            said = str(refusal)
            assert "\n" not in said
            assert said.startswith(f"mesh {file}")


def test_an_unknown_element_and_a_missing_node_are_named(tmp_path: Path) -> None:
    text = gmsh_41(box_mesh((0.06, 0.02, 0.02), (6, 2, 2)), None).decode()
    file = tmp_path / "beam.msh"
    for old, new, said in (
        ("\n3 1 4\n", "\n3 1 93\n", "Gmsh's type 93, which is not known"),
        (f" {STEP}\n", " 999999\n", "a node that is not in it"),
        ("$EndElements", "", "ends without \\$EndElements"),
        ("$Elements", "$Other", "ends without"),
        ("4.1 0 8", "4.1 0 4", "names no file type 0 or 1"),
    ):
        file.write_text(text.replace(old, new, 1))
        with pytest.raises(MeshError, match=said):
            read_tets(file)
