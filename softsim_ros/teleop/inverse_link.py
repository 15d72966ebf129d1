"""The inverse controller as the teleop sees it: its switch, its report, goal and effector."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool

from softsim_ros.messages import pose_stamped
from softsim_ros.teleop.services import AsyncService
from softsim_ros.teleop.state import STALE_AFTER_S, EffectorPose, TeleopState, with_inverse

SILENT_AFTER_S: Final = 3.5
"""A controller without diagnostics for this long, in [s], has ended."""

UNSURE_FOR_S: Final = 0.5
"""For this long after a switch, in [s], a report may still be from before it."""

_NEWEST_ONLY = QoSProfile(depth=1)


class InverseLink:
    """Follows `inverse_controller` of the node's namespace and gives it goals.

    The effector is the measured one; where nobody measures it, the controller's model.

    Args:
        node: The node whose executor delivers the messages.
    """

    def __init__(self, node: Node) -> None:
        self.service = AsyncService(node, SetBool, "inverse_controller/enable")
        self._clock = node.get_clock()
        self._goals = node.create_publisher(PoseStamped, "effector_goal", _NEWEST_ONLY)
        self._name = f"{node.get_namespace().strip('/')}/inverse_controller".lstrip("/")
        self._measured: tuple[PoseStamped | None, float] = (None, -math.inf)
        self._model: tuple[PoseStamped | None, float] = (None, -math.inf)
        self._report: tuple[dict[str, str], float] = ({}, -math.inf)
        self._switched_at = -math.inf
        node.create_subscription(PoseStamped, "effector_pose", self._on_measured, _NEWEST_ONLY)
        node.create_subscription(PoseStamped, "inverse_controller/model_pose", self._on_model, _NEWEST_ONLY)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def publish(self, goal: EffectorPose) -> None:
        """Give the controller a goal."""
        stamp = self._clock.now().to_msg()
        self._goals.publish(pose_stamped(stamp, "world", goal.position, goal.quaternion_xyzw))

    def switched(self, now: float) -> None:
        """Inverse control was switched at `now` [s]: reports from before it say nothing any more."""
        self._switched_at = now

    def follow(self, state: TeleopState, now: float) -> TeleopState:
        """The state with what is known of the controller and the effector at `now`, steady clock in [s]."""
        message, seen_at = self._measured
        if now - seen_at > STALE_AFTER_S:
            message, seen_at = self._model
        if message is not None:
            state = replace(state, effector=_pose(message), effector_at=seen_at)
        report, reported_at = self._report
        if reported_at >= self._switched_at + UNSURE_FOR_S:
            enabled = report.get("mode", "off") != "off"
            note = report.get("sentence", "")
            if enabled != state.inverse:
                state = replace(with_inverse(state, enabled), message=note or state.message)
            state = replace(state, inverse_note=note if enabled else "")
        if state.inverse and now - max(reported_at, self._switched_at) > SILENT_AFTER_S:
            gone = "inverse control has ended; the keys drive the joints again"
            state = replace(with_inverse(state, False), message=gone)
        return state

    def _on_measured(self, message: PoseStamped) -> None:
        self._measured = (message, time.monotonic())

    def _on_model(self, message: PoseStamped) -> None:
        self._model = (message, time.monotonic())

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._name:
                values = {pair.key: pair.value for pair in status.values}
                self._report = ({**values, "sentence": status.message}, time.monotonic())


def _pose(message: PoseStamped) -> EffectorPose:
    place, turn = message.pose.position, message.pose.orientation
    return EffectorPose((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
