"""The closed loop as a client sees it: on or off, and its reference."""

from __future__ import annotations

from geometry_msgs.msg import Vector3Stamped
from rclpy.node import Node

from softsim_ros.client.known import Known
from softsim_ros.client.services import Done, Outcome, unheeded
from softsim_ros.client.state import Tilt
from softsim_ros.qos import NEWEST_ONLY
from softsim_ros.state_listener import StateListener


class ClosedLoop:
    """Follows `closed_loop` of the node's namespace and gives it references by `tilt_reference`.

    Args:
        node: The node whose executor delivers the messages.
        known: Where its reference is kept.
    """

    def __init__(self, node: Node, known: Known) -> None:
        self._known, self._clock = known, node.get_clock()
        self._references = node.create_publisher(Vector3Stamped, "tilt_reference", NEWEST_ONLY)
        self._enabled = StateListener(node, "closed_loop/enabled", self._on_change)
        self._reference = StateListener(node, "closed_loop/reference", self._on_change)

    def refer(self, reference: Tilt, done: Done = unheeded) -> None:
        """Give the loop a reference; refused while it is off."""
        if self._known.state.tilt is None:
            self._known.say("reference not given: the closed loop is off")
            done(Outcome(False, "reference not given: the closed loop is off"))
            return
        self._known.change(tilt=reference)
        message = Vector3Stamped()
        message.header.stamp, message.header.frame_id = self._clock.now().to_msg(), "world"
        message.vector.x, message.vector.y = reference
        self._references.publish(message)
        done(Outcome(True, ""))

    def _on_change(self, _: object) -> None:
        """References go on from the one that the loop had when it was seen to go on."""
        told = self._reference.value
        is_on = bool(self._enabled.value) and told is not None
        if is_on != (self._known.state.tilt is not None):
            self._known.change(tilt=Tilt(told.x, told.y) if is_on else None)
