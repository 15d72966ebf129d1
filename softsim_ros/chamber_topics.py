"""Names of the topics that tell the pressure in each chamber of a robot."""

from __future__ import annotations

from collections.abc import Sequence

from softsim_core.actuation.chamber import ChamberDescription
from softsim_core.scene.joint import JointDescription
from softsim_ros.topic_names import topic_words


def chambers_of(joints: Sequence[JointDescription]) -> dict[int, str]:
    """Topic of each chamber among a robot's joints, by the joint's number."""
    chambers = [index for index, joint in enumerate(joints) if isinstance(joint.actuator, ChamberDescription)]
    topics = chamber_topics([joints[index].name for index in chambers])
    return dict(zip(chambers, topics, strict=True))


def chamber_topics(names: Sequence[str]) -> list[str]:
    """The topics of chambers by the names of their joints; what no topic may hold becomes an underscore."""
    return [f"chambers/{word}/pressure" for word in topic_words(names, "chamber")]
