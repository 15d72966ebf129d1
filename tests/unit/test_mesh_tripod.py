"""Our own Tripod silicone: dimensions, symmetry, element shapes, regions, and the committed files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from softsim_core.base import MeshError, Placement
from softsim_core.physics.mesh import (
    TetMesh,
    boundary_surface,
    check_tets,
    enclosed_volume,
    euler_number,
    is_closed,
    place,
    read_surface,
    read_tets,
    rotation_matrix,
)
from softsim_core.robots import tripod_mesh

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
NODES = {"coarse": 144, "low": 246, "mid": 765, "high": 1536}
REFERENCE_NODES = {"low": 235, "mid": 781, "high": 1455}
MEAN_RADIUS_RATIO = {"coarse": 0.53, "low": 0.71, "mid": 0.67, "high": 0.63}
HALF_LENGTH = 0.055131397  # outermost corner: half the width beside the reach, turned by 60 degrees


@pytest.fixture(scope="module", params=list(tripod_mesh.LEVELS))
def level(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def silicone(level: str) -> TetMesh:
    return tripod_mesh.tripod_silicone(*tripod_mesh.LEVELS[level])


def test_size_and_shape(level: str, silicone: TetMesh) -> None:
    report = check_tets(silicone)
    assert report.nodes == NODES[level]
    assert report.nodes == pytest.approx(REFERENCE_NODES.get(level, report.nodes), rel=0.06)
    assert (report.inverted, report.slivers, report.duplicate_nodes, report.warnings) == (0, 0, 0, ())
    assert report.min_dihedral_deg > 17.0
    assert report.min_radius_ratio > (0.42 if level == "coarse" else 0.43)
    assert report.mean_radius_ratio > MEAN_RADIUS_RATIO[level]
    np.testing.assert_allclose(silicone.points.min(axis=0), [-0.055, -HALF_LENGTH, 0.0], atol=1e-9)
    np.testing.assert_allclose(silicone.points.max(axis=0), [0.040490381, HALF_LENGTH, 0.005], atol=1e-9)


def test_volume_is_exact_up_to_the_polygon_of_the_hole(level: str, silicone: TetMesh) -> None:
    corners = 6 * tripod_mesh.LEVELS[level][0]
    overlap = 3.0 * 0.030 * 0.055 - 2.0 * 3.0 * 0.5 * 0.015 * 0.015 / math.sqrt(3.0)
    hole = 0.5 * corners * 0.005**2 * math.sin(2.0 * math.pi / corners)
    assert check_tets(silicone).volume == pytest.approx(0.005 * (overlap - hole), rel=1e-12)
    assert check_tets(silicone).volume == pytest.approx(22410e-9, rel=1e-3 if level != "coarse" else 3e-3)


def test_boundary_is_closed_with_one_hole(silicone: TetMesh) -> None:
    surface = boundary_surface(silicone)
    assert is_closed(surface.triangles)
    assert euler_number(surface.triangles) == 0
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(check_tets(silicone).volume)


@pytest.mark.parametrize("image", ["turn", "mirror"])
def test_symmetric_in_nodes_and_connectivity(silicone: TetMesh, image: str) -> None:
    change = rotation_matrix((0.0, 0.0, 120.0)) if image == "turn" else np.diag([1.0, -1.0, 1.0])
    moved = silicone.points @ change.T
    distances = np.linalg.norm(moved[:, None] - silicone.points[None], axis=2)
    partner = distances.argmin(axis=1)
    assert distances.min(axis=1).max() < 3e-17
    elements = {frozenset(tet) for tet in silicone.tets.tolist()}
    assert {frozenset(tet) for tet in partner[silicone.tets].tolist()} == elements


def test_arms_point_to_180_300_and_60_degrees(silicone: TetMesh) -> None:
    ends = silicone.points[np.isclose(np.linalg.norm(silicone.points[:, :2], axis=1), 0.055)]
    angles = {round(math.degrees(math.atan2(y, x))) % 360 for x, y, _ in ends.tolist()}
    assert angles == {180, 300, 60}


def test_regions_of_the_robot_are_equal_on_the_three_arms(level: str, silicone: TetMesh) -> None:
    robot = yaml.safe_load((CONFIGS / "robots" / "tripod.yaml").read_text())
    body = place(silicone.points, Placement(**robot["bodies"][0]["mesh"]["placement"]))
    attachments = {attachment["name"]: attachment for attachment in robot["attachments"]}
    counts = []
    for index, joint in enumerate(robot["joints"]):
        base = joint["base"]
        local = (body - base["translation"]) @ rotation_matrix(base["rotation_deg"])
        box = attachments[f"tip_{index}"]["box"]
        margin = np.array(box["size"]) / 2.0 - np.abs(local - box["center"])
        counts.append(int((margin >= 0.0).all(axis=1).sum()))
        assert np.abs(margin).min() > 5e-6  # no node so near to a face that round-off decides
    assert counts == [{"coarse": 16, "low": 24, "mid": 75, "high": 124}[level]] * 3
    sphere = attachments["centre"]["sphere"]
    distances = np.linalg.norm(body - sphere["center"], axis=1)
    assert (
        int((distances <= sphere["radius"]).sum()) == {"coarse": 12, "low": 30, "mid": 69, "high": 156}[level]
    )
    assert np.abs(distances - sphere["radius"]).min() > 1e-5


def test_a_row_of_nodes_crosses_each_arm_at_the_tip_line(level: str, silicone: TetMesh) -> None:
    divisions, layers = tripod_mesh.LEVELS[level]
    row = np.isclose(silicone.points[:, 0], -tripod_mesh.TIP_LINE, rtol=1e-9)
    assert row.sum() == (2 * divisions + 1) * (layers + 1)


def test_committed_files_are_what_the_generator_writes(tmp_path: Path, level: str) -> None:
    assert tripod_mesh.main(["--out", str(tmp_path)]) == 0
    for suffix in ("vtk", "stl"):
        committed, fresh = (
            CONFIGS / "meshes" / f"tripod_{level}.{suffix}",
            tmp_path / f"tripod_{level}.{suffix}",
        )
        assert committed.stat().st_size == fresh.stat().st_size
    committed_mesh, fresh_mesh = (
        read_tets(folder / f"tripod_{level}.vtk") for folder in (CONFIGS / "meshes", tmp_path)
    )
    np.testing.assert_array_equal(committed_mesh.tets, fresh_mesh.tets)
    # cosines may differ in the last digit between machines
    np.testing.assert_allclose(committed_mesh.points, fresh_mesh.points, rtol=0, atol=1e-16)


def test_committed_surface_is_the_boundary_of_the_committed_mesh(level: str) -> None:
    expected = boundary_surface(read_tets(CONFIGS / "meshes" / f"tripod_{level}.vtk"))
    surface = read_surface(CONFIGS / "meshes" / f"tripod_{level}.stl")
    assert surface.triangles.shape == expected.triangles.shape
    np.testing.assert_allclose(
        surface.points[surface.triangles], expected.points[expected.triangles], rtol=0, atol=4e-9
    )


@pytest.mark.parametrize(("divisions", "layers"), [(0, 1), (2, 0)])
def test_too_coarse_is_refused(divisions: int, layers: int) -> None:
    with pytest.raises(MeshError, match="must be >= 1"):
        tripod_mesh.tripod_silicone(divisions, layers)


@pytest.mark.parametrize("divisions", [1, 2, 3, 4, 5, 6, 8])
def test_every_size_is_well_shaped(divisions: int) -> None:
    report = check_tets(tripod_mesh.tripod_silicone(divisions, max(1, divisions - 1)))
    assert report.min_dihedral_deg > 10.0
    assert report.min_radius_ratio > 0.2


def test_a_folder_that_cannot_be_made_ends_with_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(SystemExit) as caught:
        tripod_mesh.main(["--out", str(tmp_path / "file")])
    assert caught.value.code == 1
    assert "cannot be written" in capsys.readouterr().err
