"""Commands and trajectories to a simulator in another process."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

from builtin_interfaces.msg import Duration  # noqa: E402
from geometry_msgs.msg import PoseStamped  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

MID = [-1.0466666666666666] * 3


def reaches(states: list[JointState], goal: Sequence[float], wait: Any, tolerance: float = 1e-9) -> bool:
    return bool(wait(lambda: bool(states) and np.allclose(states[-1].position, goal, atol=tolerance)))


def trajectory(joints: list[str], points: list[tuple[float, list[float]]]) -> JointTrajectory:
    return JointTrajectory(
        joint_names=joints,
        points=[
            JointTrajectoryPoint(
                positions=positions, time_from_start=Duration(sec=int(t), nanosec=round(t % 1.0 * 1e9))
            )
            for t, positions in points
        ],
    )


def test_a_command_moves_the_joints_and_the_effector(tripod: Any, spin_until: Any) -> None:
    states = tripod.client.collect(JointState, "joint_states")
    poses = tripod.client.collect(PoseStamped, "effector_pose")
    assert spin_until(lambda: states and poses)
    height = poses[-1].pose.position.z
    tripod.command([-0.3] * 3)
    assert reaches(states, [-0.3] * 3, spin_until)
    assert states[-1].name == ["servo_0", "servo_1", "servo_2"]
    assert states[-1].header.frame_id == "tripod/base_link"
    assert poses[-1].header.frame_id == "world"
    assert all(effort != 0.0 for effort in states[-1].effort)
    assert spin_until(lambda: poses[-1].pose.position.z > height + 2e-3)


def test_speed_limits_hold_on_the_way(tripod: Any, spin_until: Any) -> None:
    states = tripod.client.collect(JointState, "joint_states")
    assert spin_until(lambda: states)
    tripod.command(MID)
    assert reaches(states, MID, spin_until)
    assert max(abs(state.velocity[0]) for state in states) <= 3.5 + 1e-9


def test_limits_clamp_and_the_diagnostics_count_it(tripod: Any, spin_until: Any) -> None:
    states = tripod.client.collect(JointState, "joint_states")
    tripod.command([-0.5, -9.0, 9.0])
    assert reaches(states, [-0.5, -2.0225, -0.0255], spin_until)


def test_switched_off_limits_allow_more(tripod: Any, spin_until: Any) -> None:
    states = tripod.client.collect(JointState, "joint_states")
    assert tripod.set_parameters(enforce_limits=False)[0]
    tripod.command([0.2, 0.2, 0.2])
    assert reaches(states, [0.2] * 3, spin_until)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ([0.1, 0.2], "expected 3 (servo_0, servo_1, servo_2)"),
        ([], "command of 0 values refused"),
        ([0.0, math.nan, 0.0], "nan for joint servo_1 refused"),
        ([0.0, 0.0, math.inf], "inf for joint servo_2 refused"),
    ],
)
def test_wrong_commands_are_refused_whole(
    tripod: Any, spin_until: Any, values: list[float], sentence: str
) -> None:
    states = tripod.client.collect(JointState, "joint_states")
    assert spin_until(
        lambda: tripod.command(values) or sentence in tripod.process.output
    )  # throttled to 1 Hz
    tripod.command([-0.3, -0.3, -0.3])
    assert reaches(states, [-0.3] * 3, spin_until)
    assert np.isfinite([state.position for state in states]).all()
    assert max(state.position[0] for state in states) <= 0.0


def test_a_trajectory_is_interpolated_for_the_joints_it_names(tripod: Any, spin_until: Any) -> None:
    states = tripod.client.collect(JointState, "joint_states")
    tripod.command([-0.5] * 3)
    assert reaches(states, [-0.5] * 3, spin_until)
    states.clear()
    tripod.client.publish("joint_trajectory", trajectory(["servo_2"], [(1.0, [-1.5]), (1.5, [-1.5])]))
    assert reaches(states, [-0.5, -0.5, -1.5], spin_until)
    steps = 100.0 * (np.array([state.position[2] for state in states]) + 0.5)
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)  # 1 rad/s for 0.01 s each
    assert (np.diff(steps) <= 0.0).all()
    assert {state.position[0] for state in states} == {-0.5}


def test_a_plain_command_cancels_a_trajectory(tripod: Any, spin_until: Any) -> None:
    states = tripod.client.collect(JointState, "joint_states")
    joints = ["servo_0", "servo_1", "servo_2"]
    tripod.client.publish("joint_trajectory", trajectory(joints, [(0.2, [-0.4] * 3), (60.0, [-2.0] * 3)]))
    assert spin_until(lambda: states and states[-1].position[0] < -0.4)
    tripod.command([-0.2] * 3)
    assert reaches(states, [-0.2] * 3, spin_until)
    states.clear()
    assert spin_until(lambda: len(states) > 20)
    assert {state.position[0] for state in states} == {-0.2}


@pytest.mark.parametrize(
    ("message", "sentence"),
    [
        (trajectory(["servo_7"], [(1.0, [0.0])]), "unknown joint servo_7; known joints: servo_0"),
        (trajectory(["servo_0"], []), "it has no way points"),
        (trajectory(["servo_0"], [(1.0, [math.nan])]), "position nan of joint servo_0"),
        (trajectory(["servo_0"], [(1.0, [0.0]), (0.5, [0.0])]), "strictly increasing"),
        (trajectory(["servo_0"], [(1.0, [0.0, 1.0])]), "2 positions for 1 joints"),
    ],
)
def test_wrong_trajectories_are_refused(
    tripod: Any, spin_until: Any, message: JointTrajectory, sentence: str
) -> None:
    def refused() -> bool:
        tripod.client.publish("joint_trajectory", message)
        return sentence in tripod.process.output

    assert spin_until(refused)
    states = tripod.client.collect(JointState, "joint_states")
    tripod.command([-0.3] * 3)
    assert reaches(states, [-0.3] * 3, spin_until)
