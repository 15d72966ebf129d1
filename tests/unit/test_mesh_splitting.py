"""Hexahedra, wedges and pyramids become tetrahedra that fit each other and those beside them."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest
from mixed_meshes import CELLS, CORNERS, mixed

from softsim_core import (
    AttachmentDescription,
    BodyDescription,
    Box,
    MaterialDescription,
    MeshFile,
    SceneDescription,
    Simulation,
)
from softsim_core.base import MeshError
from softsim_core.physics.mesh import (
    TetMesh,
    boundary_surface,
    check_tets,
    enclosed_volume,
    read_surface,
    read_tets,
)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".msh"])
def test_a_mesh_of_random_cells_is_filled_without_gaps(tmp_path: Path, seed: int, suffix: str) -> None:
    file = tmp_path / f"mixed{suffix}"
    meshio.write(
        file, mixed(seed), **({"file_format": "gmsh22", "binary": False} if suffix == ".msh" else {})
    )
    mesh = read_tets(file)
    report = check_tets(mesh)
    surface = boundary_surface(mesh)
    on_cube = (np.abs(surface.points) < 1e-9) | (np.abs(surface.points - 1.0) < 1e-9)
    assert report.volume == pytest.approx(1.0, rel=1e-9)
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(1.0, rel=1e-9)
    assert on_cube.any(axis=1).all()  # a face inside would be one that two cells do not share
    assert len(surface.triangles) == 2 * 6 * CELLS**2


def test_the_surface_of_hexahedra_is_read(tmp_path: Path) -> None:
    meshio.write(tmp_path / "cells.vtu", mixed(3, ("hexahedron",)))
    surface = read_surface(tmp_path / "cells.vtu")
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(1.0)


def test_a_wedge_written_as_a_hexahedron_is_a_wedge(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], dtype=float)
    meshio.write(tmp_path / "wedge.vtk", meshio.Mesh(points, [("hexahedron", [[0, 1, 2, 2, 3, 4, 5, 5]])]))
    assert check_tets(read_tets(tmp_path / "wedge.vtk")).volume == pytest.approx(0.5)


def test_groups_of_hexahedra_hold_their_tetrahedra(tmp_path: Path) -> None:
    points = np.array([[x, y, z] for z in range(3) for y in (0, 1) for x in (0, 1)], dtype=float)
    lower, upper = [0, 1, 3, 2, 4, 5, 7, 6], [4, 5, 7, 6, 8, 9, 11, 10]
    mesh = meshio.Mesh(
        points,
        [("hexahedron", [lower, upper])],
        cell_data={"gmsh:physical": [[1, 2]], "gmsh:geometrical": [[1, 2]]},
        field_data={"soft": np.array([1, 3]), "hard": np.array([2, 3])},
    )
    meshio.write(tmp_path / "two.msh", mesh, file_format="gmsh22", binary=False)
    read = read_tets(tmp_path / "two.msh")
    for name, height in (("soft", 0.5), ("hard", 1.5)):
        chosen = TetMesh(read.points, read.tets[read.cell_groups[name]])
        centres = chosen.points[chosen.tets].mean(axis=1)
        assert len(centres) == 6
        assert np.abs(centres[:, 2] - height).max() < 0.5


@pytest.mark.parametrize(
    ("cells", "reason"),
    [
        (
            [("hexahedron20", [list(range(20))])],
            "kinds that are not read: hexahedron20 .found 1 hexahedron20",
        ),
        (
            [("tetra10", [list(range(10))]), ("hexahedron", [list(range(8))])],
            "mixes linear and quadratic cells",
        ),
        ([("hexahedron", [[0, 1, 2, 3, 4, 5, 7, 6]])], "1 of 1 cells of kind hexahedron are folded"),
    ],
)
def test_cells_that_cannot_be_split_are_refused_with_kinds_and_counts(
    tmp_path: Path, cells: list, reason: str
) -> None:
    points = np.concatenate([np.array(CORNERS, dtype=float), np.random.default_rng(1).random((12, 3))])
    meshio.write(tmp_path / "cells.vtu", meshio.Mesh(points, cells))
    with pytest.raises(MeshError, match=reason):
        read_tets(tmp_path / "cells.vtu")


def test_nodes_that_no_cell_uses_are_dropped_with_a_warning(tmp_path: Path) -> None:
    points = np.array([[9, 9, 9], [0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [8, 8, 8]], dtype=float)
    meshio.write(tmp_path / "cell.vtu", meshio.Mesh(points, [("tetra", [[1, 2, 3, 4]])]))
    with pytest.warns(
        UserWarning, match="2 of 6 nodes belong to no cell and are dropped, the first is node 0"
    ):
        mesh = read_tets(tmp_path / "cell.vtu")
    np.testing.assert_array_equal(mesh.points, points[1:5])
    base = AttachmentDescription(
        name="base", body="cell", to="world", box=Box(center=(0, 0, 0), size=(1, 1, 0.01))
    )
    for given in (MeshFile(file=tmp_path / "cell.vtu"), TetMesh(points, np.array([[1, 2, 3, 4]]))):
        material = MaterialDescription(young_modulus=1e5, poisson_ratio=0.3)
        body = BodyDescription(name="cell", mesh=given, material=material, density=1000.0)
        with pytest.warns(UserWarning, match="2 of 6 nodes belong to no cell"):
            simulation = Simulation(SceneDescription(name="one", bodies=(body,), attachments=(base,)))
        simulation.step()
        assert np.isfinite(simulation.positions).all()
