"""What surrounds the inverse controller: checked poses, a plant that stops, feedback, settings, report."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import PoseStamped

from softsim_core.base import CommandError
from softsim_core.physics.mechanics import Pose, quaternion_of, rotation_exp, rotation_log, rotation_of
from softsim_core.scene import load_scene
from softsim_node import RobotFrames
from softsim_ros.messages import ERROR, OK, WARN
from softsim_ros.nodes.inverse import (
    FEEDBACK_WITHIN_S,
    SILENT_AFTER_S,
    STUCK_AFTER_S,
    ControllerSettings,
    ControlStatus,
    FollowingCheck,
    Plant,
    checked_pose,
    has_moved,
    health,
)

TRIPOD = load_scene("tripod")
FRAMES = RobotFrames("tripod/")
START = np.full(3, -1.4965)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def message(
    position: tuple[float, ...] = (0.01, 0.02, 0.03),
    turn: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0),
    frame: str = "world",
) -> PoseStamped:
    stamped = PoseStamped()
    stamped.header.frame_id = frame
    place, orientation = stamped.pose.position, stamped.pose.orientation
    place.x, place.y, place.z = position
    orientation.x, orientation.y, orientation.z, orientation.w = turn
    return stamped


def test_a_pose_is_read_and_its_quaternion_made_exact() -> None:
    pose = checked_pose(message(turn=(0.0, 0.0, 0.6001, 0.8), frame="tripod/base_link"), FRAMES, "goal")
    assert pose.position.tolist() == [0.01, 0.02, 0.03]
    assert np.linalg.norm(pose.quaternion_xyzw) == pytest.approx(1.0, abs=1e-15)
    blank = checked_pose(message(turn=(0.0, 0.0, 0.0, 0.0)), FRAMES, "goal")
    assert blank.quaternion_xyzw.tolist() == UPRIGHT.tolist()


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (message(frame=""), "goal refused: unknown frame_id ''; allowed: world, tripod/base_link"),
        (message((math.nan, 0.0, 0.0)), "goal refused: position [nan, 0.0, 0.0] is not finite"),
        (message((0.0, -math.inf, 0.0)), "is not finite"),
        (message(turn=(0.0, 0.0, 0.0, 2.0)), "is no unit quaternion"),
        (message(turn=(math.nan, 0.0, 0.0, 1.0)), "is no unit quaternion"),
    ],
)
def test_a_wrong_pose_is_refused(wrong: PoseStamped, sentence: str) -> None:
    with pytest.raises(CommandError) as caught:
        checked_pose(wrong, FRAMES, "goal")
    assert sentence in str(caught.value)


def test_silent_joints_are_trouble_until_they_are_back() -> None:
    following = FollowingCheck(TRIPOD.joints, 0.0)
    assert "no joint states" in following.trouble(Plant(), START, 0.0)
    plant = Plant().with_joints(START, 1.0)
    assert following.trouble(plant, START, 1.0 + SILENT_AFTER_S) == ""
    assert "no joint states" in following.trouble(plant, START, 1.1 + SILENT_AFTER_S)
    assert following.trouble(plant.with_joints(START, 5.0), START, 5.0) == ""


def test_stuck_joints_are_trouble_until_they_follow() -> None:
    following = FollowingCheck(TRIPOD.joints, 0.0)
    command = START + np.array([0.0, 0.3, 0.0])
    for now in (0.0, 0.5 * STUCK_AFTER_S, STUCK_AFTER_S):
        assert following.trouble(Plant().with_joints(START, now), command, now) == ""
    late = 1.1 * STUCK_AFTER_S
    assert "servo_1 not following" in following.trouble(Plant().with_joints(START, late), command, late)
    assert following.trouble(Plant().with_joints(command, late), command, late) == ""
    assert following.trouble(Plant().with_joints(START, late), command, late) == ""  # it has time again


def test_joint_positions_that_are_not_finite_are_not_used() -> None:
    plant = Plant().with_joints(START, 1.0)
    assert plant.with_joints(np.array([0.0, math.nan, 0.0]), 2.0) is plant


def test_bases_have_moved_only_when_somebody_says_so() -> None:
    assert not has_moved(0.035, Plant())
    assert not has_moved(0.035, Plant(base_shift=0.035))
    assert has_moved(0.035, Plant(base_shift=0.0))


def test_feedback_is_what_was_asked_for_and_fresh() -> None:
    model, seen = Pose(np.zeros(3), UPRIGHT), Pose(np.ones(3), UPRIGHT)
    plant = Plant().with_effector(seen, 1.0).with_imu(UPRIGHT, 1.0)
    assert plant.measured_pose("effector_pose", model, 1.0) is seen
    assert plant.measured_pose("none", model, 1.0) is None
    for feedback in ("effector_pose", "imu"):
        assert plant.measured_pose(feedback, model, 1.1 + FEEDBACK_WITHIN_S) is None
    assert plant.measured_pose("imu", None, 1.0) is None


def test_an_imu_measures_tilt_and_leaves_heading_and_place_to_the_model() -> None:
    rotation = rotation_exp(np.array([0.1, -0.2, 0.7]))
    model = Pose(np.array([0.01, 0.02, 0.03]), quaternion_of(rotation))
    imu = quaternion_of(rotation_exp(np.array([0.05, 0.03, -0.4])) @ rotation)
    measured = Plant().with_imu(imu, 0.0).measured_pose("imu", model, 0.0)
    assert measured is not None
    assert measured.position is model.position
    error = rotation_log(rotation_of(measured.quaternion_xyzw) @ rotation.T)
    assert error == pytest.approx([0.05, 0.03, 0.0], abs=1e-12)


def test_the_parameters_begin_as_the_robots_file_says_and_lie_over_it() -> None:
    settings = ControllerSettings.of(TRIPOD, "tripod")
    assert settings.over(TRIPOD.inverse) == TRIPOD.inverse
    other = replace(settings, rate=20.0, task="pose", base_shift=0.01).over(TRIPOD.inverse)
    assert other == replace(TRIPOD.inverse, rate=20.0, task="pose")


def test_the_report_says_off_holding_and_fault() -> None:
    assert health(ControlStatus(), True, "none", 0)[:2] == (OK, "off")
    holding = ControlStatus(mode="holding", message="holding: no joint states")
    assert health(holding, True, "none", 0)[:2] == (WARN, "holding: no joint states")
    fault = ControlStatus(message="inverse control is off: why", fault=True)
    assert health(fault, True, "none", 0)[:2] == (ERROR, "inverse control is off: why")
    assert health(ControlStatus(), False, "none", 0)[0] == ERROR
    assert health(ControlStatus(), True, "imu", 7)[2]["foreign_commands"] == 7
