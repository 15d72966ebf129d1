"""Quality of service of every topic of the suite: what is offered and asked for, by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

NEWEST_ONLY: Final = QoSProfile(depth=1)
"""Commands, goals and pictures: reliable, and only the newest counts."""

EVERY_ONE: Final = QoSProfile(depth=10)
"""Events and measurements of which none should be missed: reliable, a few may wait."""

MEASURED: Final = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Measurements that come in: only the newest counts, and sensors that send best effort are heard, too."""

LATCHED: Final = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""What stays true: reliable, and who comes later gets the newest, too."""


def latched(depth: int) -> QoSProfile:
    """As LATCHED; who comes later gets the newest `depth` messages."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def hearing_all(publishers: Sequence[Any], depth: int) -> QoSProfile:
    """What hears every one of these publishers, as reliably as all offer it; latched where all of them latch.

    Args:
        publishers: What rclpy tells of the endpoints of a topic.
        depth: So many messages may wait.
    """
    profiles = [each.qos_profile for each in publishers]
    keeps = bool(profiles) and all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in profiles)
    reliable = all(each.reliability == ReliabilityPolicy.RELIABLE for each in profiles)
    return QoSProfile(
        depth=depth,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if keeps else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )
