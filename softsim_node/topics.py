"""Topics of the suite: their quality of service, and latched topics with a node's state.

They use common message types, so that a graph may mix apt's ROS 2 with the PyPI wheels; see
docs/interfaces.md.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeAlias

from geometry_msgs.msg import Vector3
from lifecycle_msgs.msg import State
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool, String

from softsim_node.guards import steady_timer

NEWEST_ONLY: Final = QoSProfile(depth=1)
"""Commands, goals and pictures: reliable, and only the newest message counts."""

EVERY_ONE: Final = QoSProfile(depth=10)
"""Events and measurements of which none should be missed: reliable, with a short queue."""

MEASURED: Final = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Incoming measurements: only the newest counts, and sensors that publish best effort are received, too."""

LATCHED: Final = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Values that stay valid: reliable, and late subscribers receive the newest message, too."""


def latched_qos(depth: int) -> QoSProfile:
    """Return a profile like LATCHED that gives late subscribers the newest `depth` messages."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def matching_qos(publishers: Sequence[Any], depth: int) -> QoSProfile:
    """Return a profile that receives from every one of these publishers.

    It is reliable if all of them are, and latched if all of them are.

    Args:
        publishers: Endpoint information of a topic from rclpy.
        depth: Length of the queue.
    """
    profiles = [each.qos_profile for each in publishers]
    is_latched = bool(profiles) and all(
        each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in profiles
    )
    reliable = all(each.reliability == ReliabilityPolicy.RELIABLE for each in profiles)
    return QoSProfile(
        depth=depth,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


LOOK_PERIOD_S: Final = 0.1
"""A change without a call of `refresh` is noticed within this time, in [s]."""

LEASE_S: Final = 2.0
"""Time in [s] after which a killed process counts as gone, for subscribers that ask for it."""

STATE_QOS: Final = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=LEASE_S),
)
"""Profile of publishers; a subscriber may ask for less, such as no lease, which is rclpy's default."""


Facts: TypeAlias = Mapping[str, Callable[[], Any]]
"""Reader by name in STATE_TOPICS; it returns a message of the type there at once, from any thread."""


class StateTopics:
    """Publishers of a node's state, each with a reader of its value.

    The values are read at every `refresh`, at least ten times per second, and changed ones are published.

    Args:
        facts: Reader by name in STATE_TOPICS; its last part is the topic below the node's own name.

    Raises:
        KeyError: a name is not in STATE_TOPICS.
    """

    def __init__(self, node: Node, facts: Facts) -> None:
        self._context, self._lock = node.context, threading.Lock()
        self._facts = [
            (node.create_publisher(STATE_TOPICS[name], f"~/{name.partition('/')[2]}", STATE_QOS), read)
            for name, read in facts.items()
        ]
        self._published: list[Any] = [None] * len(self._facts)
        self.refresh()
        steady_timer(node, LOOK_PERIOD_S, self.refresh)

    def refresh(self) -> None:
        """Publish changed values; may be called from any thread."""
        with self._lock:  # the lock keeps the order: the value that is read last is sent last
            for number, (publisher, read) in enumerate(self._facts):
                fact = read()
                if fact == self._published[number]:
                    continue
                try:
                    publisher.publish(fact)
                except Exception:
                    if self._context.ok():
                        raise
                    return  # a signal has shut the context down during the call
                self._published[number] = fact


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
