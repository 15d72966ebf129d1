"""Wall time at 50 Hz through bridge process, pseudo-terminal and firmware (SOFTSIM_SOAK_S)."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from bridge_session import BRIDGE, BridgeClient, Stream, bridge_words
from node_processes import NodeProcess

from servo_bridge.emulator import EmulatedBoardPty
from servo_bridge.servo import byte_to_angle
from softsim_core import load_scene
from softsim_ros.benchmark.process import resident_mb

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("emulator")]

SECONDS = float(os.environ.get("SOFTSIM_SOAK_S", "20"))
WARM_S = 5.0


def numbers(messages: list[Any]) -> dict[str, str]:
    """What the newest diagnostics of the bridge say."""
    own = [status for message in messages for status in message.status if "servo board" in status.name]
    return {entry.key: entry.value for entry in own[-1].values}


def test_nothing_is_lost_and_nothing_grows(
    tmp_path: Path, client: BridgeClient, start: Callable[..., NodeProcess]
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import Float64MultiArray

    scene = load_scene("tripod")
    assert scene.board is not None
    poses = [[byte_to_angle(each, servo) for servo in scene.board.servos] for each in (90, 160)]
    with EmulatedBoardPty(link=tmp_path / "board") as board:
        process = start(BRIDGE, *bridge_words(port=board.port, autostart="activate"))
        try:
            diagnostics = client.collect(DiagnosticArray, "/diagnostics")
            publisher = client.publisher(Float64MultiArray, "position_controller/commands")
            stream = Stream(publisher, Float64MultiArray(data=poses[0]))

            def drive(seconds: float) -> None:
                """To and fro, a second each way."""
                end = time.monotonic() + seconds
                while time.monotonic() < end:
                    stream.message = Float64MultiArray(data=poses[int(time.monotonic()) % 2])
                    assert not board.wait_for(lambda each: bool(each.failure), 0.1)

            drive(WARM_S)
            memory = resident_mb(process.process.pid)
            drive(SECONDS - WARM_S)
            grown = resident_mb(process.process.pid) - memory
            seen = len(diagnostics)
            assert board.wait_for(lambda _: len(diagnostics) > seen)
            stream.stop()
            said = numbers(diagnostics)
            assert process.end() == 0, process.output
        finally:
            process.process.kill()
        assert board.open_count == 1
        starts = [pulse.start_s for pulse in board.pulses if pulse.channel == 0]
    gaps = [later - earlier for earlier, later in pairwise(starts)]
    assert len(gaps) > 45 * SECONDS
    assert max(gaps) < 0.0205  # a pulse in every frame: no reset, no hang
    assert grown < 1.0
    for none in ("reconnects", "commands refused", "board rejects", "board overruns", "telemetry damaged"):
        assert said[none] == "0", said
    assert said["board starts"] == "1"
    assert int(said["most unacknowledged"]) < 16, said  # of 64 numbers: none was lost, at most late
    assert int(said["packets sent"]) > 48 * (SECONDS - WARM_S)
    assert "Traceback" not in process.output
