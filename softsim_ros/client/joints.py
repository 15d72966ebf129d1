"""The joints: where they are, what they were told, commands and trajectories within their limits."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from builtin_interfaces.msg import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from softsim_ros.client.known import Known
from softsim_ros.client.services import Done, Outcome, unheeded
from softsim_ros.client.state import (
    REACHED,
    STALE_AFTER_S,
    commandable,
    with_command,
    with_heard_command,
    with_measurement,
)
from softsim_ros.client.wishes import INVERSE_OWNS, GoToPose, MoveAll, MoveJoint, StepJoints, Wish, decide
from softsim_ros.messages import time_message
from softsim_ros.qos import MEASURED, NEWEST_ONLY

HOLD_INTERVAL_S: Final = 0.2
"""On a robot without simulator the newest command is repeated after this long, in [s]."""


class Joints:
    """Follows and commands the joints of the node's namespace.

    Topics: `position_controller/commands` out, and in again to see the commands of others;
    `joint_trajectory` out; `joint_states` in, or, on a robot without simulator, `applied_joint_states` of the
    bridge, and then the newest command is repeated so that the bridge does not rest;
    `emulated_board/pulse_widths` in.

    Args:
        node: The node whose executor delivers the messages.
        known: Where the positions are kept.
        simulated: Whether a simulator has been found.
    """

    def __init__(self, node: Node, known: Known, simulated: Callable[[], bool]) -> None:
        self._known, self._simulated = known, simulated
        self._order: tuple[tuple[str, ...], list[int] | None] = ((), None)
        self._states_at = self._held_at = -math.inf
        commands = "position_controller/commands"
        self._commands = node.create_publisher(Float64MultiArray, commands, NEWEST_ONLY)
        self._trajectories = node.create_publisher(JointTrajectory, "joint_trajectory", NEWEST_ONLY)
        node.create_subscription(Float64MultiArray, commands, self._on_command, NEWEST_ONLY)
        node.create_subscription(JointState, "joint_states", self._on_states, MEASURED)
        node.create_subscription(JointState, "applied_joint_states", self._on_applied, MEASURED)
        node.create_subscription(
            Float64MultiArray, "emulated_board/pulse_widths", self._on_pulses, NEWEST_ONLY
        )

    # --- actions --------------------------------------------------------------------------------------

    def step(self, joints: Sequence[str], by: float, done: Done = unheeded) -> None:
        """Move joints `by` [rad] or [m] from where they are; the others hold."""
        self.obey(StepJoints(tuple(joints), by), done)

    def move(self, joint: str, position: float, done: Done = unheeded) -> None:
        """Ask a joint to a position in [rad] or [m]; the others hold."""
        self.obey(MoveJoint(joint, position), done)

    def go_to(self, pose: str, done: Done = unheeded) -> None:
        """Go to a pose of the robot's file."""
        self.obey(GoToPose(pose), done)

    def command(self, positions: Sequence[float], done: Done = unheeded) -> None:
        """Ask all joints to positions in [rad] or [m], joint order."""
        self.obey(MoveAll(tuple(positions)), done)

    def obey(self, wish: Wish, done: Done = unheeded) -> None:
        """Publish what a wish asks for, within the limits, and say what was done or why nothing was."""
        now = time.monotonic()
        decision = decide(self._known.state, self._known.robot, wish, now)
        self._known.put(decision.state)
        self._known.say(decision.sentence)
        if decision.values is not None:
            self._publish(decision.values)
        done(Outcome(decision.values is not None, decision.sentence))

    def follow(
        self,
        way_points: Sequence[tuple[float, Mapping[str, float]]],
        done: Done = unheeded,
        *,
        begin_s: float = 0.0,
    ) -> None:
        """Have the simulator move joints along way points, within their limits; a command ends it.

        Args:
            way_points: Times from the start in [s], with positions in [rad] or [m] by joint: the same joints
                at each.
            done: Called with the end: they were sent, or why not.
            begin_s: Time of the start in [s], on the clock that stamps the joint states; 0: on arrival.
        """
        refusal = self._why_not_followed(way_points)
        if refusal:
            self._known.say(refusal)
            done(Outcome(False, refusal))
            return
        names = list(way_points[0][1])
        message = JointTrajectory(joint_names=names)
        message.header.stamp = time_message(begin_s)
        message.points = [
            JointTrajectoryPoint(
                positions=[positions[name] for name in names],
                time_from_start=Duration(sec=int(time_s), nanosec=round(1e9 * (time_s - int(time_s)))),
            )
            for time_s, positions in way_points
        ]
        self._trajectories.publish(message)
        done(Outcome(True, ""))

    def _why_not_followed(self, way_points: Sequence[tuple[float, Mapping[str, float]]]) -> str:
        if self._known.state.inverse:
            return INVERSE_OWNS
        if not self.are_followed:
            return "nothing moved: no simulator follows joint_trajectory here"
        named = [set(positions) for _, positions in way_points]
        if not named or not named[0] or any(names != named[0] for names in named):
            return "nothing moved: give at least one way point, and positions of the same joints at each"
        return ""

    @property
    def are_followed(self) -> bool:
        """Whether somebody follows trajectories."""
        return bool(self._trajectories.get_subscription_count() > 0)

    def are_there(self) -> bool:
        """Whether the joints stand at the newest command."""
        state = commandable(self._known.state, self._known.robot)
        if state.commanded is None or state.measured is None:
            return False
        return all(abs(a - b) <= REACHED for a, b in zip(state.measured, state.commanded, strict=True))

    # --- what they do ---------------------------------------------------------------------------------

    def forget(self) -> None:
        """Another robot has begun: nothing of the old one's joints holds."""
        self._order = ((), None)
        self._known.change(measured=None, commanded=None, measured_at=-math.inf, efforts=())

    def expect(self, pose: str) -> None:
        """The simulator moves the joints to a pose by itself."""
        known = self._known
        if known.state.measured is not None:
            values = tuple(known.robot.poses[pose])
            known.put(with_command(known.state, known.robot, values, time.monotonic()))

    def poll(self, now: float) -> None:
        """On a bare robot, repeat our command while it is the newest: to the bridge silence is the end."""
        state = self._known.state
        own = state.commanded if state.owns_command and not state.inverse else None
        if not self._is_bare(now):
            return
        if state.bridge != "comm":
            if state.commanded is not None:  # a new start begins where the servos are
                self._known.change(commanded=None)
        elif own is not None and now - self._held_at >= HOLD_INTERVAL_S:
            self._held_at = now
            self._publish(own)

    def _is_bare(self, now: float) -> bool:
        """No simulator, and nobody measures joints: only what the bridge applied is known."""
        return now - self._states_at > STALE_AFTER_S and not self._simulated()

    def _publish(self, values: Sequence[float]) -> None:
        self._commands.publish(Float64MultiArray(data=array("d", values)))

    def _on_states(self, message: JointState) -> None:
        self._states_at = time.monotonic()
        self._measure(message)

    def _on_applied(self, message: JointState) -> None:
        if self._is_bare(time.monotonic()):
            self._measure(message)

    def _measure(self, message: JointState) -> None:
        names = tuple(message.name)
        if names != self._order[0]:
            self._order = (names, self._order_of(names))
        order = self._order[1]
        if order is None or len(message.position) != len(names):
            return
        positions = [message.position[index] for index in order]
        efforts = [message.effort[index] for index in order] if len(message.effort) == len(names) else ()
        before = self._known.state
        state = with_measurement(before, positions, time.monotonic(), efforts)
        if state is before:
            self._known.say("a joint position that is not a finite number arrived and was ignored")
        self._known.put(state)

    def _order_of(self, names: Sequence[str]) -> list[int] | None:
        missing = [joint for joint in self._known.robot.joint_names if joint not in names]
        if missing:
            found = ", ".join(names) or "it"
            self._known.say(f"joint_states of another robot: {', '.join(missing)} not in {found}")
            return None
        return [names.index(joint) for joint in self._known.robot.joint_names]

    def _on_command(self, message: Float64MultiArray) -> None:
        known = self._known
        known.put(with_heard_command(known.state, known.robot, message.data, time.monotonic()))

    def _on_pulses(self, message: Float64MultiArray) -> None:
        self._known.change(pulses_us=tuple(message.data), pulses_at=time.monotonic())
