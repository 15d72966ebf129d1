"""Overlapping start poses of every two kinds of bodies: refused, and named."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from small_scenes import body

from softsim_core import Simulation
from softsim_core.base import MeshFile, Placement, SceneError
from softsim_core.physics.contact import CollisionSurface, ContactSettings, first_overlap
from softsim_core.physics.mesh import Shape, TetMesh, box_mesh, box_surface, write_surface
from softsim_core.scene import CollisionDescription, RigidBodyDescription, SceneDescription

HALF = 0.02
"""Half the height of each body in [m]; a plane has none."""
SOLIDS = ("sphere", "box", "cylinder", "mesh", "soft")
PAIRS = tuple(itertools.combinations_with_replacement(SOLIDS, 2))


def scene_of(
    folder: Path, first: str, second: str, at: tuple[float, float, float], scale: float = 1.0
) -> SceneDescription:
    """A fixed body around the origin and a free one, `scale` times as large, at `at` [m]."""
    bodies, rigid = [], []
    parts = (("base", first, (0.0, 0.0, 0.0), HALF, None), ("thing", second, at, scale * HALF, 0.1))
    for name, kind, centre, half, mass in parts:
        size = (2.0 * half,) * 3
        if kind == "soft":
            block = box_mesh(size, (2, 2, 2), tuple(float(x) - half for x in centre))
            bodies.append(body(TetMesh(block.points, block.tets, name), name))
            continue
        shape = Shape(plane=(0.2, 0.2))
        if kind == "sphere":
            shape = Shape(sphere=half)
        elif kind == "cylinder":
            shape = Shape(cylinder=(half, 2.0 * half))
        elif kind == "box":
            shape = Shape(box=size)
        elif kind == "mesh":
            file = folder / f"{name}.stl"
            write_surface(file, box_surface(size))
            shape = Shape(mesh=MeshFile(file=file))
        rigid.append(
            RigidBodyDescription(name=name, shape=shape, mass=mass, pose=Placement(translation=centre))
        )
    return SceneDescription(
        name="pair",
        bodies=tuple(bodies),
        rigid_bodies=tuple(rigid),
        collisions=tuple(CollisionDescription(name=f"{name}_skin", body=name) for name in ("base", "thing")),
        contact=ContactSettings(alarm_distance=0.004, contact_distance=0.001),
    )


def assert_refused(scene: SceneDescription) -> None:
    """One sentence names both surfaces."""
    with pytest.raises(SceneError, match="overlap") as caught:
        Simulation(scene)
    said = str(caught.value)
    assert "base_skin" in said
    assert "thing_skin" in said
    assert "\n" not in said
    assert len(said) < 300


@pytest.mark.parametrize(("first", "second"), PAIRS)
@pytest.mark.parametrize(
    ("at", "scale"),
    [
        pytest.param((0.001, 0.002, 2.0 * HALF - 0.018), 1.0, id="18_mm_deep"),
        pytest.param((0.001, 0.002, 2.0 * HALF - 0.0005), 1.0, id="0.5_mm_deep"),
        pytest.param((0.001, 0.002, 0.003), 0.2, id="wholly_inside"),
        pytest.param((0.001, 0.002, 0.003), 5.0, id="wholly_around"),
        pytest.param((0.0, 0.0, 0.0), 1.0, id="at_one_place"),
        pytest.param((0.0, 0.0, HALF), 1.0, id="half_a_height_up"),
    ],
)
def test_bodies_that_overlap_are_refused(tmp_path: Path, first: str, second: str, at, scale: float) -> None:
    assert_refused(scene_of(tmp_path, first, second, at, scale))


@pytest.mark.parametrize("second", SOLIDS)
@pytest.mark.parametrize("height", [HALF - 0.018, HALF - 0.0005, 0.018 - HALF])
def test_bodies_across_a_plane_are_refused(tmp_path: Path, second: str, height: float) -> None:
    assert_refused(scene_of(tmp_path, "plane", second, (0.001, 0.002, height)))


@pytest.mark.parametrize(("first", "second"), [*PAIRS, *(("plane", each) for each in SOLIDS)])
@pytest.mark.parametrize("gap", [0.0005, 0.0])
def test_bodies_that_only_touch_stand(tmp_path: Path, first: str, second: str, gap: float) -> None:
    height = HALF + gap if first == "plane" else 2.0 * HALF + gap
    assert Simulation(scene_of(tmp_path, first, second, (0.0, 0.0, height))).time == 0.0


@pytest.mark.parametrize("depth", [0.001, 0.003, 0.018, 0.03])
def test_a_cube_through_a_thin_floor_is_refused(depth: float) -> None:
    """Deeper than the floor is thick, no corner of the cube is inside it."""
    floor = RigidBodyDescription(name="floor", shape=Shape(box=(0.15, 0.15, 0.004)))
    at = Placement(translation=(0.01, 0.0, 0.022 - depth))
    cube = RigidBodyDescription(name="cube", shape=Shape(box=(0.04, 0.04, 0.04)), mass=0.03, pose=at)
    scene = SceneDescription(
        name="thin",
        rigid_bodies=(floor, cube),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in ("floor", "cube")),
        contact=ContactSettings(alarm_distance=0.004, contact_distance=0.001),
    )
    with pytest.raises(SceneError, match="collision surfaces floor and cube overlap"):
        Simulation(scene)


def test_surfaces_of_one_body_close_it_in_together() -> None:
    """The lid and the rest of a cube are open, yet what lies in the cube is inside it."""
    cube = box_surface((0.04, 0.04, 0.04))
    n = len(cube.points)
    lid = (cube.points[cube.triangles][:, :, 2] > 0.019).all(axis=1)
    points = np.concatenate([cube.points, cube.points, np.zeros((1, 3))])
    surfaces = (
        CollisionSurface(name="rest", vertices=slice(0, n), triangles=cube.triangles[~lid], owner=0),
        CollisionSurface(name="lid", vertices=slice(n, 2 * n), triangles=cube.triangles[lid] + n, owner=0),
        CollisionSurface(name="ball", vertices=slice(2 * n, 2 * n + 1), radius=0.005, owner=1),
    )
    assert first_overlap(surfaces, points) == (2, 0)
    assert first_overlap((surfaces[0], surfaces[2]), points) is None  # open: it may lie in a cup
