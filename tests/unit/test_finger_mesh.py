"""Our own finger: its profile, symmetry, element shapes, notch walls, and the committed files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import MeshError
from softsim_core.physics.actuation.cable import read_cable_points
from softsim_core.physics.mesh import (
    TetMesh,
    boundary_surface,
    check_tets,
    embed,
    enclosed_volume,
    euler_number,
    is_closed,
    read_surface,
    read_tets,
)
from softsim_core.robots import finger, finger_mesh

MESHES = Path(__file__).resolve().parents[2] / "configs" / "meshes"
NODES = {"coarse": 62, "low": 192, "mid": 1055}
SHAPES = {"coarse": (0.33, 0.58), "low": (0.37, 0.67), "mid": (0.37, 0.67)}  # radius ratios: smallest, mean


@pytest.fixture(scope="module", params=list(finger_mesh.LEVELS))
def level(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def mesh(level: str) -> TetMesh:
    return finger(finger_mesh.LEVELS[level])


def test_size_and_shape(level: str, mesh: TetMesh) -> None:
    report = check_tets(mesh)
    assert report.nodes == NODES[level]
    assert (report.inverted, report.slivers, report.duplicate_nodes, report.warnings) == (0, 0, 0, ())
    smallest, mean = SHAPES[level]
    assert report.min_radius_ratio > smallest
    assert report.mean_radius_ratio > mean
    assert pytest.approx(0.103366, abs=1e-6) == finger_mesh.LENGTH
    np.testing.assert_allclose(mesh.points.min(axis=0), [0.0, -finger_mesh.LENGTH, 0.0], atol=1e-12)
    np.testing.assert_allclose(
        mesh.points.max(axis=0), [finger_mesh.WIDTH, 0.0, finger_mesh.HEIGHT], atol=1e-12
    )


def test_volume(mesh: TetMesh) -> None:
    assert check_tets(mesh).volume == pytest.approx(18508.7e-9, rel=5e-3)


def test_boundary_is_closed(mesh: TetMesh) -> None:
    surface = boundary_surface(mesh)
    assert is_closed(surface.triangles)
    assert euler_number(surface.triangles) == 2
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(check_tets(mesh).volume)


def test_symmetric_in_nodes_and_connectivity(level: str, mesh: TetMesh) -> None:
    moved = mesh.points * [-1.0, 1.0, 1.0] + [finger_mesh.WIDTH, 0.0, 0.0]
    distances = np.linalg.norm(moved[:, None] - mesh.points[None], axis=2)
    partner = distances.argmin(axis=1)
    assert distances.min(axis=1).max() < 1e-15
    if level == "coarse":
        return  # one layer of prisms leans to one side
    elements = {frozenset(tet) for tet in mesh.tets.tolist()}
    assert {frozenset(tet) for tet in partner[mesh.tets].tolist()} == elements


def test_notches_open_by_75_degrees(level: str, mesh: TetMesh) -> None:
    surface = boundary_surface(mesh)
    corners = surface.points[surface.triangles]
    on_walls = (np.ptp(corners[:, :, 2], axis=1) > 1e-9) & (
        corners[:, :, 2].min(axis=1) > finger_mesh.SPINE - 1e-9
    )
    in_notches = (
        on_walls & (corners[:, :, 1].min(axis=1) > -0.0784) & (corners[:, :, 1].max(axis=1) < -0.0326)
    )
    normals = np.cross(*np.swapaxes(corners[in_notches, 1:] - corners[in_notches, :1], 0, 1))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    flat = np.abs(normals[:, 0]) < 1e-9
    sine = np.sin(np.radians(37.5))
    np.testing.assert_allclose(normals[flat, 2], sine, rtol=1e-9)
    assert flat.sum() >= (8 if level == "coarse" else 32)


def test_the_cable_lies_well_inside(mesh: TetMesh) -> None:
    bound = embed(read_cable_points(MESHES / "finger_cable.json"), mesh)
    assert bound.outside.max() == 0.0


def test_the_reference_path_lies_inside_too(mesh: TetMesh, reference_dir: Path) -> None:
    points = 1e-3 * read_cable_points(reference_dir / "data" / "cable_gripper" / "cable.json")
    assert embed(points[:, [2, 0, 1]], mesh).outside.max() == 0.0


def test_committed_files_are_what_the_generator_writes(tmp_path: Path, level: str) -> None:
    assert finger_mesh.main(["--out", str(tmp_path)]) == 0
    committed, fresh = (read_tets(folder / f"finger_{level}.vtk") for folder in (MESHES, tmp_path))
    np.testing.assert_array_equal(committed.tets, fresh.tets)
    np.testing.assert_allclose(committed.points, fresh.points, rtol=0, atol=1e-16)
    expected = boundary_surface(committed)
    surface = read_surface(MESHES / f"finger_{level}.stl")
    np.testing.assert_allclose(
        surface.points[surface.triangles], expected.points[expected.triangles], rtol=0, atol=8e-9
    )


@pytest.mark.parametrize("depth", [0.004, 0.007, 0.0125])
def test_notches_of_another_depth(depth: float, level: str, mesh: TetMesh) -> None:
    """Each of the two takes a triangle more, or less, out of the side view."""
    other = finger(finger_mesh.LEVELS[level], notch_depth=depth)
    report = check_tets(other)
    assert (report.inverted, report.duplicate_nodes) == (0, 0)
    assert not report.warnings or level == "coarse"  # its columns have no point beside a deep notch
    surface = boundary_surface(other)
    assert is_closed(surface.triangles)
    assert euler_number(surface.triangles) == 2
    removed = 2 * finger_mesh.SLANT * (depth - finger_mesh.NOTCH_DEPTH) * finger_mesh.WIDTH
    assert check_tets(mesh).volume - report.volume == pytest.approx(removed, rel=1e-9)


def test_refusals(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(MeshError, match="must be >= 0"):
        finger(-1)
    for depth in (0.001, 0.014, np.nan):
        with pytest.raises(MeshError, match="notch_depth"):
            finger(notch_depth=depth)
    (tmp_path / "file").write_text("x")
    with pytest.raises(SystemExit) as caught:
        finger_mesh.main(["--out", str(tmp_path / "file")])
    assert caught.value.code == 1
    assert "cannot be written" in capsys.readouterr().err
