"""The closed loop as the teleop sees it: on or off, and its reference."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from dataclasses import replace
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from rclpy.node import Node
from rclpy.qos import QoSProfile

from softsim_ros.messages import diagnostic_values
from softsim_ros.teleop.state import TeleopState, TiltReference

SILENT_AFTER_S: Final = 3.5
"""A closed loop without diagnostics for this long, in [s], has ended."""


class TiltLink:
    """Follows `closed_loop` of the node's namespace and gives it references.

    Args:
        node: The node whose executor delivers the messages.
    """

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self._references = node.create_publisher(Vector3Stamped, "tilt_reference", QoSProfile(depth=1))
        self._name = f"{node.get_namespace().strip('/')}/closed_loop".lstrip("/")
        self._report: tuple[dict[str, str], float] = ({}, -math.inf)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def publish(self, reference: TiltReference) -> None:
        """Give the loop a reference."""
        message = Vector3Stamped()
        message.header.stamp, message.header.frame_id = self._clock.now().to_msg(), "world"
        message.vector.x, message.vector.y = reference.x, reference.y
        self._references.publish(message)

    def follow(self, state: TeleopState, now: float) -> TeleopState:
        """The state with what is known of the loop at `now`, steady clock in [s].

        The keys go on from the reference that the loop had when it was first seen to be on.
        """
        report, reported_at = self._report
        if now - reported_at > SILENT_AFTER_S or report.get("state", "off") == "off":
            return state if state.tilt is None else replace(state, tilt=None)
        if state.tilt is not None:
            return state
        x = y = 0.0
        with suppress(ValueError):
            x, y = (float(report.get(f"reference_{axis}_rad", "0")) for axis in "xy")
        return replace(state, tilt=TiltReference("y", x, y))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        values = diagnostic_values(message, self._name)
        if values:
            self._report = (dict(values), time.monotonic())
