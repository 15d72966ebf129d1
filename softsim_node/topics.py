"""Topics of the suite: their quality of service, and latched topics that tell a node's state.

Common messages carry them, so that a graph may mix apt's ROS 2 with the PyPI wheels; see docs/interfaces.md.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeAlias

from geometry_msgs.msg import Vector3
from lifecycle_msgs.msg import State
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool, String

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


LOOK_PERIOD_S: Final = 0.1
"""A change that nobody announced is noticed within this time, in [s]."""

LEASE_S: Final = 2.0
"""A process that was killed counts as gone after this time, in [s], for those who ask for it."""

STATE_QOS: Final = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=LEASE_S),
)
"""Of publishers; a subscriber may ask for less, such as no lease, which is rclpy's default."""


Facts: TypeAlias = Mapping[str, tuple[type, Callable[[], Any]]]
"""Type and reader by topic; a reader gives a message of that type, from any thread, at once."""


class StateTopics:
    """Publishers of a node's state; each reads its own fact.

    The facts are read again at every `refresh`, ten times a second at least, and those that differ are sent.

    Args:
        node: Owner of the publishers and of the timer.
        facts: What is told, by topic.
    """

    def __init__(self, node: Node, facts: Facts) -> None:
        self._context, self._lock = node.context, threading.Lock()
        self._facts = [
            (node.create_publisher(kind, topic, STATE_QOS), read) for topic, (kind, read) in facts.items()
        ]
        self._told: list[Any] = [None] * len(self._facts)
        self.refresh()
        node.create_timer(LOOK_PERIOD_S, self.refresh, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def refresh(self) -> None:
        """Send what has changed; may be called from any thread."""
        with self._lock:  # what is read last is sent last
            for number, (publisher, read) in enumerate(self._facts):
                fact = read()
                if fact == self._told[number]:
                    continue
                try:
                    publisher.publish(fact)
                except Exception:
                    if self._context.ok():
                        raise
                    return  # a signal has shut the context down under the call
                self._told[number] = fact


STATE_TOPICS: Final[Mapping[str, type]] = {
    "simulator/paused": Bool,
    "simulator/faulted": Bool,
    "servo_bridge/state": State,
    "servo_bridge/connected": Bool,
    "servo_bridge/sending": Bool,
    "servo_bridge/e_stop_latched": Bool,
    "servo_bridge/commanded_by": String,
    "inverse_controller/enabled": Bool,
    "path_follower/enabled": Bool,
    "path_follower/playing": Bool,
    "path_follower/paused": Bool,
    "path_follower/file": String,
    "closed_loop/enabled": Bool,
    "closed_loop/reference": Vector3,
    "policy/enabled": Bool,
    "observer/touched": Bool,
    "observer/verdict": String,
    "recorder/enabled": Bool,
    "replay/paused": Bool,
}
"""Message class by topic; each has one publisher, the node in its name."""
