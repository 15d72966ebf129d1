"""Inverse control of a robot without simulator: joints as the bridge applied them, bytes on the line."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("daqp")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from geometry_msgs.msg import PoseStamped  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402

from servo_bridge.emulator import VirtualBoard  # noqa: E402

START = [-1.4965] * 3
START_BYTES = (93, 93, 93)


def test_a_goal_moves_the_bytes_and_its_end_holds_them(
    start_process: Callable[..., Any], client: Any, spin_until: Callable[..., bool], tmp_path: Path
) -> None:
    with VirtualBoard(link=tmp_path / "board") as board:
        bridge = start_process(
            "servo_bridge.nodes.bridge_node", "--ros-args", "-p", f"port:={board.port}",
            "-p", "source:=commands", "-p", "autostart:=activate", "-p", "open_wait_s:=0.0",
        )  # fmt: skip
        controller = start_process("softsim_ros.nodes.inverse.inverse_node")
        assert controller.says("ready to control", 180.0), controller.output
        applied = client.collect(JointState, "applied_joint_states", 1)
        poses = client.collect(PoseStamped, "inverse_controller/model_pose", 1)

        def enable(enabled: bool) -> bool:
            request = SetBool.Request(data=enabled)
            return bool(client.call(SetBool, "inverse_controller/enable", request).success)

        assert enable(
            False
        )  # found: from here on an answer comes before the bridge takes the silence for an end

        def at_start() -> bool:
            client.publish("position_controller/commands", Float64MultiArray(data=START))
            return board.servo_bytes == START_BYTES

        assert spin_until(at_start), bridge.output
        assert spin_until(lambda: len(applied) > 0)
        assert spin_until(lambda: at_start() and enable(True))  # once it has heard of the joints
        assert spin_until(lambda: len(poses) > 2)
        # the model stands with its bases moved in, as the robot is mounted: 27.6 mm high
        assert abs(poses[-1].pose.position.z - 0.0276) < 1e-3
        assert all(abs(a - b) <= 1 for a, b in zip(board.servo_bytes, START_BYTES, strict=True))
        goal = PoseStamped(pose=poses[-1].pose)
        goal.header.frame_id = "world"
        goal.pose.position.z = 0.0336
        client.publish("effector_goal", goal)
        assert spin_until(lambda: abs(poses[-1].pose.position.z - 0.0336) < 0.1e-3)
        # the bytes of -1.3128 rad, where the simulated robot stands at this height
        assert spin_until(lambda: all(abs(byte - 103) <= 1 for byte in board.servo_bytes)), board.servo_bytes
        board.clear()
        assert controller.end() == 0
        told = [packet.servo_bytes for packet in board.packets]
        jumps = [abs(b - a) for one, other in pairwise(told) for a, b in zip(one, other, strict=True)]
        assert max(jumps) <= 2  # it holds, and where the end takes longer, the bridge goes slowly to rest
        assert min(min(each) for each in told) >= 102
        assert bridge.end() == 0
