"""Mesh checks, boundary surfaces and placements against shapes whose figures are known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from softsim_core.base import MeshError, Placement
from softsim_core.physics.mesh import (
    TetMesh,
    boundary,
    box_mesh,
    check_tets,
    enclosed_volume,
    euler_number,
    is_closed,
    place,
    rotation_matrix,
)

REGULAR = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
ONE = np.array([[0, 1, 2, 3]])


def test_regular_tetrahedron() -> None:
    report = check_tets(TetMesh(REGULAR, ONE))
    assert report.volume == pytest.approx(8.0 / 3.0)
    assert report.min_radius_ratio == pytest.approx(1.0)
    assert report.min_dihedral_deg == pytest.approx(np.degrees(np.arccos(1.0 / 3.0)))
    assert report.max_dihedral_deg == pytest.approx(np.degrees(np.arccos(1.0 / 3.0)))
    assert (report.min_edge, report.max_edge) == pytest.approx((np.sqrt(8.0), np.sqrt(8.0)))


def test_corner_of_a_cube() -> None:
    corner = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    report = check_tets(TetMesh(corner, ONE))
    inscribed, circumscribed = 1.0 / (3.0 + np.sqrt(3.0)), np.sqrt(0.75)
    assert report.min_radius_ratio == pytest.approx(3.0 * inscribed / circumscribed)
    assert (report.max_dihedral_deg, report.min_dihedral_deg) == pytest.approx((90.0, 54.735610317245346))


@pytest.mark.parametrize("cells", [(1, 1, 1), (2, 2, 2), (3, 2, 4)])
def test_box(cells: tuple[int, int, int]) -> None:
    mesh = box_mesh((0.3, 0.2, 0.1), cells, origin=(1.0, -1.0, 0.5))
    report = check_tets(mesh)
    assert (report.nodes, report.elements) == (np.prod(np.add(cells, 1)), 6 * np.prod(cells))
    assert report.volume == pytest.approx(0.006)
    assert (report.inverted, report.warnings) == (0, ())
    triangles = boundary(mesh)
    assert len(triangles) == 4 * sum(a * b for a, b in itertools.combinations(cells, 2))
    assert is_closed(triangles)
    assert euler_number(triangles) == 2
    assert enclosed_volume(mesh.points, triangles) == pytest.approx(0.006)
    np.testing.assert_allclose(mesh.points.min(axis=0), [1.0, -1.0, 0.5])


def test_box_with_even_cells_is_its_own_mirror_image() -> None:
    mesh = box_mesh((2.0, 2.0, 2.0), (2, 4, 2), origin=(-1.0, -1.0, -1.0))
    elements = {frozenset(tet) for tet in mesh.tets.tolist()}
    index = {tuple(point): number for number, point in enumerate(mesh.points.tolist())}
    for axis in range(3):
        image = mesh.points.copy()
        image[:, axis] *= -1.0
        moved = np.array([index[tuple(point + 0.0)] for point in image])
        assert {frozenset(tet) for tet in moved[mesh.tets].tolist()} == elements


@pytest.mark.parametrize(
    ("lengths", "cells"),
    [((1, 1, 0), (1, 1, 1)), ((1, 1, np.nan), (1, 1, 1)), ((1, 1, 1), (1, 0, 1)), ((1, 1), (1, 1))],
)
def test_box_refuses(lengths: tuple, cells: tuple) -> None:
    with pytest.raises(MeshError, match=r"mesh box: (lengths|cells)"):
        box_mesh(lengths, cells)


def test_boundary_points_outward_whatever_the_orientation() -> None:
    mesh = box_mesh((1.0, 1.0, 1.0), (2, 2, 2))
    tets = mesh.tets.copy()
    tets[::2, [0, 1]] = tets[::2, [1, 0]]
    mixed = TetMesh(mesh.points, tets, "mixed")
    assert enclosed_volume(mesh.points, boundary(mixed)) == pytest.approx(1.0)
    report = check_tets(mixed)
    assert report.inverted == 24
    assert report.volume == pytest.approx(1.0)
    assert report.warnings[0].startswith(
        "mesh mixed: 24 of 48 elements have negative orientation (first: element 0)"
    )


def test_boundary_refuses_a_face_of_three_elements() -> None:
    points = np.vstack([REGULAR, [[3.0, 3.0, 3.0]], [[5.0, 5.0, 5.0]]])
    with pytest.raises(MeshError, match="belongs to 3 tetrahedra"):
        boundary(TetMesh(points, np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]])))


def test_slivers_are_accepted_with_a_warning() -> None:
    flat = REGULAR * [1.0, 1.0, 0.01]
    report = check_tets(TetMesh(flat, ONE, "flat"))
    assert report.slivers == 1
    assert "mesh flat: 1 of 1 elements are slivers" in report.warnings[0]


def test_coincident_nodes_are_accepted_with_a_warning() -> None:
    mesh = box_mesh((1.0, 1.0, 1.0), (1, 1, 1))
    twice = TetMesh(np.vstack([mesh.points, mesh.points]), np.vstack([mesh.tets, mesh.tets + 8]), "two")
    report = check_tets(twice)
    assert report.duplicate_nodes == 8
    assert "8 of 16 nodes lie exactly on an earlier node" in report.warnings[0]


BOX = box_mesh((1.0, 1.0, 1.0), (1, 1, 1))
NAN = np.where(BOX.points == 0.0, np.nan, BOX.points)


@pytest.mark.parametrize(
    ("points", "tets", "reason"),
    [
        (
            np.vstack([BOX.points, [[9.0, 9.0, 9.0]]]),
            BOX.tets,
            "1 of 9 nodes belong to no tetrahedron, .* node 8",
        ),
        (BOX.points * [1, 1, 0], BOX.tets, "6 of 6 elements have zero volume, the first is element 0"),
        (BOX.points, np.vstack([BOX.tets, [[0, 0, 1, 2]]]), "1 of 7 elements have zero volume, .* element 6"),
        (BOX.points, np.vstack([BOX.tets, BOX.tets[2:3, ::-1]]), "1 of 7 elements repeat .* element 6"),
        (BOX.points, BOX.tets + 1, "name a point outside 0..7"),
        (NAN, BOX.tets, "7 of 8 points have coordinates that are not finite, the first is point 0"),
        (BOX.points[:, :2], BOX.tets, r"shape \(8, 2\)"),
        (BOX.points, BOX.tets[:, :3], r"shape \(6, 3\)"),
        (BOX.points, BOX.tets[:0], "holds no tetrahedra"),
        (BOX.points[:0], BOX.tets, "holds no points"),
    ],
)
def test_refused_meshes(points: np.ndarray, tets: np.ndarray, reason: str) -> None:
    with pytest.raises(MeshError, match=f"mesh part: .*{reason}"):
        check_tets(TetMesh(points, tets, "part"))


def test_open_surface_is_not_closed() -> None:
    triangles = boundary(BOX)
    assert not is_closed(triangles[1:])
    flipped = triangles.copy()
    flipped[0] = flipped[0, ::-1]
    assert not is_closed(flipped)


def test_rotation_is_about_fixed_x_then_y_then_z() -> None:
    step_by_step = rotation_matrix((0, 0, 50)) @ rotation_matrix((0, 40, 0)) @ rotation_matrix((30, 0, 0))
    np.testing.assert_allclose(rotation_matrix((30, 40, 50)), step_by_step, atol=1e-15)
    assert rotation_matrix((90, 0, 0)).tolist() == [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    assert rotation_matrix((0, 0, -90)).tolist() == [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]


def test_place_scales_then_rotates_then_translates() -> None:
    placement = Placement(scale=2.0, rotation_deg=(0.0, 0.0, 90.0), translation=(10.0, 0.0, 0.0))
    assert place(np.array([[1.0, 2.0, 3.0]]), placement).tolist() == [[6.0, 2.0, 6.0]]
    points = np.ones((1, 3))
    copy = place(points, None)
    copy[0, 0] = 5.0
    assert points[0, 0] == 1.0
