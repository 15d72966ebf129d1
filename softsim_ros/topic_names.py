"""Topics that are named after parts of a robot: words that ROS allows, one for each name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

LONGEST_NAME: Final = 60
"""So much of a name stands in a topic; ROS allows about 250 characters for a topic in all."""


def topic_words(names: Sequence[str], kind: str) -> list[str]:
    """A word of its own for each name; what no topic may hold becomes an underscore.

    Args:
        names: Names of the parts.
        kind: Stands before a name that does not begin with a letter, such as "chamber".
    """
    words: list[str] = []
    for name in names:
        word = re.sub(r"[^A-Za-z0-9_]", "_", name[:LONGEST_NAME])
        if not word[:1].isalpha():
            word = f"{kind}_{word}"
        while word in words:
            word = f"{word}_"
        words.append(word)
    return words
