"""Clients of inverse control and of the closed loop: switches, goal, reference, reports."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rclpy.node import Node

from softsim_core.base import MILLIMETRE
from softsim_node import MEASURED, NEWEST_ONLY
from softsim_ros import StateListener
from softsim_ros.client.services import Done, Outcome, Switch, ignore_outcome, report
from softsim_ros.client.state import (
    STALE_AFTER_S,
    EffectorPose,
    RobotSnapshot,
    RobotState,
    Tilt,
    known_effector,
    with_inverse,
)
from softsim_ros.messages import pose_stamped


def moved_goal(state: RobotState, shift: Sequence[float], now: float) -> EffectorPose | None:
    """Return the goal set by this client, or else the effector's pose, moved by `shift` (3,) in [m].

    Return None without either.
    """
    start = state.goal or known_effector(state, now)
    if start is None:
        return None
    x, y, z = (round(value + by, 9) for value, by in zip(start.position, shift, strict=True))
    return EffectorPose((x, y, z), start.quaternion_xyzw)


def format_point(pose: EffectorPose) -> str:
    """Return a position as "x 0.0 y -2.0 z 31.5", in mm."""
    values = (round(value / MILLIMETRE, 1) + 0.0 for value in pose.position)  # + 0.0: no "-0.0"
    return " ".join(f"{axis} {value:.1f}" for axis, value in zip("xyz", values, strict=True))


class ClosedLoop:
    """Follows `closed_loop` of the node's namespace and sends references on `tilt_reference`."""

    def __init__(self, node: Node, snapshot: RobotSnapshot) -> None:
        self._snapshot, self._clock = snapshot, node.get_clock()
        self._references = node.create_publisher(Vector3Stamped, "tilt_reference", NEWEST_ONLY)
        self._enabled = StateListener(node, "closed_loop/enabled", self._on_change)
        self._reference = StateListener(node, "closed_loop/reference", self._on_change)

    def refer(self, reference: Tilt, done: Done = ignore_outcome) -> None:
        """Send the loop a reference; refused while it is off."""
        if self._snapshot.state.tilt is None:
            report(Outcome(False, "reference not sent: the closed loop is off"), self._snapshot.say, done)
            return
        self._snapshot.change(tilt=reference)
        message = Vector3Stamped()
        message.header.stamp, message.header.frame_id = self._clock.now().to_msg(), "world"
        message.vector.x, message.vector.y = reference
        self._references.publish(message)
        done(Outcome(True, ""))

    def _on_change(self, _: object) -> None:
        """Take over the reference that the loop has when it is switched on."""
        reference = self._reference.value
        is_on = bool(self._enabled.value) and reference is not None
        if is_on != (self._snapshot.state.tilt is not None):
            self._snapshot.change(tilt=Tilt(reference.x, reference.y) if is_on else None)


class Inverse:
    """Follows `inverse_controller` of the node's namespace and sends it goals.

    The effector pose is the measured one, or that of the controller's model without a measurement. Published
    topic: `effector_goal`. Subscribed topics: `effector_goal`, for goals of other programs; `effector_pose`;
    `inverse_controller/model_pose`.
    """

    def __init__(self, node: Node, snapshot: RobotSnapshot) -> None:
        self._snapshot, self._clock = snapshot, node.get_clock()
        self._enable = Switch(node, "inverse_controller/enable", "inverse control", snapshot.say)
        self._goals = node.create_publisher(PoseStamped, "effector_goal", NEWEST_ONLY)
        self._measured_at, self._reports_switch = -math.inf, False
        StateListener(node, "inverse_controller/enabled", self._on_enabled)
        for topic, callback, quality in (
            ("effector_pose", self._on_measured, MEASURED),
            ("inverse_controller/model_pose", self._on_model, NEWEST_ONLY),
            ("effector_goal", self._on_goal, NEWEST_ONLY),
        ):
            node.create_subscription(PoseStamped, topic, callback, quality)

    # --- actions --------------------------------------------------------------------------------------

    def enable(self, enabled: bool, done: Done = ignore_outcome) -> None:
        """Switch inverse control on or off."""

        def record_switch() -> str:
            self._snapshot.put(with_inverse(self._snapshot.state, enabled))
            return f"inverse control is {'on' if enabled else 'off'}"

        self._enable.set(enabled, done, record_switch)

    def toggle(self, done: Done = ignore_outcome) -> None:
        """Switch inverse control on if it is off, and off if it is on."""
        self.enable(self._enable.opposite(self._snapshot.state.inverse), done)

    def give_goal(self, goal: EffectorPose, done: Done = ignore_outcome) -> None:
        """Send a goal; refused while inverse control is off."""
        if not self._snapshot.state.inverse:
            report(Outcome(False, "goal not sent: inverse control is off"), self._snapshot.say, done)
            return
        self._snapshot.change(goal=goal, heard_goal=goal)
        stamp = self._clock.now().to_msg()
        self._goals.publish(pose_stamped(stamp, "world", goal.position, goal.quaternion_xyzw))
        done(Outcome(True, ""))

    def move_goal(self, shift: Sequence[float], done: Done = ignore_outcome) -> None:
        """Move the goal; the first goal is the effector's present pose, moved.

        Args:
            shift: Shift along world x, y, z in [m].
            done: Called with the outcome.
        """
        goal = moved_goal(self._snapshot.state, shift, time.monotonic())
        if goal is None:
            report(Outcome(False, "goal not moved: no effector pose received yet"), self._snapshot.say, done)
        else:
            self._snapshot.say(f"goal {format_point(goal)} mm")
            self.give_goal(goal, done)

    # --- its state ------------------------------------------------------------------------------------

    def poll(self, now: float) -> None:
        """Give up calls that have waited too long; `now` is a steady clock in [s]."""
        self._enable.expire(now)

    def take_report(self, report: str) -> None:
        """Store the controller's report; show it to the user after a switch by another program."""
        if self._reports_switch and report:
            self._reports_switch = False
            self._snapshot.say(report)
        self._snapshot.change(inverse_note=report if self._snapshot.state.inverse else "")

    def _on_enabled(self, enabled: bool | None) -> None:
        if bool(enabled) == self._snapshot.state.inverse:
            return
        self._snapshot.put(with_inverse(self._snapshot.state, bool(enabled)))
        if enabled is None:
            self._snapshot.say("inverse control has ended; the keys drive the joints again")
        else:
            self._reports_switch = not self._enable.is_busy

    def _on_measured(self, message: PoseStamped) -> None:
        self._measured_at = time.monotonic()
        self._snapshot.change(effector=_pose(message), effector_at=self._measured_at)

    def _on_model(self, message: PoseStamped) -> None:
        now = time.monotonic()
        if now - self._measured_at > STALE_AFTER_S:
            self._snapshot.change(effector=_pose(message), effector_at=now)

    def _on_goal(self, message: PoseStamped) -> None:
        if self._snapshot.state.inverse:
            self._snapshot.change(heard_goal=_pose(message))


def _pose(message: PoseStamped) -> EffectorPose:
    place, turn = message.pose.position, message.pose.orientation
    return EffectorPose((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
