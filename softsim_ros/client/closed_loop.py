"""The closed loop as a client sees it: on or off, and its reference."""

from __future__ import annotations

import math
import time
from typing import Final

from geometry_msgs.msg import Vector3Stamped
from rclpy.node import Node

from softsim_ros.client.known import Known
from softsim_ros.client.services import Done, Outcome, unheeded
from softsim_ros.client.state import Tilt
from softsim_ros.qos import NEWEST_ONLY

SILENT_AFTER_S: Final = 3.5
"""A closed loop without a report for this long, in [s], has ended."""


class ClosedLoop:
    """Follows `closed_loop` of the node's namespace and gives it references by `tilt_reference`.

    Args:
        node: The node whose executor delivers the messages.
        known: Where its reference is kept.
    """

    def __init__(self, node: Node, known: Known) -> None:
        self._known, self._clock = known, node.get_clock()
        self._references = node.create_publisher(Vector3Stamped, "tilt_reference", NEWEST_ONLY)
        self._reported_at = -math.inf

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

    def poll(self, now: float) -> None:
        """Notice that it has ended; `now` is a steady clock in [s]."""
        if self._known.state.tilt is not None and now - self._reported_at > SILENT_AFTER_S:
            self._known.change(tilt=None)

    def take(self, reference: Tilt | None) -> None:
        """Take what the loop reports; references go on from the one it had when it was seen to go on."""
        self._reported_at = time.monotonic()
        if (reference is None) != (self._known.state.tilt is None):
            self._known.change(tilt=reference)
