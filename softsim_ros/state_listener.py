"""A latched state topic as another node hears it: the newest value, for as long as its publisher lives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from servo_bridge.state_topics import STATE_QOS
from softsim_ros.messages.state_topics import STATE_TOPICS

GID_PREFIX = 12
"""Bytes of an endpoint's identifier that name its participant (DDS interoperability protocol, 8.2.4)."""


class StateListener:
    """Follows one of STATE_TOPICS in a node's namespace.

    Args:
        node: Its executor delivers the messages.
        topic: Name in STATE_TOPICS, such as "simulator/paused".
        changed: Called with the new `value` whenever that is another one.

    Attributes:
        value: The fact: True or False, a text, or the message of topics of another type. None while no
            publisher lives: none was found yet, it has ended, or its process has been dead for LEASE_S.
        is_matched: Whether a publisher is known, alive or silent; one that has ended is not.
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
        """A publisher began, ended, or was silent for LEASE_S; one told of only at its end counts -1."""
        self._alive = max(self._alive + status.alive_count_change, 0)
        self._take(self._newest if self._alive or self._lives_here() else None)

    def _on_matched(self, status: Any) -> None:
        """The last publisher has ended, which the graph may not show yet when liveliness tells of it."""
        self.is_matched = status.current_count > 0
        if not self.is_matched:
            self._alive = 0
            self._take(None)

    def _lives_here(self) -> bool:
        """Whether a publisher shares this node's context, where Fast DDS may tell nobody that it is alive."""
        own = {
            _participant(each)
            for each in self._node.get_subscriptions_info_by_topic(self._topic)
            if (each.node_name, each.node_namespace) == (self._node.get_name(), self._node.get_namespace())
        }
        found = self._node.get_publishers_info_by_topic(self._topic)
        return any(_participant(each) in own for each in found)

    def _take(self, value: Any) -> None:
        if value != self.value:
            self.value = value
            self._changed(value)


def _participant(endpoint: Any) -> bytes:
    """What the identifiers of all endpoints of one context begin with."""
    return bytes(endpoint.endpoint_gid[:GID_PREFIX])
