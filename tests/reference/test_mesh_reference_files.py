"""Every mesh file of the reference loads with the figures of its tables (lengths in mm, as in the files)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import Placement
from softsim_core.physics.mesh import (
    SurfaceFollower,
    boundary,
    boundary_surface,
    check_tets,
    embed,
    enclosed_volume,
    euler_number,
    is_closed,
    read_surface,
    read_tets,
)

# file: nodes, tets, volume, min / max dihedral, min / mean radius ratio, slivers, min / max edge,
# triangles and points of the boundary
VOLUMES = {
    "tripod/tripod_low.gidmsh": (235, 579, 22447.9, 3.83, 173.46, 0.0102, 0.650, 7, 3.712, 13.76, 436, 218),
    "tripod/tripod_mid.gidmsh": (781, 2684, 22429.1, 18.65, 160.76, 0.0918, 0.711, 0, 1.885, 8.33, 1162, 581),
    "tripod/tripod_high.gidmsh": (
        1455,
        5221,
        22417.4,
        16.20,
        162.94,
        0.0596,
        0.781,
        0,
        1.396,
        6.69,
        2090,
        1045,
    ),
    "cable_gripper/finger.vtk": (158, 389, 18508.7, 5.68, 170.59, 0.0606, 0.677, 4, 3.683, 15.13, 306, 155),
    "tripod/tripodDeformed.vtu": (781, 2684, 23963.2, 7.64, 169.89, 0.0272, 0.661, 3, 1.980, 9.95, 1162, 581),
}
BOXES = {
    "tripod/tripod_low.gidmsh": ((-55.1314, -55, 0), (55.1314, 40.4904, 5)),
    "tripod/tripod_mid.gidmsh": ((-55.1314, -55, 0), (55.1314, 40.4904, 5)),
    "tripod/tripod_high.gidmsh": ((-55.1314, -55, 0), (55.1314, 40.4904, 5)),
    "cable_gripper/finger.vtk": ((-103.366, 0, 0), (0, 15, 15)),
    "tripod/tripodDeformed.vtu": ((-54.9698, -0.0779, -54.8134), (54.9698, 20.3656, 40.3971)),
}
# file: vertices, triangles, closed, Euler number, volume of the closed ones, bounding box
SURFACES = {
    "tripod/tripod_low.stl": (218, 436, True, 0, 22447.889, (-55.131, -55, 0), (55.131, 40.49, 5)),
    "tripod/tripod_mid.stl": (581, 1162, True, 0, 22429.087, (-55.131, -55, 0), (55.131, 40.49, 5)),
    "tripod/tripod_high.stl": (1045, 2090, True, 0, 22417.365, (-55.131, -55, 0), (55.131, 40.49, 5)),
    "tripod/SG90_servomotor.stl": (
        4628, 9252, True, 2, 12886.189, (-29.873, -21.939, -16.486), (15.078, 12.324, 10.522)
    ),
    "tripod/SG90_servoarm.stl": (
        2334, 4775, False, -49, None, (-34.204, -15.864, -9.124), (32.325, 37.02, 14.982)
    ),
    "tripod/servo_collision.stl": (11, 9, False, 1, None, (-18.22, 9.555, -10.503), (14.792, 12.375, 10.538)),
    "tripod/blueprint.stl": (
        3037, 5371, False, 19, None, (-95.105, -23.9, -94.55), (95.619, -17.527, 69.404)
    ),
    "tripod/maze.stl": (2615, 5230, True, 0, 10573.93, (-30, -30, -2), (30, 30, 3.9)),
    "cable_gripper/finger.stl": (155, 306, True, 2, 18508.661, (-103.366, 0, 0), (0, 15, 15)),
    "cable_gripper/fingerCollision_part1.stl": (
        16, 14, False, 2, None, (-78.366, 8.078, 0), (-42.708, 15, 15)
    ),
    "cable_gripper/fingerCollision_part2.stl": (
        16, 14, False, 2, None, (-68.331, 8.078, 0), (-32.673, 15, 15)
    ),
    "sofa_rigid/cube.obj": (8, 12, True, 2, 8.0, (-1, -1, -1), (1, 1, 1)),
    "sofa_rigid/ball.obj": (242, 480, True, 2, 4.0427, (-1, -1, -1), (1, 1, 1)),
    "sofa_rigid/floor.obj": (
        50, 96, True, 2, 89215, (-74.672, -5.32967, -74.672), (74.672, -1.32967, 74.672)
    ),
}  # fmt: skip


@pytest.fixture(scope="session")
def data(reference_dir: Path) -> Path:
    return reference_dir / "data"


@pytest.mark.parametrize("file", VOLUMES)
def test_volume_mesh(data: Path, file: str) -> None:
    nodes, tets, volume, low, high, worst, mean, slivers, shortest, longest, triangles, points = VOLUMES[file]
    mesh = read_tets(data / file)
    report = check_tets(mesh)
    assert (report.nodes, report.elements, report.inverted, report.slivers) == (nodes, tets, 0, slivers)
    assert len(report.warnings) == (slivers > 0)
    assert report.volume == pytest.approx(volume, abs=0.06)
    assert (report.min_dihedral_deg, report.max_dihedral_deg) == pytest.approx((low, high), abs=0.006)
    assert (report.min_radius_ratio, report.mean_radius_ratio) == pytest.approx((worst, mean), abs=6e-4)
    assert (report.min_edge, report.max_edge) == pytest.approx((shortest, longest), abs=6e-3)
    surface = boundary_surface(mesh)
    assert (len(surface.triangles), len(surface.points)) == (triangles, points)
    assert is_closed(surface.triangles)
    np.testing.assert_allclose([mesh.points.min(axis=0), mesh.points.max(axis=0)], BOXES[file], atol=6e-4)
    assert (mesh.points.dtype, mesh.tets.dtype) == (np.dtype(np.float64), np.dtype(np.int64))
    assert mesh.points.dtype.isnative


@pytest.mark.parametrize("file", SURFACES)
@pytest.mark.filterwarnings("error")
def test_surface_mesh(data: Path, file: str) -> None:
    vertices, triangles, closed, euler, volume, low, high = SURFACES[file]
    surface = read_surface(data / file)
    assert (len(surface.points), len(surface.triangles)) == (vertices, triangles)
    assert is_closed(surface.triangles) == closed
    assert euler_number(surface.triangles) == euler
    if volume is not None:
        assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(volume, rel=3e-5)
    np.testing.assert_allclose(
        [surface.points.min(axis=0), surface.points.max(axis=0)], [low, high], atol=6e-4
    )


@pytest.mark.parametrize(
    ("volume_file", "surface_file"),
    [
        ("tripod/tripod_low.gidmsh", "tripod/tripod_low.stl"),
        ("tripod/tripod_mid.gidmsh", "tripod/tripod_mid.stl"),
        ("tripod/tripod_high.gidmsh", "tripod/tripod_high.stl"),
        ("cable_gripper/finger.vtk", "cable_gripper/finger.stl"),
    ],
)
def test_surface_file_is_the_boundary(data: Path, volume_file: str, surface_file: str) -> None:
    mesh, surface = read_tets(data / volume_file), read_surface(data / surface_file)

    def turned(points: np.ndarray, triangles: np.ndarray) -> set[tuple]:
        """Triangles as coordinates in single precision, each from its smallest corner on."""
        rounded = points.astype(np.float32)[triangles].astype(float).round(4) + 0.0
        corners = [[tuple(corner) for corner in triangle] for triangle in rounded.tolist()]
        return {min((c[i], c[i - 2], c[i - 1]) for i in range(3)) for c in corners}

    assert turned(mesh.points, boundary(mesh)) == turned(surface.points, surface.triangles)


def test_deformed_snapshot_has_the_elements_of_the_mid_mesh(data: Path) -> None:
    snapshot, mesh = (
        read_tets(data / "tripod/tripodDeformed.vtu"),
        read_tets(data / "tripod/tripod_mid.gidmsh"),
    )
    np.testing.assert_array_equal(snapshot.tets, mesh.tets)


def test_finger_file_gives_its_triangles_as_surface(data: Path) -> None:
    surface = read_surface(data / "cable_gripper/finger.vtk")
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(18508.66, abs=0.01)


def test_fine_surface_follows_the_coarse_mesh(data: Path) -> None:
    mesh = read_tets(data / "tripod/tripod_low.gidmsh")
    surface = read_surface(data / "tripod/tripod_mid.stl")
    embedding = embed(surface.points, mesh)
    follower = SurfaceFollower([(surface, embedding, 0)], len(mesh.points))
    matrix = np.array([[0.9, 0.1, 0.0], [-0.2, 1.1, 0.3], [0.0, 0.1, 1.0]])
    np.testing.assert_allclose(follower.follow(mesh.points @ matrix), surface.points @ matrix, atol=1e-12)
    assert np.mean(embedding.outside == 0.0) > 0.3


def test_reference_axes_become_ours(data: Path) -> None:
    """Millimetres, y up, (x, y, z) = 0.001 (z, x, y) after the reference's own turn of 90 degrees about x."""
    ours = Placement(scale=0.001, rotation_deg=(0.0, 0.0, -90.0), translation=(0.0, 0.0, 0.025))
    mesh = read_tets(data / "tripod/tripod_low.gidmsh", ours)
    np.testing.assert_allclose(mesh.points[:, 2].min(), 0.025)
    np.testing.assert_allclose(mesh.points[:, 2].max(), 0.030)
    assert np.linalg.norm(mesh.points[:, 0].min() + 0.055) < 1e-9  # arm 0 points to -x
