"""What code prints in one thread, line by line; other threads write to standard output as before."""

from __future__ import annotations

import io
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class _Lines:
    """Hands text on in whole lines."""

    def __init__(self, on_line: Callable[[str], None]) -> None:
        self._on_line, self._rest = on_line, ""

    def write(self, text: str) -> None:
        *lines, self._rest = (self._rest + text).split("\n")
        for line in filter(str.strip, lines):
            self._on_line(line)

    def close(self) -> None:
        if self._rest:
            self.write("\n")


class _ByThread(io.TextIOBase):
    """Stands in for standard output while a thread is listened to."""

    def __init__(self, usual: Any) -> None:
        self.usual, self.lines = usual, dict[int, _Lines]()

    def write(self, text: str) -> int:
        lines = self.lines.get(threading.get_ident())
        if lines is None:
            return int(self.usual.write(text))
        lines.write(text)
        return len(text)

    def flush(self) -> None:
        self.usual.flush()

    def isatty(self) -> bool:
        return bool(self.usual.isatty())

    def fileno(self) -> int:
        return int(self.usual.fileno())


_exchange = threading.Lock()


@contextmanager
def printed_lines(on_line: Callable[[str], None]) -> Iterator[None]:
    """Give each line that this thread prints inside to `on_line`, which must not print itself.

    Empty lines are left out. Threads may do so at the same time, each with its own `on_line`.
    """
    this = threading.get_ident()
    lines = _Lines(on_line)
    with _exchange:
        if not isinstance(sys.stdout, _ByThread):
            sys.stdout = _ByThread(sys.stdout)
        output = sys.stdout
        output.lines[this] = lines
    try:
        yield
    finally:
        lines.close()
        with _exchange:
            del output.lines[this]
            if not output.lines and sys.stdout is output:
                sys.stdout = output.usual
