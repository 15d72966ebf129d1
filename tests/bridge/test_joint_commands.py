"""The bridge alone under ros2_control: commands by name move the servos within the same limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy")
from sensor_msgs.msg import JointState
from topic_hardware import TopicHardware

from servo_bridge.driver import ServoDriver
from servo_bridge.emulator import VirtualBoard
from softsim_core import load_scene
from softsim_core.base import CommandError

JOINTS = ("servo_0", "servo_1", "servo_2")


@pytest.mark.ros
@pytest.mark.slow
def test_ros2_control_drives_the_servos(
    start_bridge: Callable[..., Any], client: Any, board: VirtualBoard, wait_until: Callable[..., bool]
) -> None:
    bridge = start_bridge(source="joint_commands", autostart="activate")
    applied = client.collect(JointState, "applied_joint_states")
    hardware = TopicHardware(client, JOINTS, "joint_commands", "applied_joint_states")
    try:
        assert board.wait_for(lambda b: b.servo_bytes == (150, 150, 150))
        assert wait_until(lambda: all(map(math.isfinite, hardware.states.values())))
        assert wait_until(lambda: applied)  # a second subscription, which may hear later
        assert applied[-1].header.frame_id == "tripod/base_link"
        hardware.commands = {"servo_0": -1.4965, "servo_1": math.nan, "servo_2": -9.0}
        assert board.wait_for(lambda b: b.servo_bytes == (93, 150, 63))
        hardware.commands["servo_1"] = -1.0
        assert board.wait_for(lambda b: b.servo_bytes == (93, 121, 63))
        steps = [
            abs(one - other)
            for before, after in zip(board.packets, board.packets[1:], strict=False)
            for one, other in zip(before.servo_bytes, after.servo_bytes, strict=True)
        ]
        assert max(steps) <= math.degrees(3.5) * 0.04 + 1.0  # the speed limit, two periods at most
        assert "refused" not in bridge.output
        stale = JointState(name=["servo_1"], position=[-0.1])
        stale.header.stamp.sec = 5
        client.publish("joint_commands", stale)
        assert bridge.says("joint_commands: joint command refused: it is stamped")
    finally:
        hardware.close()


def test_the_others_go_on_as_they_are_told_and_stand_where_commands_stopped() -> None:
    now = [0.0]
    driver = ServoDriver(load_scene("tripod"), clock=lambda: now[0])
    driver.motion.start(0.0)
    driver.command_some(["servo_1", "servo_0"], [-1.0, math.nan])
    driver.command_some(["servo_2"], [-1.2])
    rest = driver.motion.rest
    assert driver.motion.goal(0.1) == (rest[0], -1.0, -1.2)
    now[0] = 60.0  # the servos hold since long; what was told then does not count any more
    driver.command_some(["servo_0"], [-0.9])
    assert driver.motion.goal(60.0) == (-0.9, *driver.motion.positions[1:])
    assert driver.motion.positions == rest
    driver.command_some(["servo_0"], [math.nan])  # no command: nothing that keeps the servos going
    now[0] = 61.0
    assert driver.motion.goal(61.0) == rest


def test_unknown_joints_are_refused_and_counted() -> None:
    driver = ServoDriver(load_scene("tripod"))
    with pytest.raises(CommandError, match="unknown joints elbow; known joints: servo_0"):
        driver.command_some(["servo_0", "elbow"], [-1.0, -1.0])
    assert driver.counts.refused == 1
    assert driver.motion.command_age(0.0) is None
