"""Bridge and virtual board as nodes among others in one process, and the board's own process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bridge_session import spinning

pytest.importorskip("rclpy")

from rclpy.parameter import Parameter
from std_msgs.msg import UInt8MultiArray

from servo_bridge.driver import SerialTransport
from servo_bridge.emulator import VirtualBoard
from servo_bridge.nodes import ServoBridge
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import (
    BoardDescription,
    JointDescription,
    RobotDescription,
    SceneDescription,
    ServoCalibration,
)

ROBOT = RobotDescription(
    scene=SceneDescription(
        name="two",
        joints=tuple(JointDescription(name=name, limits=JointLimits(-2.0, 0.0, 3.5)) for name in "ab"),
    ),
    board=BoardDescription(servos=(ServoCalibration(joint="a"), ServoCalibration(joint="b"))),
)


@pytest.mark.slow
def test_close_reaches_the_safe_pose_while_the_executor_spins(client: Any, tmp_path: Path) -> None:
    with VirtualBoard(servos=2, link=tmp_path / "two") as board:
        overrides = {"port": board.port, "autostart": "activate", "open_wait_s": 0.0}
        bridge = ServoBridge(
            scene=ROBOT,
            context=client.context,
            namespace="two",
            parameter_overrides=[Parameter(name, value=value) for name, value in overrides.items()],
        )
        with spinning(bridge, client.context):
            assert board.wait_for(lambda b: b.accepted > 5)
            bridge._session.driver.motion.positions = (-1.5, -1.0)
            assert board.wait_for(lambda b: b.servo_bytes == (93, 121))
            bridge.close()
            assert board.wait_for(lambda b: not b.is_open)
            assert [packet.servo_bytes for packet in board.packets[-3:]] == [(150, 150)] * 3
            bridge.close()


@pytest.mark.slow
def test_the_board_runs_as_a_process_and_publishes_what_it_hears(
    start: Callable[..., Any], client: Any, tmp_path: Path, wait_until: Callable[..., bool]
) -> None:
    link = tmp_path / "board"
    arguments = ("--link", str(link), "--ros-args", "-r", "__ns:=/tripod")
    process = start("servo_bridge.nodes.virtual_board_node", *arguments)
    heard = client.collect(UInt8MultiArray, "virtual_board/servo_bytes")
    assert wait_until(link.is_symlink)
    assert wait_until(lambda: client.node.count_publishers("/tripod/virtual_board/servo_bytes") > 0)
    with SerialTransport(str(link)) as transport:

        def received() -> bool:
            transport.write(bytes([255, 93, 121, 134]))
            return bool(heard)

        assert wait_until(received)
    assert list(heard[-1].data) == [93, 121, 134]
    assert process.says("93° 121° 134°")
    assert process.output.startswith(str(link)) or str(link) in process.output
    assert process.end() == 0
    assert not link.is_symlink()
