"""The terminal as a source of key bytes and as a display: raw while in use, always restored."""

from __future__ import annotations

import fcntl
import os
import select
import signal
import sys
import tempfile
import termios
import threading
from contextlib import suppress
from types import FrameType
from typing import IO, Any, Final

from softsim_core.base import SoftSimError
from softsim_node import takes_escapes

_SHOWN_BYTES = 16_384


class DeferredOutput:
    """Context manager that redirects standard output and error to a file while a display is on.

    It redirects those of the whole process. A stream that does not lead to a terminal is left alone. At the
    end the newest lines are written to the original stream. Because it works on file descriptors, output of
    libraries and threads is redirected too.
    """

    def __init__(self) -> None:
        self._file: IO[bytes] | None = None
        self._saved: dict[int, int] = {}

    def __enter__(self) -> DeferredOutput:
        """Redirect standard output and error if they are a terminal."""
        descriptors = [descriptor for descriptor in (1, 2) if os.isatty(descriptor)]
        if descriptors:
            _flush()
            self._file = tempfile.TemporaryFile()
            for descriptor in descriptors:
                self._saved[descriptor] = os.dup(descriptor)
                os.dup2(self._file.fileno(), descriptor)
        return self

    def __exit__(self, *_: object) -> None:
        """Restore both and write the newest redirected lines to standard error (or output)."""
        if self._file is None:
            return
        _flush()
        for descriptor, saved in self._saved.items():
            os.dup2(saved, descriptor)
            os.close(saved)
        text = self._newest()
        self._file.close()
        self._file = None
        if text:
            with suppress(OSError):  # the terminal may be gone
                os.write(max(self._saved), text)
        self._saved.clear()

    def _newest(self) -> bytes:
        assert self._file is not None
        size = os.fstat(self._file.fileno()).st_size
        newest = os.pread(self._file.fileno(), _SHOWN_BYTES, max(size - _SHOWN_BYTES, 0))
        return newest.split(b"\n", 1)[-1] if size > _SHOWN_BYTES else newest


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and not stream.closed:
            with suppress(OSError):  # the terminal may be gone
                stream.flush()


_READ_SIZE = 4096
_DEFAULT_SIZE = (80, 24)
# Alternate screen, cursor hidden, no line wrap, pastes bracketed, kitty keys (flag 1), modifyOtherKeys 1; the
# last "0m" resets the colour on terminals that misread modifyOtherKeys as one.
_ENTER: Final = b"\x1b[?1049h\x1b[?25l\x1b[?7l\x1b[?2004h\x1b[>1u\x1b[>4;1m\x1b[0m\x1b[2J"
_LEAVE: Final = b"\x1b[>4m\x1b[<u\x1b[0m\x1b[?2004l\x1b[?7h\x1b[?25h\x1b[?1049l"


class NoTerminalError(SoftSimError, RuntimeError):
    """Keys cannot be read: there is no terminal, or it belongs to another job."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(
            f"teleop needs a terminal of its own and {reason}; open a terminal window and run "
            "`ros2 run softsim_ros teleop` or `softsim run teleop` in it"
        )


class RawTerminal:
    """Context manager: bytes as they are typed, with Ctrl+Z, Ctrl+Q and Ctrl+C as plain bytes.

    The terminal is standard input, or /dev/tty if that is redirected. Its modes are restored at the end of
    the `with` block and on exceptions; signals that end the process have to end the block. SIGTSTP restores
    the modes for the pause, and SIGCONT makes the terminal raw again.

    Raises:
        NoTerminalError: on entry, when there is no terminal to read from.
    """

    def __init__(self) -> None:
        self._previous_handlers: dict[signal.Signals, Any] = {}
        self._opened: list[int] = []
        self._input = self._output = -1
        self._saved: list[Any] | None = None
        self._active = False
        self._redraw = True

    def __enter__(self) -> RawTerminal:
        """Open the terminal, save its modes, make it raw."""
        self._open()
        try:
            self._saved = termios.tcgetattr(self._input)
            self._watch_signals()
            self._take()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the terminal."""
        self.close()

    def close(self) -> None:
        """Restore the terminal and the signal handlers; a second call does nothing."""
        self._give_back()
        for number, handler in self._previous_handlers.items():
            signal.signal(number, handler)
        self._previous_handlers.clear()
        while self._opened:
            os.close(self._opened.pop())
        self._input = self._output = -1

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows; 80 and 24 if the terminal does not report them."""
        try:
            columns, rows = os.get_terminal_size(self._output)
        except OSError:
            return _DEFAULT_SIZE
        return (columns, rows) if columns > 0 and rows > 0 else _DEFAULT_SIZE

    def take_redraw(self) -> bool:
        """Return whether the screen lost its content since the last call (first time, or after a pause)."""
        redraw, self._redraw = self._redraw, False
        return redraw

    def wait(self, timeout_s: float) -> bool:
        """Wait for a key for at most `timeout_s` seconds; return True when there is something to read."""
        return bool(select.select([self._input], [], [], timeout_s)[0])

    def read(self) -> bytes | None:
        """Return the bytes that have arrived, after `wait` was true; None when the terminal is gone."""
        try:
            return os.read(self._input, _READ_SIZE) or None
        except BlockingIOError:
            return b""
        except OSError:  # a closed window reads as an input/output error
            return None

    def write(self, text: str) -> None:
        """Show text; drop what a vanished or jammed terminal does not accept."""
        self._write(text.encode("utf-8", "replace"))

    def _write(self, data: bytes) -> None:
        with suppress(OSError):
            while data:
                data = data[os.write(self._output, data) :]

    def _open(self) -> None:
        """Find the descriptors to read and to write.

        Raises:
            NoTerminalError: neither standard input nor /dev/tty is a terminal of this job.
        """
        self._input = self._standard(sys.__stdin__)
        if self._input < 0:
            try:
                self._input = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
            except OSError:
                raise NoTerminalError("this process has none") from None
            self._opened.append(self._input)
        if not _in_foreground(self._input):
            self.close()
            raise NoTerminalError("this one is used by another job (was it started with &?)")
        self._output = self._standard(sys.__stdout__)
        if self._output < 0 and fcntl.fcntl(self._input, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            with suppress(OSError):
                self._output = os.open("/dev/tty", os.O_WRONLY | os.O_NOCTTY | os.O_CLOEXEC)
                self._opened.append(self._output)
        elif self._output < 0:
            self._output = self._input

    @staticmethod
    def _standard(stream: Any) -> int:
        try:
            descriptor = int(stream.fileno())
        except (AttributeError, OSError, ValueError):  # no stream, or a closed one
            return -1
        return descriptor if takes_escapes(descriptor) else -1

    def _take(self) -> None:
        assert self._saved is not None
        self._active = True
        termios.tcsetattr(self._input, termios.TCSANOW, _raw(self._saved))
        termios.tcflush(
            self._input, termios.TCIFLUSH
        )  # keys typed before the display are not meant for the robot
        self._write(_ENTER)
        self._redraw = True

    def _give_back(self) -> None:
        if not self._active or self._saved is None:
            return
        self._active = False
        self._write(_LEAVE)
        with suppress(termios.error):  # the terminal may be gone
            termios.tcflush(self._input, termios.TCIFLUSH)
            termios.tcsetattr(self._input, termios.TCSANOW, self._saved)

    def _watch_signals(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            return  # Python handles signals in the main thread only
        self._previous_handlers[signal.SIGTSTP] = signal.signal(signal.SIGTSTP, self._on_stop)
        self._previous_handlers[signal.SIGCONT] = signal.signal(signal.SIGCONT, self._on_continue)

    def _on_stop(self, number: int, frame: FrameType | None) -> None:
        self._give_back()
        os.kill(os.getpid(), signal.SIGSTOP)

    def _on_continue(self, number: int, frame: FrameType | None) -> None:
        with suppress(termios.error):
            self._take()


def _in_foreground(descriptor: int) -> bool:
    try:
        return os.tcgetpgrp(descriptor) == os.getpgrp()
    except OSError:  # a terminal that is not the controlling one has no foreground job
        return True


def _raw(saved: list[Any]) -> list[Any]:
    """Return terminal modes for single keys: no echo, no line editing, no signals, no flow control.

    Output processing stays on, so that lines written by other programs still end at the left margin.
    """
    iflag, oflag, cflag, lflag, ispeed, ospeed, characters = saved
    iflag &= ~(
        termios.BRKINT | termios.ICRNL | termios.INLCR | termios.IGNCR | termios.INPCK | termios.ISTRIP
        | termios.IXON | termios.IXOFF | termios.PARMRK
    )  # fmt: skip
    lflag &= ~(termios.ECHO | termios.ECHONL | termios.ICANON | termios.IEXTEN | termios.ISIG)
    characters = list(characters)
    characters[termios.VMIN], characters[termios.VTIME] = 1, 0
    return [iflag, oflag, cflag, lflag, ispeed, ospeed, characters]
