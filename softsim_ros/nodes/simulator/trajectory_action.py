"""The action FollowJointTrajectory of the simulator: goals, tolerances, progress and results."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration, Time
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from rclpy.exceptions import InvalidHandle
from trajectory_msgs.msg import JointTrajectoryPoint

from softsim_core.base import MOST_NAMES, Array, CommandError, names_up_to
from softsim_core.physics.actuation import JointTrajectory
from softsim_core.scene import JointDescription
from softsim_node import GuardedNode
from softsim_ros import StateListener, optional_type
from softsim_ros.description import CONTROLLER, GOAL_TIME, GOAL_TOLERANCE
from softsim_ros.messages import message_array, time_message
from softsim_ros.nodes.simulator.monitor import RateGate
from softsim_ros.nodes.simulator.physics_thread import PhysicsThread
from softsim_ros.nodes.simulator.setpoints import Progress, trajectory_command, trajectory_delay

ANY: Final = np.inf
"""Tolerance that everything satisfies."""

ROUNDING_S: Final = 1e-9
"""Bound in [s] of the rounding error of times, which are sums of steps."""


class End(Enum):
    """How a goal ended."""

    REACHED = "reached"
    LEFT_PATH = "left its path"
    MISSED = "missed the goal"
    GIVEN_UP = "given up"


class Outcome(NamedTuple):
    """How a goal ended, with a message about it."""

    end: End
    message: str


class Band(NamedTuple):
    """Tolerances of the k joints of a trajectory, shapes (k,).

    Positions are in [rad] or [m], velocities per second.
    """

    position: Array
    velocity: Array


@dataclass(frozen=True, eq=False)
class FollowedGoal:
    """An active goal; implements Follower for its trajectory.

    Attributes:
        trajectory: Where the joints go.
        units: Units of the joints' positions, for messages, such as ("rad", "m").
        path: Tolerances while the trajectory runs.
        goal: Tolerances at its end.
        goal_time: How long after its end the joints may take to arrive, in [s]; ANY: as long as it takes.
        on_progress: Called after each step.
        on_end: Called once, from any thread.
    """

    trajectory: JointTrajectory
    units: Sequence[str]
    path: Band
    goal: Band
    goal_time: float
    on_progress: Callable[[Progress], object] = field(default=lambda progress: None)
    on_end: Callable[[Outcome], object] = field(default=lambda outcome: None)

    def follow(self, progress: Progress) -> bool:
        """Compare a step with the tolerances; return True if the goal has ended."""
        self.on_progress(progress)
        outcome = self.outcome_of(progress)
        if outcome is not None:
            self.on_end(outcome)
        return outcome is not None

    def give_up(self, reason: str) -> None:
        """Report that the trajectory ended early."""
        message = f"goal abandoned: {reason}; the joints stay at their last commands"
        self.on_end(Outcome(End.GIVEN_UP, message))

    def outcome_of(self, progress: Progress) -> Outcome | None:
        """Return how the goal ends with this step; None if it continues."""
        trajectory, elapsed = self.trajectory, progress.elapsed
        if not trajectory.is_over(elapsed):
            outside = self._outside(self.path, progress)
            return Outcome(End.LEFT_PATH, f"path tolerance violated: {outside}") if outside else None
        outside = self._outside(self.goal, progress)
        if not outside:
            return Outcome(End.REACHED, "goal reached")
        if elapsed > trajectory.duration + self.goal_time + ROUNDING_S:
            return Outcome(End.MISSED, f"goal tolerance violated: {outside}")
        return None

    def _outside(self, band: Band, progress: Progress) -> str:
        """Return a message about the first violated tolerance; an empty string if there is none."""
        rows = (
            (progress.actual - progress.desired, band.position, ""),
            (progress.actual_velocities - progress.desired_velocities, band.velocity, "/s"),
        )
        for errors, allowed, rate in rows:
            beyond = np.flatnonzero(np.abs(errors) > allowed)
            if len(beyond):
                worst = beyond[0]
                unit = f"{self.units[worst]}{rate}"
                return (
                    f"joint {self.trajectory.joints[worst]} is {abs(errors[worst]):.3g} {unit} from its "
                    f"trajectory after {progress.elapsed:.2f} s, allowed are {allowed[worst]:g} {unit}"
                )
        return ""


def followed_goal(goal: Any, trajectory: JointTrajectory, joints: Sequence[JointDescription]) -> FollowedGoal:
    """Return the goal that a control_msgs/FollowJointTrajectory goal asks of a robot's joints.

    As in ros2_control a tolerance of 0 stands for the default, and a negative one for none. By default
    nothing is checked on the way; at the end, joints commanded in rad or m must be within GOAL_TOLERANCE
    after GOAL_TIME.

    Raises:
        CommandError: it addresses joints with several degrees of freedom, or has a tolerance that cannot be
            met.
    """
    if goal.multi_dof_trajectory.joint_names or goal.multi_dof_trajectory.points:
        raise _refusal_of("multi_dof_trajectory is not supported; leave it empty")
    if goal.component_path_tolerance or goal.component_goal_tolerance:
        raise _refusal_of(
            "component tolerances belong to joints of several degrees of freedom; leave them empty"
        )
    moved = [next(joint for joint in joints if joint.name == name) for name in trajectory.joints]
    units = [joint.units.command.si for joint in moved]
    at_end = np.array([GOAL_TOLERANCE if unit in ("rad", "m") else ANY for unit in units])
    asked = goal.goal_time_tolerance.sec + 1e-9 * goal.goal_time_tolerance.nanosec
    wait = asked if asked else GOAL_TIME
    return FollowedGoal(
        trajectory,
        units,
        _band("path_tolerance", goal.path_tolerance, moved, np.full(len(moved), ANY)),
        _band("goal_tolerance", goal.goal_tolerance, moved, at_end),
        wait if wait > 0.0 else ANY,
    )


def check_reachable(goal: FollowedGoal, joints: Sequence[JointDescription]) -> None:
    """Refuse a goal that lies beyond the joints' limits by more than its tolerance, since it would never end.

    Raises:
        CommandError: it does.
    """
    for name, position, tolerance in zip(
        goal.trajectory.joints, goal.trajectory.positions[-1], goal.goal.position, strict=True
    ):
        limits = next(joint.limits for joint in joints if joint.name == name)
        if abs(position - limits.clamp(float(position))) > tolerance:
            raise _refusal_of(
                f"its last way point, {position:g}, is beyond the limits of joint {name}, "
                f"[{limits.lower:g}, {limits.upper:g}]"
            )


def _band(what: str, tolerances: Sequence[Any], joints: Sequence[JointDescription], position: Array) -> Band:
    """Return the default tolerances, replaced by those that a message asks for.

    Default positions have shape (k,); velocities have no default tolerance.
    """
    names = [joint.name for joint in joints]
    position, velocity = position.copy(), np.full(len(joints), ANY)
    if len(tolerances) > len(joints):
        raise _refusal_of(f"{what} has {len(tolerances)} entries for {len(joints)} joints")
    for each in tolerances:
        if each.name not in names:
            moved_names = names_up_to(MOST_NAMES, names)
            raise _refusal_of(
                f"{what} names {names_up_to(1, [each.name])}, the trajectory moves {moved_names}"
            )
        if not np.isfinite([each.position, each.velocity, each.acceleration]).all():
            raise _refusal_of(f"{what} of {each.name} is not finite; 0 stands for the default, -1 for none")
        joint = names.index(each.name)
        if each.acceleration > 0.0 or (each.velocity > 0.0 and joints[joint].by_effort):
            unknown = "accelerations" if each.acceleration > 0.0 else "velocities"
            raise _refusal_of(f"{what} of {each.name}: its {unknown} are not measured; leave them 0")
        for values, tolerance in ((position, each.position), (velocity, each.velocity)):
            if tolerance:
                values[joint] = tolerance if tolerance > 0.0 else ANY
    return Band(position, velocity)


def _refusal_of(problem: str) -> CommandError:
    return CommandError(f"trajectory refused: {problem}; nothing was moved")


ACTION: Final = f"{CONTROLLER}/follow_joint_trajectory"
FEEDBACK_PERIOD_S: Final = 0.05
"""Shortest period of feedback in [s]: the 20 Hz of ros2_control's controller."""

RESULT_STORED_S: Final = 60
"""How long a result is available to a client that asks late, in [s]."""


class TrajectoryAction:
    """Accepts goals for one trajectory at a time; a new goal replaces the present one.

    A goal is aborted with a message when another command takes over, at a pause, a reset, another scene or a
    fault, and when the bridge's e-stop latches. While ros2_control's controller runs in the same namespace
    goals are left to it.

    Args:
        now_s: Returns the current time in [s], on the clock of the stamps.
    """

    def __init__(self, node: GuardedNode, physics: PhysicsThread, now_s: Callable[[], float]) -> None:
        self._node, self._physics, self._now_s = node, physics, now_s
        self._type = optional_type("control_msgs.action", "FollowJointTrajectory")
        self._server: _Server | None = None
        self._checked: tuple[FollowedGoal, float] | None = None
        self._current: tuple[ServerGoalHandle, FollowedGoal] | None = None
        if self._type is not None:
            self._e_stop = StateListener(node, "servo_bridge/e_stop_latched", self._on_e_stop)
            self.look()

    def look(self) -> None:
        """Offer the action unless ros2_control's controller is present; call this periodically."""
        if self._type is None:
            return
        taken = self._has_controller()
        if taken and self._current is not None:
            self._leave(f"{CONTROLLER} is there now")  # look() runs again once its client has the result
        elif taken and self._server is not None:
            self.close()
            self._node.get_logger().info(f"{CONTROLLER} is there: the action {ACTION} is left to it")
        elif not taken and self._server is None:
            self._server = _Server(self._node, self._type, self._decide, self._begin, self._on_cancel)

    def close(self) -> None:
        """Stop offering the action; a second call does nothing."""
        if self._server is not None:
            self._server.destroy()
            self._server = None

    def _has_controller(self) -> bool:
        return (CONTROLLER, self._node.get_namespace()) in self._node.get_node_names_and_namespaces()

    # --- goals ----------------------------------------------------------------------------------------

    def _decide(self, goal: Any) -> GoalResponse:
        with self._node.refusing(f"goal on {ACTION}:"):
            try:
                self._checked = self._check(goal)
                return GoalResponse.ACCEPT
            except CommandError as error:
                self._node.refuse(str(error))
        return GoalResponse.REJECT

    def _check(self, goal: Any) -> tuple[FollowedGoal, float]:
        """Return the goal and the delay in [s] until it begins; a CommandError says why it is rejected."""
        if self._has_controller():
            raise CommandError(f"trajectory refused: {CONTROLLER} is there and takes the goals")
        if self._e_stop.value:
            raise CommandError("trajectory refused: the e-stop is latched; call servo_bridge/clear_e_stop")
        if self._physics.status.paused:
            raise CommandError("trajectory refused: the simulation is paused; nothing was moved")
        joints, limited = self._physics.call(
            lambda simulation: (simulation.robot.joints, simulation.enforce_limits), shows=False
        )
        trajectory = trajectory_command(goal.trajectory, [joint.name for joint in joints])
        delay = trajectory_delay(goal.trajectory, self._now_s())
        followed = followed_goal(goal, trajectory, joints)
        if limited:
            check_reachable(followed, joints)
        return followed, delay

    def _begin(self, handle: ServerGoalHandle) -> None:
        assert self._checked is not None
        assert self._server is not None
        (checked, delay), self._checked = self._checked, None
        gate, server = RateGate(FEEDBACK_PERIOD_S), self._server

        def send_feedback(progress: Progress) -> None:
            if gate.passes(time.monotonic()):
                self._send_feedback(handle, progress, checked.trajectory.joints)

        def forget() -> None:
            if self._current is not None and self._current[0] is handle:
                self._current = None

        goal = replace(
            checked, on_progress=send_feedback, on_end=lambda outcome: server.finish(handle, outcome, forget)
        )
        self._current = (handle, goal)
        handle.execute()
        self._physics.commanded.command(goal.trajectory, delay, goal)

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        if self._current is None or self._current[0] is not handle:
            return CancelResponse.REJECT
        self._leave("it was cancelled")
        return CancelResponse.ACCEPT

    def _on_e_stop(self, latched: bool | None) -> None:
        if latched:
            self._leave("the e-stop was pressed")

    def _leave(self, reason: str) -> None:
        if self._current is not None:
            self._physics.commanded.leave(self._current[1], reason)

    def _send_feedback(self, handle: ServerGoalHandle, progress: Progress, joints: tuple[str, ...]) -> None:
        assert self._type is not None
        desired, actual = progress.desired, progress.actual
        rates, actual_rates = progress.desired_velocities, progress.actual_velocities
        feedback = self._type.Feedback(
            joint_names=joints,
            desired=_point(progress.elapsed, desired, rates),
            actual=_point(progress.elapsed, actual, actual_rates),
            error=_point(progress.elapsed, desired - actual, rates - actual_rates),
        )
        feedback.header.stamp = time_message(self._now_s())
        try:
            handle.publish_feedback(feedback)
        except Exception:
            if self._node.context.ok():
                raise
            # Ctrl-C and SIGTERM invalidate the publishers before this thread can be stopped


class _Server(ActionServer):
    """An action server whose goals end when `finish` is called, from any thread.

    A callback that executed a goal and waited for its end would occupy the executor all the time.
    """

    def __init__(
        self,
        node: GuardedNode,
        kind: Any,
        decide: Callable[[Any], GoalResponse],
        begin: Callable[[ServerGoalHandle], None],
        cancel: Callable[[ServerGoalHandle], CancelResponse],
    ) -> None:
        self._owner, codes = node, kind.Result
        self._ended: deque[tuple[ServerGoalHandle, Outcome, Callable[[], None]]] = deque()
        self._wake = node.create_guard_condition(self._deliver)
        self._codes = {
            End.REACHED: codes.SUCCESSFUL,
            End.LEFT_PATH: codes.PATH_TOLERANCE_VIOLATED,
            End.MISSED: codes.GOAL_TOLERANCE_VIOLATED,
            End.GIVEN_UP: codes.INVALID_GOAL,
        }
        super().__init__(
            node,
            kind,
            ACTION,
            lambda handle: None,
            goal_callback=decide,
            handle_accepted_callback=begin,
            cancel_callback=cancel,
            result_timeout=RESULT_STORED_S,
        )

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Any) -> None:
        """Do nothing when a goal begins: the physics thread executes it."""

    def finish(self, handle: ServerGoalHandle, outcome: Outcome, before: Callable[[], None]) -> None:
        """Call `before` and send the result, in the executor's thread."""
        self._ended.append((handle, outcome, before))
        with suppress(InvalidHandle):  # the node is gone
            self._wake.trigger()

    def destroy(self) -> None:
        """Stop offering the action."""
        self._owner.destroy_guard_condition(self._wake)
        super().destroy()

    def _deliver(self) -> None:
        while self._ended:
            handle, outcome, before = self._ended.popleft()
            before()
            super().notify_execute(handle, partial(self._report, outcome))

    def _report(self, outcome: Outcome, handle: ServerGoalHandle) -> Any:
        if outcome.end is End.REACHED:
            handle.succeed()
        elif handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        return self.action_type.Result(error_code=self._codes[outcome.end], error_string=outcome.message)


def _point(elapsed: float, positions: Array, velocities: Array) -> JointTrajectoryPoint:
    stamp: Time = time_message(elapsed)
    return JointTrajectoryPoint(
        positions=message_array(positions, "d"),
        velocities=message_array(velocities, "d"),
        time_from_start=Duration(sec=stamp.sec, nanosec=stamp.nanosec),
    )
