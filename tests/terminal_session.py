"""A program in a terminal of its own: a pseudo-terminal that types keys and reads the screen, for tests."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from node_processes import domain_guards, hears_hang_up
from waiting import BUILD_S

REPOSITORY = Path(__file__).resolve().parents[1]

_ENTERED, _LEFT = "\x1b[?1049h", "\x1b[?1049l"
"""What a display writes when it takes the terminal and when it gives it back."""

_SEQUENCE = re.compile(r"\x1b\[[0-?]*[ -/]*[@-~]")


class TerminalSession:
    """Starts a program as the leader of a session whose controlling terminal is a new pseudo-terminal.

    A teleop that is stopped discards the keys that it has not read when it continues. They are typed once it
    shows its display again, as a user would type them again.

    Args:
        command: Program and arguments.
        size: Columns and rows.
        environment: Laid over this process's environment.
        **streams: stdin, stdout or stderr elsewhere than in the terminal, as for subprocess.Popen.
    """

    def __init__(
        self,
        command: Sequence[str],
        size: tuple[int, int] = (80, 24),
        environment: Mapping[str, str] | None = None,
        **streams: Any,
    ) -> None:
        self._master, self._slave = pty.openpty()
        self.resize(*size)
        self.modes_before = termios.tcgetattr(self._slave)
        self.output = ""
        self._typed = self._held = b""
        self._stopped_at = -1
        self._typing = threading.Lock()
        self._closed = threading.Event()
        search_path = os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")]))
        self.process = subprocess.Popen(
            command,
            **{"stdin": self._slave, "stdout": self._slave, "stderr": self._slave, **streams},
            cwd=REPOSITORY,
            env={
                **os.environ,
                "PYTHONPATH": search_path,
                "TERM": "xterm-256color",
                **(environment or {}),
            },
            start_new_session=True,
            preexec_fn=self._control_terminal,
            pass_fds=list(domain_guards),
        )
        self._reader = threading.Thread(target=self._read, name="terminal", daemon=True)
        self._reader.start()

    def _control_terminal(self) -> None:
        hears_hang_up()
        fcntl.ioctl(self._slave, termios.TIOCSCTTY, 0)

    def _read(self) -> None:
        while not self._closed.is_set():
            with self._typing:
                self._follow_stops()
            if select.select([self._master], [], [], 0.05)[0] and not self._take():
                return

    def _take(self) -> bool:
        """Read what is there; False where the other end is closed."""
        try:
            self.output += os.read(self._master, 65536).decode("utf-8", "replace")
        except OSError:
            return False
        return True

    def _follow_stops(self) -> None:
        """Hold the keys of a stopped display; type them when it has been entered again."""
        if self.is_stopped:
            if _ENTERED in self.output[self._stopped_at :]:
                os.write(self._master, self._held)
                self._stopped_at, self._held = -1, b""
        elif self._has_stopped() and self.output.rfind(_ENTERED) > self.output.rfind(_LEFT):
            unread = struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)))[0]
            self._stopped_at, self._held = len(self.output), self._typed[len(self._typed) - unread :]

    def _has_stopped(self) -> bool:
        """Whether the program has been stopped since the last call."""
        try:
            return os.waitid(os.P_PID, self.process.pid, os.WSTOPPED | os.WNOHANG) is not None
        except ChildProcessError:  # it has ended
            return False

    @property
    def is_stopped(self) -> bool:
        """Whether the display's program was stopped and has not entered the display again."""
        return self._stopped_at >= 0

    @property
    def text(self) -> str:
        """Everything written so far without control sequences."""
        return _SEQUENCE.sub("", self.output)

    @property
    def screen(self) -> str:
        """What was written since the display was drawn from the top for the last time."""
        return _SEQUENCE.sub("", self.output.rsplit("\x1b[H", 1)[-1])

    @property
    def modes(self) -> list[Any]:
        """Present modes of the terminal."""
        return termios.tcgetattr(self._slave)

    def resize(self, columns: int, rows: int) -> None:
        """Change the window's size."""
        fcntl.ioctl(self._slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def type(self, keys: bytes) -> None:
        """Type keys."""
        with self._typing:
            self._follow_stops()
            if self.is_stopped:
                self._held += keys
                return
            self._typed += keys
            os.write(self._master, keys)

    def wait_for(self, wanted: str, where: str = "screen") -> None:
        """Wait until a text is on the screen (`where` = "text" or "output": was written at all)."""
        found = self.wait_until(lambda: wanted in getattr(self, where))
        assert found, f"{wanted!r} never came; the {where} is:\n{getattr(self, where)}"

    def wait_until(self, condition: Callable[[], bool]) -> bool:
        """Wait for a condition; False when the deadline passed."""
        end = time.monotonic() + BUILD_S
        while not condition():
            if time.monotonic() > end:
                return False
            self._closed.wait(0.01)
        return True

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the program."""
        self.process.send_signal(number)

    def hang_up(self) -> None:
        """Close the terminal's window."""
        self._closed.set()
        self._reader.join()
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1

    def wait(self) -> int:
        """Wait for the program's end; returns its exit code (negative: killed by that signal)."""
        code = self.process.wait(BUILD_S)
        self._closed.set()
        self._reader.join()
        while self._master >= 0 and select.select([self._master], [], [], 0.0)[0] and self._take():
            """The last output was on its way."""
        return code

    def __enter__(self) -> TerminalSession:
        """Nothing: the program runs already."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Kill what still runs; close the terminal."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._closed.set()
        self._reader.join()
        for descriptor in (self._slave, self._master):
            if descriptor >= 0:
                os.close(descriptor)
