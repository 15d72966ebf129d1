"""Joint states, poses, transforms, clock and diagnostics from plain numbers."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from diagnostics import diagnostic_values  # noqa: E402

from softsim_ros import messages  # noqa: E402
from softsim_ros.messages import OK, diagnostic_array  # noqa: E402


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [(0.0, (0, 0)), (1.25, (1, 250_000_000)), (0.01 * 3, (0, 30_000_000)), (1.9999999999, (2, 0))],
)
def test_times_are_rounded_to_the_nearest_nanosecond(seconds: float, expected: tuple[int, int]) -> None:
    time = messages.time_message(seconds)
    assert (time.sec, time.nanosec) == expected
    assert messages.clock(seconds).clock == time


def test_a_joint_state_carries_its_arrays_bit_for_bit() -> None:
    rng = np.random.default_rng(1)
    positions, velocities, efforts = rng.normal(size=(3, 4))
    names = ["a", "b", "c", "d"]
    stamp = messages.time_message(2.5)
    message = messages.joint_state(stamp, "base", names, positions, velocities, efforts)
    assert message.name == names
    assert (message.header.stamp, message.header.frame_id) == (stamp, "base")
    for field, values in (("position", positions), ("velocity", velocities), ("effort", efforts)):
        np.testing.assert_array_equal(np.asarray(getattr(message, field)), values)


def test_arrays_that_are_not_contiguous_are_taken_row_by_row() -> None:
    columns = np.arange(12.0).reshape(3, 4)[:, ::2]
    assert messages.message_array(columns, "d").tolist() == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert messages.message_array([1, 2], "f").tolist() == [1.0, 2.0]
    assert messages.message_array(np.array([258], ">u2"), "B").tolist() == [1, 2]


def test_poses_and_transforms_keep_position_and_quaternion() -> None:
    position, quaternion = np.array([0.1, -0.2, 0.3]), np.array([0.5, -0.5, 0.5, 0.5])
    stamp = messages.time_message(1.0)
    pose = messages.pose_stamped(stamp, "world", position, quaternion)
    assert pose.header.frame_id == "world"
    assert (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == (0.1, -0.2, 0.3)
    turn = pose.pose.orientation
    assert (turn.x, turn.y, turn.z, turn.w) == (0.5, -0.5, 0.5, 0.5)
    transform = messages.transform_stamped(stamp, "base", "horn", position, quaternion)
    assert (transform.header.frame_id, transform.child_frame_id) == ("base", "horn")
    assert transform.transform.translation.y == -0.2
    assert transform.transform.rotation.w == 0.5


def test_diagnostics_read_back_by_name() -> None:
    stamp = messages.time_message(1.0)
    message = diagnostic_array(
        stamp, "tripod/simulator", "tripod", OK, "running", {"steps": 3, "ms": 0.12345678}
    )
    assert message.status[0].level == OK
    assert diagnostic_values(message, "tripod/simulator") == {"steps": "3", "ms": "0.123457"}
    assert diagnostic_values(message, "another") == {}
