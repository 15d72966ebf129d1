"""Names of topics that are derived from the names of a robot's parts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from softsim_core.scene import JointDescription

LONGEST_NAME: Final = 60
"""Largest number of characters of a name in a topic; ROS allows about 250 characters for the whole topic."""


def topic_words(names: Sequence[str], kind: str) -> list[str]:
    """Return a unique word for each name; characters that topics do not allow become underscores.

    Args:
        names: Names of the parts.
        kind: Prefix of a name that does not begin with a letter, such as "chamber".
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


def chambers_of(joints: Sequence[JointDescription]) -> dict[int, str]:
    """Return the topic of each chamber among a robot's joints, by the joint's number."""
    chambers = [k for k, joint in enumerate(joints) if joint.actuator is not None and joint.actuator.gas]
    topics = chamber_topics([joints[index].name for index in chambers])
    return dict(zip(chambers, topics, strict=True))


def chamber_topics(names: Sequence[str]) -> list[str]:
    """Return the topics of chambers by the names of their joints, as `topic_words`."""
    return [f"chambers/{word}/pressure" for word in topic_words(names, "chamber")]
