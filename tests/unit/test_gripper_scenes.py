"""The gripper's robot file, its parts and the tutorial's steps as scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import ConfigError, Placement, SceneError
from softsim_core.physics.mesh import Shape
from softsim_core.robots import cable_finger, cable_gripper, rigid_thing
from softsim_core.scene import Scene

STEPS = ["0", "1", "2", "2_2", "3", "4", "5"]
REFERENCE_BOXES = {  # corners of the placed fingers in the tutorial's axes, in mm
    "finger_1": ((10.09, -101.39, 0.0), (46.75, 0.0, 15.0)),
    "finger_2": ((-53.68, -96.72, -19.0), (-3.87, 0.0, -4.0)),
    "finger_3": ((-53.68, -96.72, 19.0), (-3.87, 0.0, 34.0)),
}


def scene_of(*parts: object) -> Scene:
    scene = Scene(name="own")
    scene.add(parts)
    return scene


@pytest.mark.parametrize("step", STEPS)
def test_every_step_of_the_tutorial_runs(step: str) -> None:
    simulation = Simulation(load_scene(f"gripper_step_{step}"), backend="scipy")
    for _ in range(3):
        simulation.step()
    assert np.isfinite(simulation.positions).all()


def test_joints_and_limits_of_the_robot() -> None:
    robot = load_scene("cable_gripper")
    assert robot.joint_names == (
        "finger_1_cable",
        "finger_2_cable",
        "finger_3_cable",
        "vertical",
        "sideways",
    )
    assert all(joint.limits.speed == 0.05 for joint in robot.joints)
    assert robot.joints[4].parent == "vertical"
    assert {each.actuator.pull_on for each in robot.joints[:3] if each.actuator} == {"sideways"}


def test_the_part_is_the_robot_file() -> None:
    part, robot = scene_of(cable_gripper()).describe(), load_scene("cable_gripper")
    assert part.joint_names == robot.joint_names
    for own, other in zip(part.joints, robot.joints, strict=True):
        assert (own.kind, own.limits, own.axis, own.parent) == (
            other.kind,
            other.limits,
            other.axis,
            other.parent,
        )
        if own.actuator is not None and other.actuator is not None:
            assert own.actuator.pull_point == pytest.approx(other.actuator.pull_point)
            assert own.actuator.placement == other.actuator.placement
    surfaces = {each.name: each for each in robot.scene.collisions}
    for collision in part.scene.collisions:
        other = surfaces[collision.name]
        assert collision.groups == other.groups
        for box, other_box in zip(collision.boxes, other.boxes, strict=True):
            np.testing.assert_allclose(box.center, other_box.center, atol=1e-6)
            assert box.rotation_deg == pytest.approx(other_box.rotation_deg)
    for base, other_base in zip(part.scene.attachments, robot.scene.attachments, strict=True):
        np.testing.assert_allclose(base.box.center, other_base.box.center, atol=1e-6)


def test_fingers_sit_where_the_tutorial_has_them() -> None:
    simulation = Simulation(load_scene("cable_gripper"), backend="scipy")
    for body in simulation.bodies:
        points = simulation.positions[body.nodes][:, [1, 2, 0]] * 1e3
        low, high = REFERENCE_BOXES[body.name]
        np.testing.assert_allclose(points.min(axis=0), low, atol=0.6)  # our round tip has a chord less
        np.testing.assert_allclose(points.max(axis=0), high, atol=0.6)


def test_walls_are_the_strips_beside_the_notches() -> None:
    """Two strips a side of four triangles each, and no triangle of a finger's flanks."""
    simulation = Simulation(load_scene("gripper_step_4"), backend="scipy")
    surfaces = {each.name: each for each in simulation.collision_surfaces}
    points = simulation.collision_points
    for name, facing in (("tip_walls", 1.0), ("base_walls", -1.0)):
        corners = points[surfaces[name].triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        expected = [0.0, facing * np.cos(np.radians(37.5)), np.sin(np.radians(37.5))]
        np.testing.assert_allclose(normals, np.broadcast_to(expected, normals.shape), atol=1e-9)
        assert len(normals) == 8


def test_bases_and_pull_points_move_along(backend: str) -> None:
    simulation = Simulation(load_scene("gripper_step_5"), backend=backend)
    before = simulation.positions.copy()
    pulls = [cable.points[0] for cable in simulation.actuators]
    simulation.enforce_limits = False  # in one step
    simulation.command([0.0, 0.0, 0.0, 0.002, -0.001])
    simulation.step()
    shift = np.array([0.0, -0.001, 0.002])
    for cable, pull in zip(simulation.actuators, pulls, strict=True):
        np.testing.assert_allclose(cable.points[0], pull + shift, atol=1e-12)
    top = np.flatnonzero(np.abs(before @ [0.0, 0.0, 1.0]) < 1e-3)
    moved = (simulation.positions - before)[top]
    assert len(top) >= 9
    np.testing.assert_allclose(moved, np.broadcast_to(shift, moved.shape), atol=1e-9)


def test_the_cube_of_the_reference_preset_rests_3_mm_above_the_floor() -> None:
    simulation = Simulation(load_scene("cable_gripper_reference"))
    for _ in range(100):
        simulation.step()
    cube = simulation.rigid_poses[1].position
    np.testing.assert_allclose(cube, [0.010, 0.0, -0.13833], atol=2e-5)


def test_a_cable_point_far_outside_is_refused_by_name_place_and_distance() -> None:
    robot = scene_of(cable_finger("finger", collides=False)).describe()
    cable = robot.joints[0].actuator
    assert cable is not None
    points = cable.points_in()
    assert points.shape == (13, 3)
    text = (
        "name: own\nextends: {}\njoints: [{{name: cable, cable: {{points: [[0.0, 0.0, 0.1], [0, 0, 0]]}}}}]"
    )
    with pytest.raises(SceneError, match=r"cable cable: point 0 .* lies outside body finger, .* mm from"):
        Simulation(load_scene(_written(text.format(load_scene("cable_finger").source))))


def test_overlap_at_the_start_names_both() -> None:
    box = Shape(box=(0.04, 0.04, 0.04))
    scene = scene_of(
        rigid_thing("floor", Shape(box=(0.2, 0.2, 0.01))),
        rigid_thing("cube", box, Placement(translation=(0.0, 0.0, 0.024)), mass=0.03),
    )
    with pytest.raises(SceneError, match=r"cube and floor overlap|floor and cube overlap"):
        Simulation(scene.describe())


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _written(text: str, name: str = "own.yaml") -> Path:
    file = Path(name)
    file.write_text(text)
    return file


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("cable", "{body: finger, points: none.json}", r"cable\.points: no such file of cable points"),
        ("cable", "{body: finger, points: [[0, 0]]}", r"points\[0\]: must be a list of 3 numbers"),
        ("cable", "{body: finger, points: 3}", r"cable\.points: must be a list, not 3"),
        ("cable", "{body: finger, points: [[0, 0, 0]]}", r"cable\.points: must be at least 2 points, not 1"),
        ("cable", "{body: toe, points: [[0, 0, 0], [1, 0, 0]]}", "unknown body of cable pull 'toe'"),
        ("cable", "{body: finger}", r"cable\.points: must be at least 2 points, not 0"),
    ],
)
def test_wrong_cables_in_a_file(key: str, value: str, sentence: str) -> None:
    source = load_scene("gripper_step_2").source
    file = _written(f"name: own\nextends: {source}\njoints: [{{name: pull, kind: cable, {key}: {value}}}]")
    with pytest.raises(ConfigError, match=sentence):
        load_scene(file)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{name: a, shape: {sphere: 0.01, box: [1, 1, 1]}}", "give exactly one of sphere, box"),
        ("{name: a, shape: {sphere: -1}}", r"size: must be > 0 m, not -1"),
        ("{name: a, shape: {sphere: 0.01}, mass: 0}", r"mass: must be > 0 kg, not 0"),
        ("{name: a, shape: {plane: [1, 1]}, mass: 1}", "a plane has no volume"),
        ("{name: a, shape: {mesh: {file: none.stl}}}", r"shape\.mesh\.file: no such mesh file"),
        ("{name: a, shape: {sphere: 0.01}, on: moon}", "unknown carrier of rigid body a 'moon'"),
        ("{name: a, shape: {sphere: 0.01}, mas: 1}", "unknown key; did you mean mass"),
    ],
)
def test_wrong_rigid_bodies_in_a_file(text: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        load_scene(_written(f"name: own\nrigid_bodies: [{text}]"))
