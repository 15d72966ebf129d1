"""What is sent on /tf is one tree with REP-105's names, also of two robots in one graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import CommandError, Placement
from softsim_core.physics.mechanics import rotation_of
from softsim_core.physics.sensing import ImuDescription

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Time

from softsim_node import RobotFrames, prefix_of
from softsim_ros.nodes.simulator import FrameTree, bodies_topology

STAMP = Time(sec=3)


def sent(simulation: Simulation, prefix: str) -> list[Any]:
    tree = FrameTree(simulation, RobotFrames(prefix))
    return [*tree.still(STAMP), *tree.moving(simulation, STAMP)]


def in_world(transforms: Sequence[Any]) -> dict[str, np.ndarray]:
    """Poses (4, 4) of all frames; fails where they are no tree under `world`."""
    parents = {each.child_frame_id: each for each in transforms}
    assert len(parents) == len(transforms), "a frame has two parents"
    poses = {"world": np.eye(4)}
    while len(poses) <= len(parents):
        ready = [child for child, each in parents.items() if each.header.frame_id in poses]
        ready = [child for child in ready if child not in poses]
        assert ready, "frames do not hang on world"
        for child in ready:
            shift, turn = parents[child].transform.translation, parents[child].transform.rotation
            step = np.eye(4)
            step[:3, 3] = shift.x, shift.y, shift.z
            step[:3, :3] = rotation_of(np.array([turn.x, turn.y, turn.z, turn.w]))
            poses[child] = poses[parents[child].header.frame_id] @ step
    return poses


@pytest.mark.parametrize("scene", ["tripod", "cable_gripper", "tripod_maze"])
def test_two_robots_make_one_tree(scene: str) -> None:
    simulation = Simulation(load_scene(scene), backend="scipy")
    transforms = [*sent(simulation, "left/"), *sent(simulation, "lab/right/")]
    poses = in_world(transforms)
    assert {"left/base_link", "lab/right/base_link"} <= set(poses)
    for prefix in ("left/", "lab/right/"):
        for each in transforms:
            if each.header.frame_id.startswith(prefix):
                assert each.child_frame_id.startswith(prefix)


def test_frames_are_where_the_simulation_has_them_with_moved_bases() -> None:
    simulation = Simulation(load_scene("tripod"), backend="scipy")
    simulation._state.joint_positions[:] = (-0.5, -0.7, -0.9)
    simulation._state.base_shift[:] = 0.035
    poses, frames = in_world(sent(simulation, "tripod/")), simulation.frames()
    for frame, name in (
        ("tripod/servo_1_base", "servo_1"),
        ("tripod/servo_1_horn", "servo_1_horn"),
        ("tripod/effector", "centre"),
    ):
        np.testing.assert_allclose(poses[frame][:3, 3], frames[name].position, atol=1e-12)
        turn = rotation_of(frames[name].quaternion_xyzw)
        np.testing.assert_allclose(poses[frame][:3, :3], turn, atol=1e-12)


def test_every_rigid_body_has_the_frame_that_its_marker_names() -> None:
    for scene in ("cable_gripper", "tripod_maze"):
        simulation = Simulation(load_scene(scene), backend="scipy")
        tree, poses = FrameTree(simulation, RobotFrames("r/")), in_world(sent(simulation, "r/"))
        markers = bodies_topology(simulation, tree.of_body).markers
        assert [marker.ns for marker in markers] == [body.name for body in simulation.rigid_bodies]
        for marker, pose in zip(markers, simulation.rigid_poses, strict=True):
            np.testing.assert_allclose(poses[marker.header.frame_id][:3, 3], pose.position, atol=1e-9)


def test_imus_have_frames_of_their_own_wherever_they_sit() -> None:
    """Their frames turn gravity as they measure it at rest, and stand where what they sit on is."""
    pose = Placement(translation=(0.01, -0.02, 0.03), rotation_deg=(20.0, -70.0, 130.0))
    for scene, places in (
        ("tripod_ball", ("servo_1", "servo_2_base", "centre", "servo_top_0", "ball", "world", "table")),
        ("cable_gripper", ("base_2", "vertical", "cube")),
    ):
        sensors = tuple(ImuDescription(name=f"on_{place}", on=place, pose=pose) for place in places)
        simulation = Simulation(load_scene(scene).with_scene(sensors=sensors), backend="scipy")
        poses, tree = in_world(sent(simulation, "r/")), FrameTree(simulation, RobotFrames("r/"))
        for place in places:
            frame, carrier = poses[tree.of_sensor(f"on_{place}")], poses[tree.of_place(place)]
            np.testing.assert_allclose(frame[:3, 3], (carrier @ [0.01, -0.02, 0.03, 1.0])[:3], atol=1e-12)
            told = simulation.sensors[f"on_{place}"].value[:3]
            np.testing.assert_allclose(frame[:3, :3] @ told, (0.0, 0.0, 9.81), atol=1e-9)


@pytest.mark.parametrize(
    ("namespace", "prefix"), [("/tripod", "tripod/"), ("/", ""), ("", ""), ("/lab/left", "lab/left/")]
)
def test_the_prefix_comes_from_the_namespace(namespace: str, prefix: str) -> None:
    assert prefix_of(namespace) == prefix
    assert RobotFrames(prefix).base == f"{prefix}base_link"


@pytest.mark.parametrize("prefix", ["/left", "a b/", "x\n", "é/"])
def test_a_prefix_that_tf_refuses_is_refused(prefix: str) -> None:
    with pytest.raises(CommandError, match=r"frame_prefix .* is refused; allowed are letters"):
        RobotFrames(prefix)
