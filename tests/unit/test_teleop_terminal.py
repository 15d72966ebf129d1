"""The terminal is raw while in use and always given back, whatever ends the program."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import termios

import pytest
from terminal_session import REPOSITORY, TerminalSession
from waiting import DEADLINE_S

USES_TERMINAL = """
import os, sys
from softsim_ros.nodes.teleop.terminal import NoTerminalError, RawTerminal
try:
    with RawTerminal() as terminal:
        terminal.write(f"ready {terminal.size}\\r\\n")
        while True:
            if terminal.wait(0.05):
                data = terminal.read()
                if data is None or data == b"x":
                    break
                if data == b"e":
                    raise RuntimeError("on purpose")
                terminal.write(f"got {data.hex()}\\r\\n")
            if terminal.take_redraw():
                terminal.write("redraw\\r\\n")
except NoTerminalError as error:
    sys.exit(str(error))
print("left")
"""

HOLDS_OUTPUT = """
import os, sys
from softsim_ros.nodes.teleop.terminal import DeferredOutput
from softsim_ros.nodes.teleop.terminal import RawTerminal
with DeferredOutput(), RawTerminal() as terminal:
    print("held line")
    sys.stdout.flush()
    os.system("echo from a child >&2")
    terminal.write("shown\\n")
    terminal.wait(60.0)
print("after")
"""


def python(code: str, **streams: object) -> TerminalSession:
    return TerminalSession([sys.executable, "-c", code], **streams)


@pytest.mark.parametrize(("key", "code"), [(b"x", 0), (b"e", 1)])
def test_modes_come_back(key: bytes, code: int) -> None:
    with python(USES_TERMINAL) as session:
        session.wait_for("ready (80, 24)", "text")
        raw = session.modes
        assert not raw[3] & (termios.ISIG | termios.ICANON | termios.ECHO)
        assert not raw[0] & (termios.IXON | termios.ICRNL)
        session.type(key)
        assert session.wait() == code
        assert session.modes == session.modes_before
        entered, left = session.output.index("\x1b[>1u"), session.output.index("\x1b[<u")
        for on, off in (("?1049h", "?1049l"), ("?25l", "?25h"), ("?2004h", "?2004l"), (">4;1m", ">4m")):
            assert session.output.count(f"\x1b[{on}") == session.output.count(f"\x1b[{off}") == 1
            assert session.output.index(f"\x1b[{on}") < session.output.index(f"\x1b[{off}")
        assert entered < left


def test_keys_that_a_cooked_terminal_eats_are_bytes() -> None:
    with python(USES_TERMINAL) as session:
        session.wait_for("ready", "text")
        for key in (b"\x03", b"\x11", b"\x13", b"\x1a", b"\x1c", b"\r"):
            session.type(key)
            session.wait_for(f"got {key.hex()}", "text")
        session.type(b"x")
        assert session.wait() == 0


def test_after_a_stop_the_terminal_is_taken_again() -> None:
    with python(USES_TERMINAL) as session:
        session.wait_for("redraw", "text")
        session.signal(signal.SIGTSTP)
        session.wait_for("\x1b[?1049l", "output")
        assert session.modes == session.modes_before
        session.output = ""  # the program stands still now
        session.signal(signal.SIGCONT)
        session.wait_for("redraw", "text")
        assert not session.modes[3] & termios.ICANON
        session.type(b"x")
        assert session.wait() == 0
        assert session.modes == session.modes_before


def test_redirected_input_falls_back_to_the_controlling_terminal() -> None:
    with python(USES_TERMINAL, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as session:
        session.wait_for("ready", "text")
        session.type(b"q")
        session.wait_for("got 71", "text")
        session.type(b"x")
        assert session.wait() == 0
        assert session.modes == session.modes_before


def test_a_closed_window_ends_the_reading() -> None:
    with python(USES_TERMINAL) as session:
        session.wait_for("ready", "text")
        session.hang_up()
        assert session.wait() in (0, -signal.SIGHUP)


def test_without_a_terminal_it_says_how_to_get_one() -> None:
    result = subprocess.run(
        [sys.executable, "-c", USES_TERMINAL],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        cwd=REPOSITORY,
        timeout=DEADLINE_S,
        start_new_session=True,
    )
    assert result.returncode == 1
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert "softsim run teleop" in result.stderr
    assert "ros2 run softsim_ros teleop" in result.stderr


def test_a_background_job_is_refused_instead_of_stopped() -> None:
    launcher = (
        "import subprocess, sys\n"
        f"code = {USES_TERMINAL!r}\n"
        "result = subprocess.run([sys.executable, '-c', code], process_group=0)\n"
        "print('ended with', result.returncode)\n"
    )
    if sys.version_info < (3, 11):
        pytest.skip("subprocess sets process groups from Python 3.11 on")
    with python(launcher) as session:
        session.wait_for("another job", "text")
        session.wait_for("ended with 1", "text")
        assert session.wait() == 0


def test_output_of_others_waits_for_the_end_of_the_display() -> None:
    with python(HOLDS_OUTPUT) as session:
        session.wait_for("shown", "text")
        assert "held line" not in session.text
        session.type(b"x")
        assert session.wait() == 0
        after = session.text[session.text.index("shown") :].split("\r\n")
        assert after == ["shown", "held line", "from a child", "after", ""]


def test_keys_of_a_stopped_program_are_typed_again_once() -> None:
    with python(USES_TERMINAL) as session:
        session.wait_for("redraw", "text")
        session.signal(signal.SIGSTOP)
        session.type(b"q")
        assert session.wait_until(lambda: session.is_stopped)
        session.type(b"r")
        session.signal(signal.SIGCONT)
        assert session.wait_until(lambda: "".join(re.findall("got ([0-9a-f]+)", session.text)) == "7172")
        session.type(b"x")
        assert session.wait() == 0
