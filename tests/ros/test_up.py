"""`softsim up` as a person runs it: keys in a terminal, bytes at the far end of the line, clean ends."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from terminal_session import REPOSITORY, TerminalSession
from waiting import BUILD_S, DEADLINE_S, spin_until

pytest.importorskip("rclpy")

from servo_bridge.emulator import VirtualBoard
from softsim_ros.cli import run_command as main
from softsim_ros.keys import REPEAT_INTERVAL_S

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("ros_domain")]

UP = [sys.executable, "-m", "softsim_ros.cli", "up", "tripod", "--no-viewer"]
START, MID, HIGH = (93, 93, 93), (119, 119, 119), (134, 134, 134)  # keys A, Q, Z
GOAL_Z = 27.6  # mm, height of the effector in the start pose


@pytest.fixture(autouse=True)
def own_runtime_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def wait_until(condition: Callable[[], object], what: Callable[[], str], seconds: float = BUILD_S) -> None:
    """Wait for a condition; where it does not come, show what was seen last."""
    assert spin_until(condition, seconds), f"never came; last seen:\n{what()}"


class Background:
    """`softsim up` without a terminal; what it writes is kept."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.file = folder / "up.txt"
        with self.file.open("wb") as output:
            self.process = subprocess.Popen(
                [*UP, *arguments],
                cwd=REPOSITORY,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONPATH": str(REPOSITORY), "PYTHONUNBUFFERED": "1"},
                start_new_session=True,
            )

    @property
    def text(self) -> str:
        return self.file.read_text()

    def wait_for(self, wanted: str) -> None:
        wait_until(
            lambda: wanted in self.text or self.process.poll() is not None,
            lambda: f"{wanted!r} in\n{self.text}",
        )
        assert wanted in self.text, self.text

    def end(self, number: signal.Signals) -> int:
        self.process.send_signal(number)
        return self.process.wait(DEADLINE_S)


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Background]]:
    started: list[Background] = []

    def starter(*arguments: str) -> Background:
        folder = tmp_path / str(len(started))
        folder.mkdir()
        started.append(Background(folder, *arguments))
        return started[-1]

    yield starter
    for up in started:
        if up.process.poll() is None:
            up.process.kill()
            up.process.wait()


def test_typed_keys_become_the_bytes_of_the_table(tmp_path: Path) -> None:
    with (
        VirtualBoard(link=tmp_path / "board") as board,
        TerminalSession([*UP, "--board", board.port]) as terminal,
    ):
        wait_until(lambda: "no-comm" in terminal.screen, lambda: terminal.text)
        assert board.servo_bytes is None  # nothing is sent before key B
        terminal.type(b"a")
        terminal.wait_for("start pose")
        terminal.type(b"b")
        wait_until(lambda: board.servo_bytes == START, lambda: f"{board.servo_bytes} {terminal.screen}")
        terminal.type(b"q")
        wait_until(lambda: board.servo_bytes == MID, lambda: f"{board.servo_bytes} {terminal.screen}")
        terminal.type(b"\x1a")  # Ctrl+Z is a key, too
        wait_until(lambda: board.servo_bytes == HIGH, lambda: f"{board.servo_bytes} {terminal.screen}")
        terminal.type(b"x")
        assert terminal.wait() == 0
        assert terminal.modes == terminal.modes_before
        assert board.servo_bytes == (150, 150, 150)  # the rest pose
        assert "Traceback" not in terminal.text


def ends_in_order(up: Background, number: signal.Signals) -> None:
    assert up.end(number) == 0
    assert "Traceback" not in up.text
    assert "tripod: ended" in up.text


def test_a_second_one_is_refused_may_take_another_name_and_a_killed_one_leaves_its_name_free(
    start: Callable[..., Background],
) -> None:
    first = start("--send")
    first.wait_for("bridge active")
    second = start()
    assert second.process.wait(DEADLINE_S) == 1
    assert re.search(
        rf"/tripod is up already \(process {first.process.pid}\).*--namespace tripod_2", second.text
    )
    other = start("--namespace", "tripod_2")
    other.wait_for("/tripod_2  running  bridge inactive")
    other.end(signal.SIGKILL)
    again = start("--namespace", "tripod_2", "--no-bridge")
    again.wait_for("running")
    ends_in_order(again, signal.SIGINT)
    ends_in_order(first, signal.SIGTERM)


def test_an_unknown_robot_is_one_sentence(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["up", "tripod", "--no-viewer", "--mesh", "nonsense"]) == 1
    written = "".join(capfd.readouterr())
    assert "tripod_nonsense" in written
    assert "known: " in written or "did you mean tripod" in written
    assert "Traceback" not in written


def test_a_missing_port_says_what_to_do_and_the_simulation_runs(start: Callable[..., Background]) -> None:
    up = start("--board", "/dev/there_is_no_such_port")
    up.wait_for("/dev/there_is_no_such_port")
    up.wait_for("running  bridge unconfigured")
    assert up.end(signal.SIGINT) == 0
    assert "Traceback" not in up.text


def test_inverse_control_moves_the_bytes_with_the_goal(tmp_path: Path) -> None:
    pytest.importorskip("daqp")
    with (
        VirtualBoard(link=tmp_path / "board") as board,
        TerminalSession([*UP, "--inverse", "--board", board.port], size=(120, 30)) as terminal,
    ):
        wait_until(lambda: "no-comm" in terminal.screen, lambda: terminal.text)
        terminal.type(b"a")
        terminal.wait_for("start pose")
        terminal.type(b"b")
        wait_until(lambda: board.servo_bytes == START, lambda: f"{board.servo_bytes} {terminal.screen}")
        terminal.type(b"i")
        wait_until(lambda: "inverse control: on" in terminal.screen, lambda: terminal.screen)
        assert board.servo_bytes == START  # switching on moves nothing
        for step in range(1, 4):
            terminal.type(b"+")  # one step of 2 mm each
            height = f"z {GOAL_Z + 2.0 * step:.1f}"
            wait_until(
                lambda height=height: re.search(rf"effector: .*{height} +off by 0\.[01]\d", terminal.screen),
                lambda: terminal.screen,
            )
            seen = time.monotonic()  # sooner than this again, the key would count as held and be slowed down
            wait_until(lambda seen=seen: time.monotonic() > seen + REPEAT_INTERVAL_S, lambda: terminal.screen)
        assert board.servo_bytes is not None
        assert min(board.servo_bytes) > START[0]  # all three arms up
        terminal.type(b"q")
        wait_until(lambda: "inverse control drives the joints" in terminal.screen, lambda: terminal.screen)
        terminal.type(b"r")  # switches it off before the reset
        wait_until(lambda: "back at the start of the scene" in terminal.screen, lambda: terminal.screen)
        assert "inverse control: on" not in terminal.screen
        terminal.type(b"q")
        wait_until(lambda: board.servo_bytes == MID, lambda: f"{board.servo_bytes} {terminal.screen}")
        terminal.type(b"\x03")  # Ctrl+C
        assert terminal.wait() == 0
        assert terminal.modes == terminal.modes_before
        assert "Traceback" not in terminal.text
