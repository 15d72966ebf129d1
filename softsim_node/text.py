"""Text for people: errors in one line, text from elsewhere without control characters."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from itertools import islice
from typing import Final, TextIO

from softsim_core.base.errors import SoftSimError

LONGEST_SENTENCE: Final = 300
"""So many characters has a refusal at most, on the log and in an answer."""


def sentence_of(error: BaseException) -> str:
    """What an error says to a person, on one line of at most LONGEST_SENTENCE characters."""
    text = str(error)
    if not isinstance(error, SoftSimError):
        text = f"refused: {type(error).__name__}" + (f" ({text})" if text else "")
    return one_line(text)


def one_line(text: str) -> str:
    """Text of others for logs and answers: control characters replaced, cut to LONGEST_SENTENCE."""
    head = text[: LONGEST_SENTENCE + 1]
    plain = head if head.isprintable() else "".join(c if c.isprintable() else " " for c in head)
    return plain if len(plain) <= LONGEST_SENTENCE else f"{plain[: LONGEST_SENTENCE - 3]}..."


def takes_escapes(stream: TextIO | int) -> bool:
    """Return whether a stream, or a file descriptor, is a terminal that understands escape sequences.

    One that calls itself `dumb`, such as the shell of an editor, shows them as they are.
    """
    terminal = os.isatty(stream) if isinstance(stream, int) else stream.isatty()
    return terminal and os.environ.get("TERM") != "dumb"


MOST_NAMES = 10
LONGEST_NAME, LONGEST_LISTED = 40, 16


def printable(text: str) -> str:
    """The text with every character that is not printable written as its escape sequence."""
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)


def shortened(text: str, length: int = LONGEST_NAME) -> str:
    """At most `length` characters of the text, printable; an ellipsis stands for what was left out."""
    safe = printable(text[: length + 1])
    return safe if len(safe) <= length else f"{safe[: length - 3]}..."


def named(names: Collection[str]) -> str:
    """Names for a message: at most ten, each shortened, and how many more there are; "none" without any."""
    few: Iterable[str] = islice(names, MOST_NAMES)
    text = ", ".join(shortened(each, LONGEST_LISTED) for each in few)
    more = len(names) - MOST_NAMES
    return f"{text} and {more} more" if more > 0 else text or "none"


def sentence(error: BaseException | str) -> str:
    """An error's text as a sentence of at most 300 printable characters."""
    return shortened(str(error), LONGEST_SENTENCE)
