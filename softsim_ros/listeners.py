"""Listeners for the newest value of a latched state topic, and for joint states in command order."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from sensor_msgs.msg import JointState

from softsim_core.base import Array
from softsim_core.scene import JointDescription
from softsim_node import MEASURED, STATE_QOS, STATE_TOPICS

GID_PREFIX = 12
"""Bytes of an endpoint's identifier that identify its participant (DDS interoperability protocol, 8.2.4)."""


class StateListener:
    """Follows one of STATE_TOPICS in a node's namespace.

    Args:
        node: Its executor delivers the messages.
        topic: Name in STATE_TOPICS, such as "simulator/paused".
        changed: Called with the new `value` whenever it changes.

    Attributes:
        value: The state: True or False, a text, or the message of topics of another type. None while no
            publisher is alive: none was found yet, it has ended, or its process has been dead for LEASE_S.
        is_matched: Whether a publisher exists, also one without output; False for one that has ended.
    """

    def __init__(self, node: Node, topic: str, changed: Callable[[Any], None] = lambda value: None) -> None:
        self.value: Any = None
        self.is_matched = False
        self._node, self._newest, self._changed = node, None, changed
        self._alive = 0
        events = SubscriptionEventCallbacks(liveliness=self._on_liveliness, matched=self._on_matched)
        self._topic = node.create_subscription(
            STATE_TOPICS[topic], topic, self._on_message, STATE_QOS, event_callbacks=events
        ).topic_name

    def _on_message(self, message: Any) -> None:
        self._newest = getattr(message, "data", message)
        self._take(self._newest)

    def _on_liveliness(self, status: Any) -> None:
        """Handle that a publisher began, ended, or did not respond for LEASE_S.

        A publisher that is announced only at its end counts -1.
        """
        self._alive = max(self._alive + status.alive_count_change, 0)
        self._take(self._newest if self._alive or self._lives_here() else None)

    def _on_matched(self, status: Any) -> None:
        """Handle the end of the last publisher, which liveliness may report before the graph does."""
        self.is_matched = status.current_count > 0
        if not self.is_matched:
            self._alive = 0
            self._take(None)

    def _lives_here(self) -> bool:
        """Return whether a publisher shares this node's context.

        Fast DDS may not report such a publisher as alive.
        """
        name = self._node.get_name(), self._node.get_namespace()
        subscriptions = self._node.get_subscriptions_info_by_topic(self._topic)
        own = {_participant(each) for each in subscriptions if (each.node_name, each.node_namespace) == name}
        found = self._node.get_publishers_info_by_topic(self._topic)
        return any(_participant(each) in own for each in found)

    def _take(self, value: Any) -> None:
        if value != self.value:
            self.value = value
            self._changed(value)


def _participant(endpoint: Any) -> bytes:
    """Return the common prefix of the identifiers of all endpoints of one context."""
    return bytes(endpoint.endpoint_gid[:GID_PREFIX])


class JointReader:
    """Reads joint states that contain all joints of a robot, in any order, possibly with other joints.

    Args:
        joints: Joints of the robot, in command order.
        refuse: Called with a message when messages begin to name other joints.
    """

    def __init__(self, joints: Sequence[JointDescription], refuse: Callable[[str], None]) -> None:
        self._joints, self._refuse = joints, refuse
        self._order: tuple[tuple[str, ...], list[int] | None] = ((), None)

    def read(self, message: JointState) -> Array | None:
        """Return positions in [rad] or [m], or efforts where these are commanded, shape (j,).

        Return None for a message of another robot.
        """
        positions, efforts = self.positions(message), self.efforts(message)
        if positions is None or efforts is None:
            return positions
        return np.where([joint.by_effort for joint in self._joints], efforts, positions)

    def positions(self, message: JointState) -> Array | None:
        """Return positions in [rad] or [m], shape (j,); None for a message of another robot."""
        names = tuple(message.name)
        if names != self._order[0]:
            self._order = (names, self._order_of(names))
        order = self._order[1]
        if order is None or len(message.position) != len(names):
            return None
        return np.array([message.position[index] for index in order])

    def efforts(self, message: JointState) -> Array | None:
        """Return efforts in [N m] or [N], (j,), of the message read last; None if it has none."""
        order = self._order[1]
        if order is None or len(message.effort) != len(self._order[0]):
            return None
        return np.array([message.effort[index] for index in order])

    def _order_of(self, names: tuple[str, ...]) -> list[int] | None:
        missing = [joint.name for joint in self._joints if joint.name not in names]
        if missing:
            found = ", ".join(names) or "it"
            self._refuse(f"joint_states of another robot ignored: {', '.join(missing)} not in {found}")
            return None
        return [names.index(joint.name) for joint in self._joints]


class JointStates:
    """Receives joint positions: measured ones, or those that a bridge has sent while none are measured.

    Args:
        node: Owner of the subscriptions.
        stale_after_s: Time in [s] without a message of the first topic after which the second one is used.
        take: Called in the node's executor with each message.
        topics: The topics in another order, for a node that prefers the bridge's positions.
    """

    def __init__(
        self,
        node: Node,
        stale_after_s: float,
        take: Callable[[JointState], None],
        topics: tuple[str, str] = ("joint_states", "applied_joint_states"),
    ) -> None:
        self._stale_after_s, self._take = stale_after_s, take
        self._first_at = -np.inf
        for topic, callback in zip(topics, (self._on_first, self._on_second), strict=True):
            node.create_subscription(JointState, topic, callback, MEASURED)

    def _on_first(self, message: JointState) -> None:
        self._first_at = time.monotonic()
        self._take(message)

    def _on_second(self, message: JointState) -> None:
        if time.monotonic() - self._first_at > self._stale_after_s:
            self._take(message)
