"""Text from elsewhere in a message: bounded in length, and nothing in it that a terminal would obey."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from itertools import islice

MOST_NAMES = 10
LONGEST_NAME, LONGEST_LISTED = 40, 16
LONGEST_SENTENCE = 300


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
