"""A goal of FollowJointTrajectory: its tolerances, and whether a trajectory keeps them to its end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final, NamedTuple

import numpy as np

from softsim_core.actuation.trajectory import JointTrajectory
from softsim_core.arrays import Array
from softsim_core.errors import CommandError
from softsim_core.scene.catalog import MOST_NAMES, names_up_to
from softsim_core.scene.joint import JointDescription
from softsim_ros.description.controllers import GOAL_TIME, GOAL_TOLERANCE
from softsim_ros.simulator.commanded import Progress

ANY: Final = np.inf
"""A tolerance that nothing is outside of."""

ROUNDING_S: Final = 1e-9
"""Times of steps are sums, and rounded by less than this, in [s]."""


class End(Enum):
    """How a goal ended."""

    REACHED = "reached"
    LEFT_PATH = "left its path"
    MISSED = "missed the goal"
    GIVEN_UP = "given up"


class Outcome(NamedTuple):
    """How a goal ended, and a sentence about it."""

    end: End
    sentence: str


class Band(NamedTuple):
    """How far the k joints of a trajectory may be from it: in [rad] or [m], and a second; shapes (k,)."""

    position: Array
    velocity: Array


@dataclass(frozen=True, eq=False)
class FollowedGoal:
    """A goal on its way; a Follower of its trajectory.

    Attributes:
        trajectory: Where the joints go.
        units: Units of the joints' positions, for sentences, such as ("rad", "m").
        path: What holds on the way.
        goal: What has to hold at the end.
        goal_time: So long after its end the joints may be on their way, in [s]; ANY: as long as it takes.
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
        """Judge a step; True: the goal has ended."""
        self.on_progress(progress)
        outcome = self.judge(progress)
        if outcome is not None:
            self.on_end(outcome)
        return outcome is not None

    def give_up(self, reason: str) -> None:
        """The trajectory ended before its time."""
        self.on_end(Outcome(End.GIVEN_UP, f"goal given up: {reason}; the joints stay where they were told"))

    def judge(self, progress: Progress) -> Outcome | None:
        """How the goal ends with this step; None while it goes on."""
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
        """What is wrong first, in words; empty where all joints are inside."""
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
    """The goal of a message.

    As in ros2_control a tolerance of 0 stands for the default, a negative one for none: on the way nothing
    is asked by default, at the end GOAL_TOLERANCE of joints that are told in rad or m, after GOAL_TIME.

    Args:
        goal: A control_msgs/FollowJointTrajectory goal.
        trajectory: Its trajectory.
        joints: All joints of the robot.

    Raises:
        CommandError: it is for several degrees of freedom a joint, or has a tolerance that cannot be kept.
    """
    if goal.multi_dof_trajectory.joint_names or goal.multi_dof_trajectory.points:
        raise _refused("multi_dof_trajectory is not obeyed; leave it empty")
    if goal.component_path_tolerance or goal.component_goal_tolerance:
        raise _refused(
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
    """Refuse a goal that lies beyond the joints' limits by more than its tolerance: it would never end.

    Raises:
        CommandError: it does.
    """
    for name, position, tolerance in zip(
        goal.trajectory.joints, goal.trajectory.positions[-1], goal.goal.position, strict=True
    ):
        limits = next(joint.limits for joint in joints if joint.name == name)
        if abs(position - limits.clamp(float(position))) > tolerance:
            raise _refused(
                f"its last way point, {position:g}, is beyond the limits of joint {name}, "
                f"[{limits.lower:g}, {limits.upper:g}]"
            )


def _band(what: str, tolerances: Sequence[Any], joints: Sequence[JointDescription], position: Array) -> Band:
    """The default positions, shape (k,), with what a message asks for in their place."""
    names = [joint.name for joint in joints]
    position, velocity = position.copy(), np.full(len(joints), ANY)
    if len(tolerances) > len(joints):
        raise _refused(f"{what} has {len(tolerances)} entries for {len(joints)} joints")
    for each in tolerances:
        if each.name not in names:
            known = names_up_to(MOST_NAMES, names)
            raise _refused(f"{what} names {names_up_to(1, [each.name])}, the trajectory moves {known}")
        if not np.isfinite([each.position, each.velocity, each.acceleration]).all():
            raise _refused(f"{what} of {each.name} is not finite; 0 stands for the default, -1 for none")
        joint = names.index(each.name)
        if each.acceleration > 0.0 or (each.velocity > 0.0 and joints[joint].by_effort):
            unknown = "accelerations" if each.acceleration > 0.0 else "velocities"
            raise _refused(f"{what} of {each.name}: its {unknown} are not measured; leave them 0")
        for values, wish in ((position, each.position), (velocity, each.velocity)):
            if wish:
                values[joint] = wish if wish > 0.0 else ANY
    return Band(position, velocity)


def _refused(problem: str) -> CommandError:
    return CommandError(f"trajectory refused: {problem}; nothing was moved")
