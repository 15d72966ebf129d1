"""Colours of the command line: where a terminal shows them, and nowhere else."""

from __future__ import annotations

import os
from typing import Final, TextIO

_CODES: Final = {"bold": "1", "red": "31", "green": "32", "yellow": "33"}


class Colours:
    """Colours text for one stream, or leaves it as it is.

    It does where the stream is a terminal that has colours, and the environment variable NO_COLOR is not set.

    Args:
        stream: Where the text will be written.
    """

    def __init__(self, stream: TextIO) -> None:
        plain = os.environ.get("NO_COLOR") or os.environ.get("TERM", "dumb") in ("", "dumb")
        self._on = not plain and stream.isatty()

    def __call__(self, colour: str, text: str) -> str:
        """The text in a colour: bold, red, green or yellow."""
        return f"\x1b[{_CODES[colour]}m{text}\x1b[0m" if self._on else text
