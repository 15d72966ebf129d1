"""A board under another number is found by its name in /dev/serial/by-id, and driven on; no other is."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from bridge_session import BridgeClient
from diagnostic_msgs.msg import DiagnosticArray
from node_processes import spin_until
from rclpy.parameter import Parameter

from servo_bridge.driver import board_session, byte_to_width, stable_name
from servo_bridge.emulator import EmulatedBoardPty, VirtualBoard, make_link
from servo_bridge.nodes import bridge_node
from softsim_ros import SpinThread

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("emulator")]

REST_US = byte_to_width(150)
DEADLINE_S = 60.0


def rests(board: EmulatedBoardPty) -> bool:
    widths = board.widths_us()
    return widths is not None and all(abs(width - REST_US) < 1.5 for width in widths)


def test_replugged_under_another_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, client: BridgeClient
) -> None:
    by_id, number = tmp_path / "by-id", tmp_path / "ttyACM0"
    by_id.mkdir()
    name = by_id / "usb-Arduino_Uno_tripod-if00"
    monkeypatch.setattr(board_session, "stable_name", partial(stable_name, by_id=by_id))
    with EmulatedBoardPty() as board, VirtualBoard() as stranger, EmulatedBoardPty() as another:
        for link in (name, number):
            make_link(link, board.port)
        diagnostics = client.collect(DiagnosticArray, "/diagnostics")
        overrides = {"port": str(number), "autostart": "activate", "source": "commands"}
        bridge = bridge_node.ServoBridge(
            context=client.context,
            namespace="tripod",
            parameter_overrides=[Parameter(key, value=value) for key, value in overrides.items()],
        )
        try:
            with SpinThread([bridge], client.context):
                assert board.wait_for(rests, DEADLINE_S), board.widths_us()
                name.unlink()
                make_link(number, stranger.port)
                board.unplug()
                refused = f"{name} is not plugged in, and {number} may be another device by now"
                assert spin_until(lambda: any(refused in each.status[0].message for each in diagnostics))
                make_link(name, another.port)
                refused = f"another board is on {name}"
                assert spin_until(lambda: any(refused in each.status[0].message for each in diagnostics))
                board.replug()
                make_link(name, board.port)
                assert board.wait_for(rests, DEADLINE_S), board.widths_us()
                assert (board.open_count, stranger.open_count) == (2, 0)
                assert another.widths_us() is None
                bridge.close()
        finally:
            bridge.destroy_node()
