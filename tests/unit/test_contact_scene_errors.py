"""Scenes of things that touch that cannot be built: one sentence each, which names the part."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_scenes import body, slab

from softsim_core import Simulation
from softsim_core.base import Array, Box, IndexArray, MeshFile, Placement, SoftSimError
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mesh import Shape, SurfaceMesh, box_mesh, box_surface, write_surface
from softsim_core.scene import CollisionDescription, JointDescription, RigidBodyDescription, SceneDescription

CUBE = Shape(box=(0.04, 0.04, 0.04))


def surface_file(folder: Path, points: Array, triangles: IndexArray) -> MeshFile:
    """A surface in a file."""
    file = folder / "thing.stl"
    write_surface(file, SurfaceMesh(points, triangles, "thing"))
    return MeshFile(file=file)


def pair(**second: Any) -> SceneDescription:
    """A fixed cube around the origin and a second rigid body, both collide."""
    bodies = (RigidBodyDescription(name="base", shape=CUBE), RigidBodyDescription(name="thing", **second))
    return SceneDescription(
        name="pair",
        rigid_bodies=bodies,
        collisions=tuple(CollisionDescription(name=f"{each.name}_skin", body=each.name) for each in bodies),
        contact=ContactSettings(alarm_distance=0.004, contact_distance=0.001),
    )


def sentence_of(build: Any) -> str:
    """What is said where something cannot be built."""
    with pytest.raises(SoftSimError) as caught:
        build()
    said = str(caught.value)
    assert "\n" not in said
    assert len(said) < 300
    return said


def test_an_open_surface_of_a_body_with_mass_is_refused(tmp_path: Path) -> None:
    cube = box_surface((0.02, 0.02, 0.02))
    file = surface_file(tmp_path, cube.points, cube.triangles[:-1])
    above = Placement(translation=(0.0, 0.0, 0.05))
    said = sentence_of(lambda: Simulation(pair(shape=Shape(mesh=file), mass=0.1, pose=above)))
    assert "thing" in said
    assert "closed" in said


def test_the_same_open_surface_stands_where_it_has_no_mass(tmp_path: Path) -> None:
    cube = box_surface((0.02, 0.02, 0.02))
    file = surface_file(tmp_path, cube.points, cube.triangles[:-1])
    falling = RigidBodyDescription(
        name="ball", shape=Shape(sphere=0.005), mass=0.01, pose=Placement(translation=(0, 0, 0.1))
    )
    scene = SceneDescription(
        name="open",
        rigid_bodies=(RigidBodyDescription(name="thing", shape=Shape(mesh=file)), falling),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in ("thing", "ball")),
    )
    Simulation(scene).step()


def test_a_surface_that_crosses_itself_is_refused(tmp_path: Path) -> None:
    cube = box_surface((0.02, 0.02, 0.02))
    twice = np.concatenate([cube.points, cube.points + np.array([0.01, 0.003, 0.002])])
    triangles = np.concatenate([cube.triangles, cube.triangles + len(cube.points)])
    file = surface_file(tmp_path, twice, triangles)
    above = Placement(translation=(0.0, 0.0, 0.05))
    said = sentence_of(lambda: Simulation(pair(shape=Shape(mesh=file), mass=0.1, pose=above)))
    assert "thing" in said
    assert "cross" in said


@pytest.mark.parametrize("mass", [0.0, -1.0, float("nan"), float("inf")])
def test_a_mass_that_is_none_is_refused(mass: float) -> None:
    said = sentence_of(lambda: pair(shape=CUBE, mass=mass))
    assert said.startswith("rigid body thing: mass")
    assert "> 0" in said


@pytest.mark.parametrize("shape", [CUBE, Shape(sphere=0.02), Shape(cylinder=(0.02, 0.04))])
def test_bodies_that_overlap_at_the_start_are_refused(shape: Shape) -> None:
    at = Placement(translation=(0.001, 0.002, 0.039))
    said = sentence_of(lambda: Simulation(pair(shape=shape, mass=0.1, pose=at)))
    assert "base_skin" in said
    assert "thing_skin" in said
    assert "overlap by" in said


def test_a_body_deep_inside_another_is_refused() -> None:
    at = Placement(translation=(0.001, 0.002, 0.003))
    small = Shape(box=(0.01, 0.01, 0.01))
    said = sentence_of(lambda: Simulation(pair(shape=small, mass=0.1, pose=at)))
    assert "base_skin" in said
    assert "overlap" in said


def cable_scene(*points: tuple[float, float, float]) -> SceneDescription:
    """A bar held at its left end, with a cable through the points."""
    bar = box_mesh((0.06, 0.02, 0.02), (6, 2, 2), (0.0, -0.01, -0.01))
    return SceneDescription(
        name="bar",
        bodies=(body(bar, "bar"),),
        attachments=(slab("left", "world", 0.0, "bar"),),
        joints=(
            JointDescription(
                name="tendon", kind="cable", actuator=CableDescription(body="bar", points=points)
            ),
        ),
    )


def test_a_cable_point_outside_its_body_is_refused() -> None:
    said = sentence_of(lambda: Simulation(cable_scene((0.01, 0.0, 0.0), (0.05, 0.0, 0.02))))
    assert said.startswith("cable tendon: point 1")
    assert "bar" in said
    assert "outside" in said


def test_a_cable_of_one_point_is_refused() -> None:
    assert "at least 2 points" in sentence_of(lambda: cable_scene((0.01, 0.0, 0.0)))


def test_a_cable_whose_points_coincide_is_refused() -> None:
    said = sentence_of(lambda: Simulation(cable_scene((0.01, 0.0, 0.0), (0.01, 0.0, 0.0))))
    assert "tendon" in said


def test_boxes_of_a_skin_without_a_triangle_are_refused() -> None:
    far = Box(size=(0.01, 0.01, 0.01), center=(1.0, 0.0, 0.0))
    skin = CollisionDescription(name="skin", body="body", boxes=(far,))
    described = SceneDescription(
        name="far",
        bodies=(body(box_mesh((0.02, 0.02, 0.02), (1, 1, 1))),),
        attachments=(slab("base", "world", 0.0),),
        collisions=(skin,),
    )
    said = sentence_of(lambda: Simulation(described))
    assert "skin" in said
    assert "inside its boxes" in said
