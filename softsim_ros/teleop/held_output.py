"""Keeps what others write to the terminal away from a full-screen display, and shows it afterwards."""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import suppress
from types import TracebackType
from typing import IO

_SHOWN_BYTES = 16_384


class HeldOutput:
    """Context manager: standard output and error of the process go to a file while a display is on.

    Only those that lead to a terminal are held; a redirected one is left alone. At the end the newest lines
    are written to where they belonged. Works on file descriptors, so libraries and threads are held too.
    """

    def __init__(self) -> None:
        self._file: IO[bytes] | None = None
        self._saved: dict[int, int] = {}

    def __enter__(self) -> HeldOutput:
        """Redirect standard output and error where they are a terminal."""
        descriptors = [descriptor for descriptor in (1, 2) if _is_terminal(descriptor)]
        if descriptors:
            _flush()
            self._file = tempfile.TemporaryFile()
            for descriptor in descriptors:
                self._saved[descriptor] = os.dup(descriptor)
                os.dup2(self._file.fileno(), descriptor)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give both back and write the newest of what was held to standard error (or output)."""
        if self._file is None:
            return
        _flush()
        for descriptor, saved in self._saved.items():
            os.dup2(saved, descriptor)
            os.close(saved)
        held = self._newest()
        self._file.close()
        self._file = None
        if held:
            with suppress(OSError):  # the terminal may be gone
                os.write(max(self._saved), held)
        self._saved.clear()

    def _newest(self) -> bytes:
        assert self._file is not None
        size = os.fstat(self._file.fileno()).st_size
        newest = os.pread(self._file.fileno(), _SHOWN_BYTES, max(size - _SHOWN_BYTES, 0))
        return newest.split(b"\n", 1)[-1] if size > _SHOWN_BYTES else newest


def _is_terminal(descriptor: int) -> bool:
    try:
        return os.isatty(descriptor)
    except OSError:
        return False


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and not stream.closed:
            with suppress(OSError):  # the terminal may be gone
                stream.flush()
