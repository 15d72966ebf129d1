"""Client of the joints: positions, requests, limits, commands and trajectories."""

from __future__ import annotations

import math
import time
import warnings
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from builtin_interfaces.msg import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from softsim_core.base import CommandError, Unit, listing
from softsim_core.physics.mechanics import check_command
from softsim_core.scene import JointDescription, RobotDescription
from softsim_node import MEASURED, NEWEST_ONLY
from softsim_ros import JointReader
from softsim_ros.client.services import Done, Outcome, ignore_outcome, report
from softsim_ros.client.state import (
    REACHED,
    STALE_AFTER_S,
    RobotSnapshot,
    RobotState,
    commandable,
    enforces_limits,
    stationary_commands,
    with_command,
    with_measurement,
    with_received_command,
)
from softsim_ros.messages import time_message

INVERSE_OWNS = "nothing moved: inverse control drives the joints; press its key again to take over"
NOT_RECEIVED = "nothing moved: no node receives position_controller/commands yet"


@dataclass(frozen=True, slots=True)
class StepJoints:
    """Request to move some joints `by` [rad] or [m]: one number for all, or one for each.

    They move from their last commands, or from where something else has moved them since.
    """

    joints: tuple[str, ...]
    by: float | tuple[float, ...]


@dataclass(frozen=True, slots=True)
class GoToPose:
    """Request to move all joints to a named pose."""

    pose: str


@dataclass(frozen=True, slots=True)
class MoveJoint:
    """Request to move one joint to a position in [rad] or [m]."""

    joint: str
    position: float


@dataclass(frozen=True, slots=True)
class MoveAll:
    """Request to move all joints to positions in [rad] or [m], in joint order."""

    positions: tuple[float, ...]


JointRequest: TypeAlias = StepJoints | GoToPose | MoveJoint | MoveAll


class Decision(NamedTuple):
    """Result of a request: the state after it, a message, and the command (None: nothing moves)."""

    state: RobotState
    message: str
    values: tuple[float, ...] | None


def decide(state: RobotState, robot: RobotDescription, request: JointRequest, now: float) -> Decision:
    """Return what to command for a request; joints that it does not name stay.

    Args:
        state: State before the request.
        robot: Joints, limits, poses.
        request: Requested motion; positions beyond an enforced limit are clamped to it.
        now: Steady clock in [s].
    """
    refusal = unknown_name(robot, request) or refusal_to_move(state, now)
    if refusal:
        return Decision(state, refusal, None)
    names: Sequence[str] = robot.joint_names
    if isinstance(request, GoToPose):
        return _command(state, robot, robot.poses[request.pose], names, f"pose {request.pose}", now)
    if isinstance(request, MoveAll):
        return _command(state, robot, request.positions, names, "all joints by command", now)
    to = dict(zip(names, stationary_commands(commandable(state, robot), now), strict=True))
    if isinstance(request, MoveJoint):
        to[request.joint] = request.position
        return _command(state, robot, tuple(to.values()), (request.joint,), f"{request.joint} by slider", now)
    moved = [joint for joint in robot.joints if joint.name in request.joints]
    by = request.by if isinstance(request.by, tuple) else (request.by,) * len(request.joints)
    to |= {joint: to[joint] + step for joint, step in zip(request.joints, by, strict=True)}
    title = ", ".join(f"{joint.name} to {format_command(joint, to[joint.name])}" for joint in moved)
    return _command(state, robot, tuple(to.values()), request.joints, title, now)


def refusal_to_move(state: RobotState, now: float) -> str:
    """Return why no joint may be commanded at `now` in [s]; an empty string if commands are allowed."""
    if state.measured is None:
        return "nothing moved: no joint_states received yet; is the simulator running?"
    if not state.is_fresh(now):
        if state.paused:
            return "nothing moved: the simulation is paused; press the pause key again to continue"
        return (
            f"nothing moved: no joint_states for {now - state.measured_at:.0f} s; is the simulator running?"
        )
    if state.inverse:
        return INVERSE_OWNS
    return ""


def unknown_name(robot: RobotDescription, request: JointRequest) -> str:
    """Return a message about a joint or pose that the robot does not have; an empty string if it has all."""
    if isinstance(request, GoToPose):
        what, unknown, known_names = "pose", {request.pose} - robot.poses.keys(), tuple(robot.poses)
    elif isinstance(request, MoveAll):
        return ""
    else:
        joints = request.joints if isinstance(request, StepJoints) else (request.joint,)
        what, unknown, known_names = "joint", set(joints) - set(robot.joint_names), robot.joint_names
    if not unknown:
        return ""
    return f"nothing moved: unknown {what} {listing(sorted(unknown))}; known: {listing(known_names)}"


def _command(
    state: RobotState,
    robot: RobotDescription,
    positions: Sequence[float],
    moved: Sequence[str],
    title: str,
    now: float,
) -> Decision:
    try:  # answers the caller at once; the simulator, another process, checks what it receives
        check_command(positions, robot.joint_names)
    except CommandError as error:
        return Decision(state, str(error), None)
    values, stopped = tuple(positions), list[str]()
    if enforces_limits(state, robot):
        values = tuple(
            joint.limits.clamp(value) for joint, value in zip(robot.joints, positions, strict=True)
        )
        for joint, before, value in zip(robot.joints, positions, values, strict=True):
            if joint.name in moved and value != before:
                limit = "lower" if value == joint.limits.lower else "upper"
                stopped.append(f"{joint.name} stops at its {limit} limit {format_command(joint, value)}")
    message = listing(stopped) if stopped else title
    return Decision(with_command(state, robot, values, now, own=True), message, values)


def format_position(joint: JointDescription, position: float) -> str:
    """Return a joint position as text: "-1.4965 rad (-85.7 deg)" or "0.0123 m (12.3 mm)"."""
    return _format_in_unit(position, joint.units.position)


def format_command(joint: JointDescription, command: float) -> str:
    """Return a command as text: as a position, or "2000 Pa (2.0 kPa)"."""
    return _format_in_unit(command, joint.units.command)


def _format_in_unit(value: float, unit: Unit) -> str:
    value = round(value, 3 - round(math.log10(unit.step))) + 0.0  # no rounding errors, no -0
    digits = f"{value:.4f}" if unit.si in ("rad", "m") else f"{value:.4g}"
    return f"{digits} {unit.si} ({value * unit.per_si:.1f} {unit.shown})"


HOLD_INTERVAL_S: Final = 0.2
"""Period in [s] at which the newest command is repeated on a robot without simulator."""


class Joints:
    """Follows and commands the joints of the node's namespace; `simulated` returns whether it is simulated.

    Published topics: `position_controller/commands`, `joint_trajectory`. Subscribed topics:
    `position_controller/commands`, to see the commands of others; `joint_states`, or `applied_joint_states`
    of the bridge on a robot without simulator; `emulated_board/pulse_widths`. Without simulator the newest
    command is repeated, since the bridge goes to rest when commands stop.
    """

    def __init__(self, node: Node, snapshot: RobotSnapshot, simulated: Callable[[], bool]) -> None:
        self._snapshot, self._simulated = snapshot, simulated
        self._reader = JointReader(snapshot.robot.joints, snapshot.say)
        self._states_at = self._repeated_at = -math.inf
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

    def step(self, joints: Sequence[str], by: float, done: Done = ignore_outcome) -> None:
        """Move joints `by` [rad] or [m] from where they are; the others stay."""
        self.apply_request(StepJoints(tuple(joints), by), done)

    def move(self, joint: str, position: float, done: Done = ignore_outcome) -> None:
        """Command a joint to a position in [rad] or [m]; the others stay."""
        self.apply_request(MoveJoint(joint, position), done)

    def go_to(self, pose: str, done: Done = ignore_outcome) -> None:
        """Command all joints to a pose of the robot's file."""
        self.apply_request(GoToPose(pose), done)

    def command(self, positions: Sequence[float], done: Done = ignore_outcome) -> None:
        """Command all joints to positions in [rad] or [m], in joint order."""
        self.apply_request(MoveAll(tuple(positions)), done)

    def apply_request(self, request: JointRequest, done: Done = ignore_outcome) -> None:
        """Publish the command for a request, within the limits; report the motion or the refusal."""
        now = time.monotonic()
        decision = decide(self._snapshot.state, self._snapshot.robot, request, now)
        if decision.values is not None and not self.are_commanded:
            decision = Decision(self._snapshot.state, NOT_RECEIVED, None)
        self._snapshot.put(decision.state)
        self._snapshot.say(decision.message)
        if decision.values is not None:
            self._publish(decision.values)
        done(Outcome(decision.values is not None, decision.message))

    def obey(self, request: JointRequest, done: Done = ignore_outcome) -> None:
        """Call `apply_request`; former name, until release 0.3.0."""
        message = "Joints.obey is now Joints.apply_request; release 0.3.0 removes the former name"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        self.apply_request(request, done)

    def follow(
        self,
        way_points: Sequence[tuple[float, Mapping[str, float]]],
        done: Done = ignore_outcome,
        *,
        begin_s: float = 0.0,
    ) -> None:
        """Send the simulator a trajectory of way points within the joint limits; a command ends it.

        Args:
            way_points: Times from the start in [s], with positions in [rad] or [m] by joint: the same joints
                at each.
            done: Called with the outcome: the trajectory was sent, or why not.
            begin_s: Time of the start in [s], on the clock that stamps the joint states; 0: on arrival.
        """
        if refusal := self._why_not_followed(way_points):
            report(Outcome(False, refusal), self._snapshot.say, done)
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
        if self._snapshot.state.inverse:
            return INVERSE_OWNS
        if not self.are_followed:
            return "nothing moved: no simulator follows joint_trajectory here"
        named = [set(positions) for _, positions in way_points]
        if not named or not named[0] or any(names != named[0] for names in named):
            return "nothing moved: give at least one way point, and positions of the same joints at each"
        return ""

    @property
    def are_followed(self) -> bool:
        """Whether a node follows trajectories."""
        return bool(self._trajectories.get_subscription_count() > 0)

    @property
    def are_commanded(self) -> bool:
        """Whether another node receives commands; what is published before that is lost."""
        return bool(self._commands.get_subscription_count() > 1)  # the first is our own

    def are_there(self) -> bool:
        """Return whether the joints have reached the newest command."""
        state = commandable(self._snapshot.state, self._snapshot.robot)
        if state.commanded is None or state.measured is None:
            return False
        return all(abs(a - b) <= REACHED for a, b in zip(state.measured, state.commanded, strict=True))

    # --- their state ----------------------------------------------------------------------------------

    def forget(self) -> None:
        """Reset the state of the joints after another robot has been loaded."""
        self._reader = JointReader(self._snapshot.robot.joints, self._snapshot.say)
        self._snapshot.change(measured=None, commanded=None, measured_at=-math.inf, efforts=())

    def expect(self, pose: str) -> None:
        """Record that the simulator itself moves the joints to a pose."""
        snapshot = self._snapshot
        if snapshot.state.measured is not None:
            values = tuple(snapshot.robot.poses[pose])
            snapshot.put(with_command(snapshot.state, snapshot.robot, values, time.monotonic()))

    def poll(self, now: float) -> None:
        """On a robot without simulator, repeat our command while it is the newest.

        The bridge takes a pause without commands as the end of control.
        """
        state = self._snapshot.state
        own = state.commanded if state.owns_command and not state.inverse else None
        if not self._is_bare(now):
            return
        if state.bridge != "comm":
            if state.commanded is not None:  # a later start begins from the servos' positions
                self._snapshot.change(commanded=None)
        elif own is not None and now - self._repeated_at >= HOLD_INTERVAL_S:
            self._repeated_at = now
            self._publish(own)

    def _is_bare(self, now: float) -> bool:
        """Return whether only the bridge's applied positions arrive: no simulator, no measured joints."""
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
        positions, efforts = self._reader.positions(message), self._reader.efforts(message)
        if positions is None:
            return
        before, measured_efforts = self._snapshot.state, () if efforts is None else efforts.tolist()
        state = with_measurement(before, positions.tolist(), time.monotonic(), measured_efforts)
        if state is before:
            self._snapshot.say("a joint position that is not a finite number arrived and was ignored")
        self._snapshot.put(state)

    def _on_command(self, message: Float64MultiArray) -> None:
        snapshot = self._snapshot
        snapshot.put(with_received_command(snapshot.state, snapshot.robot, message.data, time.monotonic()))

    def _on_pulses(self, message: Float64MultiArray) -> None:
        self._snapshot.change(pulses_us=tuple(message.data), pulses_at=time.monotonic())
