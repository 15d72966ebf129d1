"""Text for users: errors on one line, text from elsewhere without control characters."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Final, TextIO

from softsim_core.base import MOST_NAMES, SoftSimError, names_up_to, on_one_line, shorten

LONGEST_MESSAGE: Final = 300
"""Longest message about a refusal in the log and in a response, in characters."""


def error_message(error: BaseException) -> str:
    """Return the message of an error on one line of at most LONGEST_MESSAGE characters."""
    text = str(error)
    if not isinstance(error, SoftSimError):
        text = f"refused: {type(error).__name__}" + (f" ({text})" if text else "")
    return one_line(text)


def one_line(text: str) -> str:
    """Prepare foreign text for logs and responses: replace control characters, cut at LONGEST_MESSAGE."""
    head = text[: LONGEST_MESSAGE + 1]
    plain = on_one_line(head)
    return plain if len(plain) <= LONGEST_MESSAGE else f"{plain[: LONGEST_MESSAGE - 3]}..."


def takes_escapes(stream: TextIO | int) -> bool:
    """Return whether a stream, or a file descriptor, is a terminal that understands escape sequences.

    A terminal of type `dumb`, such as the shell of an editor, prints them as text.
    """
    terminal = os.isatty(stream) if isinstance(stream, int) else stream.isatty()
    return terminal and os.environ.get("TERM") != "dumb"


LONGEST_LISTED: Final = 16


def list_names(names: Iterable[str]) -> str:
    """Return names for a message: at most ten, shortened, and the number of others; "none" without any."""
    return names_up_to(MOST_NAMES, names, LONGEST_LISTED)


def error_text(error: BaseException | str) -> str:
    """Return the text of an error as a message of at most 300 printable characters."""
    return shorten(str(error), LONGEST_MESSAGE)
