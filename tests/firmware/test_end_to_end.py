"""From a topic, or a key, to pulse widths: bridge process, pseudo-terminal, firmware in the emulator.

What depends on time is shown on one clock in `test_driver_on_firmware` and `test_end_to_end_stop`.
"""

from __future__ import annotations

import re
import signal
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from bridge_session import BRIDGE, BridgeClient, Stream, bridge_words
from node_processes import NodeProcess
from terminal_session import TerminalSession

from servo_bridge.driver import byte_to_angle, byte_to_width
from servo_bridge.emulator import EmulatedBoardPty
from softsim_core.scene import ServoCalibration

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("emulator", "ros_domain")]

TOLERANCE_US = 1.5
SLEW_US = 61.5  # the firmware's limit, a frame
SERVO = ServoCalibration(joint="servo_0", zero_byte=179, byte_min=60, byte_max=180, rest_byte=150)
UP = [sys.executable, "-m", "softsim_ros.cli", "up", "tripod", "--no-viewer", "--board"]


@pytest.fixture
def far_end(tmp_path: Path) -> Iterator[EmulatedBoardPty]:
    with EmulatedBoardPty(link=tmp_path / "board") as board:
        yield board


def commands(*servo_bytes: int) -> Any:
    from std_msgs.msg import Float64MultiArray

    return Float64MultiArray(data=[byte_to_angle(each, SERVO) for each in servo_bytes])


def at(*servo_bytes: float) -> Callable[[EmulatedBoardPty], bool]:
    """Whether the newest pulses are those of the bytes."""
    wanted = [byte_to_width(each) for each in servo_bytes]

    def reached(board: EmulatedBoardPty) -> bool:
        widths = board.widths_us()
        return widths is not None and all(
            abs(seen - each) < TOLERANCE_US for seen, each in zip(widths, wanted, strict=True)
        )

    return reached


def fastest_step_us(board: EmulatedBoardPty) -> float:
    """Largest change of a width from one pulse of a pin to the next."""
    pins = [[each.width_us for each in board.pulses if each.channel == pin] for pin in range(3)]
    return max((abs(b - a) for widths in pins for a, b in pairwise(widths)), default=0.0)


def test_commands_reach_the_pins_also_after_the_board_was_unplugged(
    start: Callable[..., NodeProcess],
    far_end: EmulatedBoardPty,
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
) -> None:
    from std_msgs.msg import Float64MultiArray

    process = start(BRIDGE, *bridge_words(port=far_end.port, autostart="activate"))
    sent = stream(client.publisher(Float64MultiArray, "position_controller/commands"), commands(90, 120, 165))
    for pose in ((90, 120, 165), (165, 90, 120)):
        sent.message = commands(*pose)
        assert far_end.wait_for(at(*pose)), f"{pose}: {far_end.widths_us()} {process.output}"
    assert fastest_step_us(far_end) <= SLEW_US + 1.0
    far_end.unplug()
    far_end.clear()
    far_end.replug()  # a new port behind the same link
    assert far_end.wait_for(at(165, 90, 120)), f"{far_end.widths_us()} {process.output}"
    assert fastest_step_us(far_end) <= SLEW_US + 1.0
    assert far_end.open_count >= 2


def test_a_typed_key_becomes_a_pulse_which_the_teleop_shows(tmp_path: Path) -> None:
    with TerminalSession([*UP, "emulated"], environment={"XDG_RUNTIME_DIR": str(tmp_path)}) as terminal:
        terminal.wait_for("emulated board: pulses none yet")
        terminal.wait_for("servo bridge: no-comm")  # a key while it opens its port asks nothing of it
        for keys, width in ((b"ab", "150[56]"), (b"q", "177[12]")):  # start and mid pose
            terminal.type(keys)
            shown = re.compile(rf"pulses {width} {width} {width} \(us\)")
            assert terminal.wait_until(lambda shown=shown: bool(shown.search(terminal.screen))), terminal.text
        terminal.type(b"x")
        assert terminal.wait() == 0


def test_the_emulated_board_of_softsim_up_shows_its_pulses(tmp_path: Path) -> None:
    with TerminalSession(
        [*UP, "emulated", "--headless", "--send"],
        environment={"XDG_RUNTIME_DIR": str(tmp_path)},
        size=(160, 24),
    ) as terminal:
        terminal.wait_for("bridge active", "text")
        shown = re.compile(
            r"pulses 23\d\d 23\d\d 23\d\d µs"
        )  # the simulator stands at 0 rad, the servos near it
        assert terminal.wait_until(lambda: bool(shown.search(terminal.text))), terminal.text
        terminal.signal(signal.SIGINT)
        assert terminal.wait() == 0, terminal.text
        assert "pulses none yet" in terminal.text
        assert "Traceback" not in terminal.text
