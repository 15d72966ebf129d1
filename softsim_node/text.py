"""Text for users: errors on one line, text from elsewhere without control characters."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from itertools import islice
from typing import Final, TextIO

from softsim_core.base import SoftSimError

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
    plain = head if head.isprintable() else "".join(c if c.isprintable() else " " for c in head)
    return plain if len(plain) <= LONGEST_MESSAGE else f"{plain[: LONGEST_MESSAGE - 3]}..."


def takes_escapes(stream: TextIO | int) -> bool:
    """Return whether a stream, or a file descriptor, is a terminal that understands escape sequences.

    A terminal of type `dumb`, such as the shell of an editor, prints them as text.
    """
    terminal = os.isatty(stream) if isinstance(stream, int) else stream.isatty()
    return terminal and os.environ.get("TERM") != "dumb"


MOST_NAMES = 10
LONGEST_NAME, LONGEST_LISTED = 40, 16


def printable(text: str) -> str:
    """Return the text with every character that is not printable written as its escape sequence."""
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)


def shorten(text: str, length: int = LONGEST_NAME) -> str:
    """Return at most `length` printable characters of the text; an ellipsis marks omitted ones."""
    safe = printable(text[: length + 1])
    return safe if len(safe) <= length else f"{safe[: length - 3]}..."


def list_names(names: Collection[str]) -> str:
    """Return names for a message: at most ten, shortened, and the number of others; "none" without any."""
    few: Iterable[str] = islice(names, MOST_NAMES)
    text = ", ".join(shorten(each, LONGEST_LISTED) for each in few)
    more = len(names) - MOST_NAMES
    return f"{text} and {more} more" if more > 0 else text or "none"


def error_text(error: BaseException | str) -> str:
    """Return the text of an error as a message of at most 300 printable characters."""
    return shorten(str(error), LONGEST_MESSAGE)
