"""A node's state as data: latched topics of one fact each, sent at the start and on every change."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

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
