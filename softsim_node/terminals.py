"""What a stream can show."""

from __future__ import annotations

import os
from typing import TextIO


def takes_escapes(stream: TextIO | int) -> bool:
    """Return whether a stream, or a file descriptor, is a terminal that understands escape sequences.

    One that calls itself `dumb`, such as the shell of an editor, shows them as they are.
    """
    terminal = os.isatty(stream) if isinstance(stream, int) else stream.isatty()
    return terminal and os.environ.get("TERM") != "dumb"
