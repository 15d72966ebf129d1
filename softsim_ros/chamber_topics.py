"""Names of the topics that tell the pressure in each chamber of a robot."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from softsim_core.actuation.chamber import ChamberDescription
from softsim_core.scene.description import JointDescription

LONGEST_NAME: Final = 60
"""So much of a joint's name stands in its topic; ROS allows about 250 characters for a topic in all."""


def chambers_of(joints: Sequence[JointDescription]) -> dict[int, str]:
    """Topic of each chamber among a robot's joints, by the joint's number."""
    chambers = [index for index, joint in enumerate(joints) if isinstance(joint.actuator, ChamberDescription)]
    topics = chamber_topics([joints[index].name for index in chambers])
    return dict(zip(chambers, topics, strict=True))


def chamber_topics(names: Sequence[str]) -> list[str]:
    """The topics of chambers by the names of their joints; what no topic may hold becomes an underscore."""
    topics: list[str] = []
    for name in names:
        token = re.sub(r"[^A-Za-z0-9_]", "_", name[:LONGEST_NAME])
        if not token[:1].isalpha():
            token = f"chamber_{token}"
        while f"chambers/{token}/pressure" in topics:
            token = f"{token}_"
        topics.append(f"chambers/{token}/pressure")
    return topics
