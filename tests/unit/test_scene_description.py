"""Rules of descriptions that no loader adds: the robot's name, and a scene without a robot."""

from __future__ import annotations

import pytest
from small_scenes import machine

from softsim_core.base import SceneError
from softsim_core.scene import (
    InverseSettings,
    RobotDescription,
    Scene,
    SceneDescription,
    StartAnimation,
    ViewSettings,
    as_robot,
)
from softsim_core.simulation import Simulation

NO_NAMESPACES = ("", "two words", "9lives", "a/b", "é")


@pytest.mark.parametrize("name", NO_NAMESPACES)
def test_a_robot_s_name_is_its_ros_namespace(name: str) -> None:
    robot = RobotDescription(scene=SceneDescription(name=name))
    for refused in (lambda: robot.namespace, Scene(name=name).describe):
        with pytest.raises(SceneError, match="scene: name must be letters, digits and underscores"):
            refused()


def test_a_scene_alone_may_have_any_name_and_runs() -> None:
    scene = SceneDescription(name="a beam, 10 cm")
    simulation = Simulation(scene, backend="scipy")
    simulation.step()
    assert simulation.scene is scene
    assert simulation.robot == RobotDescription(scene=scene)


def test_a_robot_is_taken_as_it_is() -> None:
    robot = RobotDescription(scene=machine(), poses={"bent": (0.1, 0.2, 0.001, 0.002)})
    assert as_robot(robot) is robot
    assert (robot.name, robot.joints) == ("test", robot.scene.joints)
    assert robot.joint_names == robot.scene.joint_names
    assert robot.with_scene(dt=0.002).scene.dt == 0.002
    assert robot.with_scene(dt=0.002).poses == robot.poses


def test_a_start_move_ends_in_its_pose_and_without_one_joints_rest() -> None:
    pose = (0.1, 0.2, 0.001, 0.002)
    still = RobotDescription(scene=machine(), poses={"bent": pose})
    assert (still.start_joints, still.start_shift) == (tuple(joint.rest for joint in still.joints), 0.0)
    moving = RobotDescription(
        scene=machine(), poses={"bent": pose}, start=StartAnimation(pose="bent", base_shift=0.01)
    )
    assert (moving.start_joints, moving.start_shift) == (pose, 0.01)
    alone = moving.robot_alone()
    assert (alone.start, alone.scene.collisions, alone.poses) == (None, (), moving.poses)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"start": StartAnimation(pose="up")}, "unknown pose 'up'; known: none"),
        ({"inverse": InverseSettings(posture="up")}, "unknown pose 'up'"),
        ({"poses": {"up": (1.0,)}}, "pose up has 1 values for 4 joints"),
        (
            {"view": ViewSettings(hidden=("bodies/arm",))},
            "unknown part to hide 'bodies/arm'; ",
        ),
    ],
)
def test_what_a_robot_names_must_be_in_its_scene(fields: dict[str, object], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        RobotDescription(scene=machine(), **fields)  # type: ignore[arg-type]
