"""Surfaces of primitives are closed and outward; masses follow the textbook formulas."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import MeshError, MeshFile, Placement
from softsim_core.physics.mesh import (
    Shape,
    SurfaceMesh,
    box_surface,
    cylinder_surface,
    enclosed_volume,
    euler_number,
    is_closed,
    mass_properties,
    place,
    solid_properties,
    sphere_surface,
    surface_of,
    write_surface,
)

BOX = (0.02, 0.03, 0.05)
CLOSED = [Shape(sphere=0.013), Shape(box=BOX), Shape(cylinder=(0.01, 0.04))]


@pytest.mark.parametrize("shape", CLOSED)
def test_closed_outward_and_of_one_piece(shape: Shape) -> None:
    surface = surface_of(shape)
    assert is_closed(surface.triangles)
    assert euler_number(surface.triangles) == 2
    assert enclosed_volume(surface.points, surface.triangles) > 0.0


@pytest.mark.parametrize("divisions", [1, 2, 5])
def test_box_of_any_division_has_its_volume(divisions: int) -> None:
    surface = box_surface(BOX, divisions)
    assert len(surface.triangles) == 12 * divisions**2
    assert len(surface.points) == 6 * divisions**2 + 2
    assert is_closed(surface.triangles)
    assert enclosed_volume(surface.points, surface.triangles) == pytest.approx(math.prod(BOX), rel=1e-12)
    np.testing.assert_allclose(surface.points.max(axis=0), np.array(BOX) / 2.0)


def test_round_surfaces_have_their_vertices_on_the_true_one() -> None:
    sphere, cylinder = sphere_surface(0.013), cylinder_surface(0.01, 0.04)
    assert len(sphere.points) == 162
    np.testing.assert_allclose(np.linalg.norm(sphere.points, axis=1), 0.013)
    rim = cylinder.points[:-2]
    np.testing.assert_allclose(np.hypot(rim[:, 0], rim[:, 1]), 0.01)
    prism = 0.5 * 32 * 0.01**2 * math.sin(2.0 * math.pi / 32) * 0.04
    assert enclosed_volume(cylinder.points, cylinder.triangles) == pytest.approx(prism, rel=1e-12)


def test_plane_looks_up() -> None:
    surface = surface_of(Shape(plane=(0.2, 0.1)))
    edges = surface.points[surface.triangles[:, 1:]] - surface.points[surface.triangles[:, :1]]
    normals = np.cross(edges[:, 0], edges[:, 1])
    np.testing.assert_allclose(0.5 * normals.sum(axis=0), [0.0, 0.0, 0.02])
    assert (normals[:, 2] > 0.0).all()


@pytest.mark.parametrize("shape", CLOSED)
def test_formulas_agree_with_the_divergence_theorem_on_fine_surfaces(shape: Shape) -> None:
    fine = {
        "sphere": lambda: sphere_surface(0.013, 5),
        "box": lambda: box_surface(BOX, 3),
        "cylinder": lambda: cylinder_surface(0.01, 0.04, 1000),
    }
    surface = next(fine[name]() for name in fine if getattr(shape, name) is not None)
    centre, inertia = mass_properties(shape, surface, 0.7)
    other_centre, other_inertia = solid_properties(surface, 0.7)
    np.testing.assert_allclose(other_centre, centre, atol=1e-12)
    np.testing.assert_allclose(other_inertia, inertia, rtol=1e-3, atol=1e-12)


def test_inertia_formulas() -> None:
    _, ball = mass_properties(Shape(sphere=0.013), sphere_surface(0.013), 0.032)
    np.testing.assert_allclose(ball, 2.1632e-6 * np.eye(3))
    _, cube = mass_properties(Shape(box=(0.04, 0.04, 0.04)), box_surface((0.04, 0.04, 0.04)), 0.03)
    np.testing.assert_allclose(cube, 8.0e-6 * np.eye(3))


def test_a_moved_and_turned_mesh_moves_and_turns_its_properties(tmp_path: Path) -> None:
    base = box_surface(BOX)
    centre, inertia = solid_properties(base, 2.0)
    turned = Placement(rotation_deg=(20.0, -35.0, 70.0), translation=(0.1, -0.2, 0.3))
    moved = SurfaceMesh(place(base.points, turned), base.triangles)
    rotation = place(np.eye(3), Placement(rotation_deg=turned.rotation_deg)).T
    moved_centre, moved_inertia = solid_properties(moved, 2.0)
    np.testing.assert_allclose(moved_centre, centre + turned.translation, atol=1e-15)
    np.testing.assert_allclose(moved_inertia, rotation @ inertia @ rotation.T, rtol=1e-9, atol=1e-16)
    file = write_surface(tmp_path / "box.stl", base)
    shape = Shape(mesh=MeshFile(file=file, placement=turned))
    np.testing.assert_allclose(
        mass_properties(shape, surface_of(shape), 2.0)[1], moved_inertia, rtol=1e-5, atol=1e-10
    )


def test_open_and_inward_surfaces_take_no_mass() -> None:
    box = box_surface(BOX)
    with pytest.raises(MeshError, match="must be closed"):
        solid_properties(SurfaceMesh(box.points, box.triangles[1:], "lid"), 1.0)
    with pytest.raises(MeshError, match="mesh inside: the surface winds inward"):
        solid_properties(SurfaceMesh(box.points, box.triangles[:, ::-1], "inside"), 1.0)
