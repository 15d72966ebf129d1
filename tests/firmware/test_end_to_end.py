"""From a topic, or a key, to pulse widths: bridge process, pseudo-terminal, firmware in the emulator."""

from __future__ import annotations

import random
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from bridge_session import BRIDGE, BridgeClient, Stream, bridge_words
from node_processes import NodeProcess
from terminal_session import REPOSITORY, TerminalSession

from servo_bridge.emulator import EmulatedBoardPty
from servo_bridge.servo import byte_to_angle, byte_to_width
from softsim_core.scene.board import ServoCalibration

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("emulator", "ros_domain")]

TOLERANCE_US = 1.5
SLEW_US = 61.5  # the firmware's limit, a frame
REST = (150, 150, 150)
SERVO = ServoCalibration(joint="servo_0", zero_byte=179, byte_min=60, byte_max=180, rest_byte=150)
WIDE = """extends: tripod.yaml
joints:
  - {name: servo_0, limits: &all {lower: -2.1, upper: 0.02, speed: 20.0, acceleration: 1000.0}}
  - {name: servo_1, limits: *all}
  - {name: servo_2, limits: *all}
"""


@pytest.fixture
def far_end(tmp_path: Path) -> Iterator[EmulatedBoardPty]:
    with EmulatedBoardPty(link=tmp_path / "board") as board:
        yield board


@pytest.fixture
def bridge(start: Callable[..., NodeProcess], far_end: EmulatedBoardPty) -> Callable[..., NodeProcess]:
    """Starts the bridge on the emulated board, sending at once; keywords are parameters."""

    def starter(**parameters: object) -> NodeProcess:
        values = {"port": far_end.port, "autostart": "activate"} | parameters
        return start(BRIDGE, *bridge_words(**values))

    return starter


def angles(*servo_bytes: float) -> list[float]:
    return [byte_to_angle(int(each), SERVO) for each in servo_bytes]


def commands(*servo_bytes: int) -> Any:
    from std_msgs.msg import Float64MultiArray

    return Float64MultiArray(data=angles(*servo_bytes))


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
    pulses = board.pulses
    steps = [
        abs(later.width_us - earlier.width_us)
        for channel in range(3)
        for earlier, later in pairwise(each for each in pulses if each.channel == channel)
    ]
    return max(steps, default=0.0)


def test_plain_commands_reach_every_width_on_every_pin(
    bridge: Callable[..., NodeProcess],
    far_end: EmulatedBoardPty,
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
    tmp_path: Path,
) -> None:
    from std_msgs.msg import Float64MultiArray

    robot = tmp_path / "wide.yaml"
    robot.write_text(WIDE.replace("tripod.yaml", str(REPOSITORY / "configs" / "robots" / "tripod.yaml")))
    bridge(robot=robot)
    publisher = client.publisher(Float64MultiArray, "position_controller/commands")
    sent = stream(publisher, commands(60, 100, 140))
    for first in range(60, 181):
        pose = (first, 60 + (first - 60 + 40) % 121, 60 + (first - 60 + 80) % 121)
        sent.message = commands(*pose)
        assert far_end.wait_for(at(*pose)), f"{pose}: {far_end.widths_us()}"
    assert far_end.open_count == 1
    assert fastest_step_us(far_end) <= SLEW_US + 1.0


def test_mirrored_joint_states_reach_the_pins(
    bridge: Callable[..., NodeProcess],
    far_end: EmulatedBoardPty,
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
) -> None:
    from sensor_msgs.msg import JointState

    bridge(source="joint_states")
    publisher = client.publisher(JointState, "joint_states")
    names = ["servo_2", "somebody_else", "servo_0", "servo_1"]  # by name, in whatever order
    one, two, three = angles(90, 120, 165)
    stream(publisher, JointState(name=names, position=[three, 0.3, one, two]))
    assert far_end.wait_for(at(90, 120, 165)), far_end.widths_us()


def test_nothing_is_written_while_a_board_may_be_starting(
    bridge: Callable[..., NodeProcess],
    far_end: EmulatedBoardPty,
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
) -> None:
    from std_msgs.msg import Float64MultiArray

    far_end.kill()  # a board that never speaks, as the tutorial's firmware does not
    bridge()
    assert far_end.wait_for(lambda board: board.open_count == 1)
    opened = time.monotonic()
    stream(client.publisher(Float64MultiArray, "position_controller/commands"), commands(90, 120, 165))
    assert far_end.wait_for(lambda board: board.received > 0)  # then it counts as a plain board
    assert time.monotonic() - opened > 1.8  # 2.5 s, seen from here


@pytest.mark.parametrize("variant", ["boot loader first", "plain firmware"])
def test_boards_that_need_the_quiet_time(
    bridge: Callable[..., NodeProcess],
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
    tmp_path: Path,
    variant: str,
) -> None:
    from firmware_build import build, build_boot_loader
    from std_msgs.msg import Float64MultiArray

    plain = variant == "plain firmware"
    firmware = build(tmp_path, "-DLEGACY_ONLY") if plain else None
    loader = None if plain else build_boot_loader(tmp_path)
    with EmulatedBoardPty(firmware, loader, tmp_path / "other") as board:
        process = bridge(port=board.port)
        assert board.wait_for(lambda each: each.open_count == 1)
        opened = time.monotonic()
        stream(client.publisher(Float64MultiArray, "position_controller/commands"), commands(90, 120, 165))
        assert board.wait_for(lambda each: each.received > 0), process.output
        quiet = time.monotonic() - opened  # 1.4 s of boot loader, or 2.5 s of silence
        assert quiet > (1.8 if plain else 1.0)
        assert board.wait_for(at(90, 120, 165)), f"{board.widths_us()} {process.output}"
        assert board.failure == ""


def test_a_killed_bridge_leaves_a_robot_that_holds_and_then_rests(
    bridge: Callable[..., NodeProcess],
    far_end: EmulatedBoardPty,
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
) -> None:
    from std_msgs.msg import Float64MultiArray

    process = bridge()
    publisher = client.publisher(Float64MultiArray, "position_controller/commands")
    stream(publisher, commands(90, 110, 120))
    assert far_end.wait_for(at(90, 110, 120))
    far_end.clear()
    killed = far_end.time_s  # packets may come for a while yet, where the machine is busy
    process.end(signal.SIGKILL)
    assert far_end.wait_for(at(*REST))
    arrived = far_end.time_s
    pulses = far_end.pulses
    for channel, held in enumerate((90, 110, 120)):
        mine = [each for each in pulses if each.channel == channel]
        still = [each for each in mine if each.start_s < killed + 1.9]
        assert all(abs(each.width_us - byte_to_width(held)) < TOLERANCE_US for each in still)
        creep = [abs(later.width_us - earlier.width_us) for earlier, later in pairwise(mine)]
        assert max(creep) < 12.0  # 10 us per frame: 48 degrees a second
    assert 2.0 < arrived - killed < 5.0


def test_a_second_opener_is_refused_and_disturbs_nothing(
    bridge: Callable[..., NodeProcess],
    far_end: EmulatedBoardPty,
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
) -> None:
    from std_msgs.msg import Float64MultiArray

    bridge()
    publisher = client.publisher(Float64MultiArray, "position_controller/commands")
    stream(publisher, commands(90, 120, 165))
    assert far_end.wait_for(at(90, 120, 165))
    far_end.clear()
    second = bridge(source="joint_states")
    assert second.says("in use by another program"), second.output
    assert far_end.wait_for(at(90, 120, 165))
    assert fastest_step_us(far_end) < TOLERANCE_US  # what was left of the way there


def test_unplugged_at_any_time_it_comes_back_slowly(
    bridge: Callable[..., NodeProcess],
    far_end: EmulatedBoardPty,
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
) -> None:
    from std_msgs.msg import Float64MultiArray

    process = bridge()
    publisher = client.publisher(Float64MultiArray, "position_controller/commands")
    stream(publisher, commands(90, 120, 165))
    phases = {  # from when the board has said its number: one lost before is not opened again
        "ramp": lambda board: (board.widths_us() or (9999.0,))[0] < byte_to_width(140),
        "streaming": at(90, 120, 165),
    }
    for phase, reached in phases.items():
        assert far_end.wait_for(reached), f"{phase}: {far_end.widths_us()} {process.output}"
        assert fastest_step_us(far_end) <= SLEW_US + 1.0
        far_end.unplug()
        far_end.clear()
        far_end.replug()  # a new port behind the same link
    assert far_end.wait_for(at(90, 120, 165)), f"{far_end.widths_us()} {process.output}"
    assert fastest_step_us(far_end) <= SLEW_US + 1.0
    assert far_end.open_count >= 3


class NoisyLine:
    """Turns every bit over with a probability; counts the bits that it did."""

    def __init__(self, rate: float) -> None:
        self.flipped = 0
        self._rate, self._random = rate, random.Random(8)

    def __call__(self, data: bytes) -> bytes:
        return bytes(map(self._pass, data))

    def _pass(self, value: int) -> int:
        mask = sum((self._random.random() < self._rate) << bit for bit in range(8))
        self.flipped += mask.bit_count()
        return value ^ mask


def test_a_noisy_line_never_makes_a_servo_fast(
    bridge: Callable[..., NodeProcess],
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
    tmp_path: Path,
) -> None:
    from std_msgs.msg import Float64MultiArray

    noise = NoisyLine(1e-3)
    with EmulatedBoardPty(link=tmp_path / "noisy", line=noise) as board:
        process = bridge(port=board.port)
        publisher = client.publisher(Float64MultiArray, "position_controller/commands")
        sent = stream(publisher, commands(90, 120, 165))
        for pose in [(90, 120, 165), (165, 90, 120), (120, 165, 90)] * 2:
            sent.message = commands(*pose)
            before = noise.flipped
            assert board.wait_for(at(*pose)), f"{pose}: {board.widths_us()} {process.output}"
            assert board.wait_for(lambda _, before=before: noise.flipped > before + 3)
        assert fastest_step_us(board) <= SLEW_US + 1.0
        assert min(pulse.width_us for pulse in board.pulses) > byte_to_width(60) - TOLERANCE_US
        assert board.failure == ""


def test_a_typed_key_becomes_a_pulse(far_end: EmulatedBoardPty, tmp_path: Path) -> None:
    up = [sys.executable, "-m", "softsim_ros.cli", "up", "tripod", "--no-viewer", "--board", far_end.port]
    with TerminalSession(up, environment={"XDG_RUNTIME_DIR": str(tmp_path)}) as terminal:
        assert terminal.wait_until(lambda: "no-comm" in terminal.screen), terminal.text
        assert far_end.widths_us() is None  # no pulse before key B
        terminal.type(b"a")
        terminal.wait_for("start pose")
        terminal.type(b"b")
        start = 179 - 85.743  # the key's angle is between two bytes: 93 in a packet, exact in a frame
        assert far_end.wait_for(near(93, start)), f"{far_end.widths_us()} {terminal.screen}"
        terminal.type(b"q")
        assert far_end.wait_for(near(119, 179 - 59.970)), f"{far_end.widths_us()} {terminal.screen}"
        terminal.type(b"x")
        assert terminal.wait() == 0
        last = [each.width_us for each in far_end.pulses[-3:]]
        assert last == pytest.approx([byte_to_width(each) for each in REST], abs=TOLERANCE_US)


def near(whole: int, exact: float) -> Callable[[EmulatedBoardPty], bool]:
    """Whether all three pins show a whole byte's width, or the exact angle's."""
    return lambda board: at(whole, whole, whole)(board) or at(exact, exact, exact)(board)


def test_the_emulated_board_of_softsim_up_shows_its_pulses(tmp_path: Path) -> None:
    up = [
        sys.executable,
        "-m",
        "softsim_ros.cli",
        "up",
        "tripod",
        "--no-viewer",
        "--board",
        "emulated",
        "--headless",
    ]
    with TerminalSession(
        [*up, "--send"], environment={"XDG_RUNTIME_DIR": str(tmp_path)}, size=(160, 24)
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


def test_the_teleop_shows_the_pulses_of_the_emulated_board(tmp_path: Path) -> None:
    up = [sys.executable, "-m", "softsim_ros.cli", "up", "tripod", "--no-viewer", "--board", "emulated"]
    with TerminalSession(up, environment={"XDG_RUNTIME_DIR": str(tmp_path)}) as terminal:
        terminal.wait_for("emulated board: pulses none yet")
        terminal.wait_for("servo bridge: no-comm")  # a key while it opens its port asks nothing of it
        terminal.type(b"b")
        shown = re.compile(r"pulses 23\d\d 23\d\d 23\d\d \(us\)")
        assert terminal.wait_until(lambda: bool(shown.search(terminal.screen))), terminal.text
        terminal.type(b"x")
        assert terminal.wait() == 0
