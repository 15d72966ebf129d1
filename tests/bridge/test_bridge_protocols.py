"""The bridge across processes with boards that talk back: telemetry, loss and return, IMU, calibration."""

from __future__ import annotations

import io
import math
import os
import select
import sys
import threading
import tty
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64MultiArray

from servo_bridge.driver import load_calibration, save_calibration
from servo_bridge.emulator import VirtualBoard
from softsim_core.scene import load_scene
from softsim_ros.cli import main as softsim

REPOSITORY = Path(__file__).resolve().parents[2]
COMMANDS = "position_controller/commands"
Starter = Callable[..., Any]


@pytest.fixture
def board(tmp_path: Path) -> Iterator[VirtualBoard]:
    with VirtualBoard(link=tmp_path / "board", protocol="extended") as virtual:
        yield virtual


def command(*values: float) -> Float64MultiArray:
    return Float64MultiArray(data=list(values))


def values(diagnostics: list[DiagnosticArray]) -> dict[str, str]:
    """Key-value pairs of the newest status of the bridge."""
    found = [status for message in diagnostics for status in message.status if "servo_bridge" in status.name]
    return {pair.key: pair.value for pair in found[-1].values} if found else {}


@pytest.mark.slow
def test_an_extended_board_is_found_driven_and_reported(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter, wait_until: Starter
) -> None:
    bridge = start_bridge(autostart="activate", open_wait_s=60.0)  # its banner ends the quiet time
    diagnostics = client.collect(DiagnosticArray, "/diagnostics")
    stream(client.publisher(Float64MultiArray, COMMANDS), command(-1.4965, -1.0, -0.785))
    assert board.wait_for(lambda b: b.servo_bytes == (93, 122, 134))
    assert board.dropped == 0
    assert wait_until(lambda: values(diagnostics).get("pulse widths [us]") == "1506 1799 1926")
    report = values(diagnostics)
    assert (report["link"], report["reset cause"]) == ("extended", "external (port opened, or button)")
    assert report["board flags"] == "link active limits_set"
    assert (report["board rejects"], report["board overruns"], report["telemetry damaged"]) == ("0", "0", "0")
    assert {"most unacknowledged", "telemetry age [s]", "send period [ms]"} <= set(report)
    bridge.end()
    assert board.model.motion.relaxed  # after the rest pose


@pytest.mark.slow
def test_a_board_that_falls_silent_is_opened_again_and_the_pose_taken_up(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter, wait_until: Starter
) -> None:
    bridge = start_bridge(autostart="activate", open_wait_s=60.0)
    stream(client.publisher(Float64MultiArray, COMMANDS), command(-2.0, -2.0, -2.0))
    assert board.wait_for(lambda b: b.servo_bytes == (64, 64, 64))
    board.model.silent = True
    assert bridge.says("no telemetry from the board")
    assert board.wait_for(lambda b: not b.is_open)
    board.clear()
    board.model.silent = False
    assert board.wait_for(lambda b: b.is_open)
    assert board.wait_for(lambda b: len(b.packets) > 5)
    assert {packet.servo_bytes for packet in board.packets} == {(64, 64, 64)}
    assert client.reaches("active")


@pytest.mark.slow
def test_a_board_that_hears_nothing_is_an_error_although_its_telemetry_lives(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter, wait_until: Starter
) -> None:
    bridge = start_bridge(autostart="activate", open_wait_s=60.0)
    diagnostics = client.collect(DiagnosticArray, "/diagnostics")
    stream(client.publisher(Float64MultiArray, COMMANDS), command(-2.0, -2.0, -2.0))
    assert board.wait_for(lambda b: b.servo_bytes == (64, 64, 64))
    board.model.deaf = True

    def newest() -> DiagnosticStatus | None:
        found = [each for item in diagnostics for each in item.status if "servo_bridge" in each.name]
        return found[-1] if found else None

    def wrong() -> bool:
        status = newest()
        return (
            status is not None and status.level == DiagnosticStatus.ERROR and "requesting" in status.message
        )

    assert wait_until(wrong)
    assert bridge.says("the bridge continues from the board's pose")
    assert wait_until(lambda: (board.widths_us or (0.0,))[0] > 2000.0)  # it went to rest by itself
    board.model.deaf = False
    board.clear()
    assert board.wait_for(lambda b: len(b.packets) > 0)
    assert board.packets[0].servo_bytes[0] > 140  # from there, not where it was sent before
    assert board.wait_for(lambda b: b.servo_bytes == (64, 64, 64))
    assert wait_until(lambda: not wrong())
    assert board.open_count == 1


@pytest.mark.slow
def test_a_demanded_protocol_that_is_absent_is_a_sentence(
    start_bridge: Starter, client: Any, tmp_path: Path
) -> None:
    with VirtualBoard(link=tmp_path / "plain") as plain:
        bridge = start_bridge(port=plain.port, protocol="extended", open_wait_s=0.0)
        client.transition("configure")
        assert bridge.says("no board of the extended protocol answered")
        assert plain.received == 0


class ImuBoard:
    """A board of the text protocol on a pseudo-terminal: some text first, then a line for every line."""

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._slave = slave
        self.port = os.ttyname(slave)
        self.lines: list[bytes] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        os.write(self._master, b"ntation Sensor Test\r\n\r\nCalibrated, all well\r\n")
        rest = b""
        while not self._stop.is_set():
            if select.select([self._master], [], [], 0.05)[0]:
                *lines, rest = (rest + os.read(self._master, 4096)).split(b"\n")
                self.lines += lines
                os.write(self._master, b"10.0000,-20.0000,\r\n" * len(lines))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)


@pytest.mark.slow
def test_an_imu_board_takes_text_and_its_tilts_are_published(
    start_bridge: Starter, client: Any, stream: Starter, wait_until: Starter
) -> None:
    imu_board = ImuBoard()
    try:
        start_bridge(port=imu_board.port, protocol="ascii_imu", autostart="activate")
        messages = client.collect(Imu, "imu")
        diagnostics = client.collect(DiagnosticArray, "/diagnostics")
        stream(client.publisher(Float64MultiArray, COMMANDS), command(-1.4965, -1.0, -0.785))
        assert wait_until(lambda: b"93 121 134" in imu_board.lines)
        assert imu_board.lines[0] == b"150 150 150"
        assert wait_until(lambda: bool(messages))
        message = messages[-1]
        assert message.header.frame_id == "tripod/effector"
        q = message.orientation
        up = (2 * (q.x * q.z - q.w * q.y), 2 * (q.y * q.z + q.w * q.x), 1 - 2 * (q.x**2 + q.y**2))
        assert math.degrees(math.asin(up[1])) == pytest.approx(-20.0)  # about x: the second number
        assert math.degrees(math.atan2(-up[0], up[2])) == pytest.approx(10.0)
        assert message.orientation_covariance[0] > 0.0
        assert message.angular_velocity_covariance[0] == message.linear_acceleration_covariance[0] == -1.0
        assert wait_until(lambda: int(values(diagnostics).get("imu readings", "0")) > 10)
        assert values(diagnostics)["link"] == "ascii_imu"
    finally:
        imu_board.close()


@pytest.mark.slow
def test_the_calibration_of_the_person_is_used_unasked(
    start_bridge: Starter, client: Any, board: VirtualBoard, tmp_path: Path, wait_until: Starter
) -> None:
    robot = load_scene("tripod")
    assert robot.board is not None
    file = Path(os.environ["XDG_CONFIG_HOME"]) / "softsim" / "servos" / "tripod.yaml"
    first, *others = robot.board.servos
    save_calibration(file, "tripod", [replace(first, rest_byte=140), *others])
    bridge = start_bridge(autostart="activate", protocol="legacy")
    assert board.wait_for(lambda b: b.servo_bytes == (140, 150, 150))
    assert bridge.says(f"calibration {file}")


@pytest.mark.slow
def test_calibrate_servos_walks_in_a_terminal_and_writes_the_file(
    board: VirtualBoard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the process of its board: a computer that stops for seconds stops both."""
    output = tmp_path / "tripod.yaml"
    words = ["calibrate-servos", "tripod", "--port", board.port, "--output", str(output)]
    answers = ["", "y", "+", "", "", ""] + ["y", "", "", ""] * 2 + ["y"]
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(answers) + "\n"))
    code = softsim(words)
    said = capsys.readouterr()
    assert code == 0, said
    robot = load_scene("tripod")
    assert robot.board is not None
    servos = load_calibration(output, "tripod", robot.board.servos)
    assert [servo.trim_deg for servo in servos] == pytest.approx([1.0, 0.0, 0.0])
    assert "servo_0: sign +1, zero 179, trim +1 deg" in said.out
    assert "hands off" in said.out.splitlines()[0]
    assert board.wait_for(lambda b: not b.is_open)
    assert board.model.motion.relaxed


@pytest.mark.slow
def test_a_protocol_that_the_robot_s_own_file_registers_is_found_and_driven(
    start_bridge: Starter, tmp_path: Path
) -> None:
    file = REPOSITORY / "examples" / "my_board.py"
    load_scene(file)  # registers it here, for the virtual board
    with VirtualBoard(2, tmp_path / "mine", protocol="my_board") as board:
        start_bridge(robot=str(file), port=board.port, autostart="activate", open_wait_s=60.0)
        assert board.wait_for(lambda b: b.servo_bytes == (150, 150))
        assert board.dropped == 0


@pytest.mark.slow
def test_an_unknown_protocol_leaves_the_bridge_unconfigured_with_a_sentence(
    start_bridge: Starter, client: Any, board: VirtualBoard
) -> None:
    bridge = start_bridge(protocol="morse")
    assert client.refuses("configure")
    assert bridge.says(
        "no board protocol is named 'morse'; known: auto, ascii_imu, dynamixel, extended, legacy"
    )
    assert board.received == 0
