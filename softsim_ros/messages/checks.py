"""Parts of JSON messages, checked: what is not of its type raises TypeError or ValueError."""

from __future__ import annotations

import math
from typing import Any, Final

MOST_NAMES: Final = 5000
LONGEST_NAME: Final = 300


def listed(value: Any) -> list[Any]:
    """A list of at most MOST_NAMES."""
    if not isinstance(value, list) or len(value) > MOST_NAMES:
        raise TypeError(f"a list of at most {MOST_NAMES}")
    return value


def text(value: Any) -> str:
    """Any text."""
    if not isinstance(value, str):
        raise TypeError("text")
    return value


def name(value: Any) -> str:
    """A name that can be one of viser's nodes and options, too."""
    found = text(value)
    if not 0 < len(found) <= LONGEST_NAME or not found.isprintable() or ".." in found:
        raise ValueError("name")
    return found


def whole(value: Any) -> int:
    """A whole number >= 0."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < math.inf:
        raise TypeError("a whole number")
    return value
