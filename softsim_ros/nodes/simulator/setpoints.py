"""Set points of the joints in each step: checked commands, trajectories, externally driven joints."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

from softsim_core.base import MOST_NAMES, Array, CommandError, names_up_to
from softsim_core.physics.actuation import JointTrajectory
from softsim_core.physics.mechanics import (
    check_age,
    check_named_command,
    check_positions_only,
    says_something,
)
from softsim_core.simulation import Simulation

MOST_POINTS: Final = 10_000
"""Largest number of way points of a trajectory; each costs time between two steps."""

FARTHEST_START_S: Final = 3600.0
"""Longest delay of a trajectory's start in [s]; a later start means that another clock stamped it."""

LATE_S: Final = 0.5
"""A trajectory that ended at most this long ago, in [s], still moves the joints to its end."""


def seconds(stamp: Time) -> float:
    """Return a time stamp in [s]."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def named_command(message: JointState, joints: Sequence[str], now_s: float) -> dict[str, float]:
    """Return the positions in [rad] or [m] of the joints that a message names, without those that are NaN.

    Args:
        message: In any order, of some joints or all.
        joints: Names of the robot's joints.
        now_s: The current time in [s], on the clock of the stamps.

    Raises:
        CommandError: it is too old, contains more than positions, or `check_named_command` refuses it.
    """
    check_age(seconds(message.header.stamp), now_s)
    check_positions_only(message.velocity, message.effort)
    return check_named_command(message.name, message.position, joints)


def trajectory_delay(message: JointTrajectoryMessage, now_s: float) -> float:
    """Return the delay in [s] until a trajectory starts by its stamp.

    It is negative if the trajectory has started already, and 0 without a stamp.

    Raises:
        CommandError: it is over already, or too far ahead.
    """
    begin = seconds(message.header.stamp)
    delay = begin - now_s if begin else 0.0
    if delay > FARTHEST_START_S:
        raise CommandError(
            f"trajectory refused: by its stamp it begins in {delay:.0f} s; allowed are {FARTHEST_START_S:g}; "
            "use one clock (use_sim_time), or stamp it 0 for now; nothing was moved"
        )
    if begin and message.points and delay + seconds(message.points[-1].time_from_start) < -LATE_S:
        raise CommandError(
            f"trajectory refused: by its stamp it began {-delay:.1f} s ago and is over; use one clock "
            "(use_sim_time), or stamp it 0 for now; nothing was moved"
        )
    return delay


def trajectory_command(message: JointTrajectoryMessage, joints: Sequence[str]) -> JointTrajectory:
    """Return the way points of a message, see `JointTrajectory`.

    Raises:
        CommandError: unknown joints, too many joints or points, wrong lengths, times that do not grow,
            values that are not finite, slopes at some points only, or efforts.
    """
    if len(message.joint_names) > len(joints):
        raise CommandError(
            f"trajectory refused: it names {len(message.joint_names)} joints of one with {len(joints)} "
            f"({names_up_to(MOST_NAMES, joints)}); nothing was moved"
        )
    if len(message.points) > MOST_POINTS:
        raise CommandError(
            f"trajectory refused: it has {len(message.points)} points; send at most {MOST_POINTS} at once; "
            "nothing was moved"
        )
    if any(says_something(point.effort) for point in message.points):
        raise CommandError(
            "trajectory refused: efforts are not supported; leave them empty, or fill them with NaN or 0; "
            "nothing was moved"
        )
    for index, point in enumerate(message.points):
        if len(point.positions) != len(message.joint_names):
            raise CommandError(
                f"trajectory refused: point {index} has {len(point.positions)} positions for "
                f"{len(message.joint_names)} joints; nothing was moved"
            )
    times = [seconds(point.time_from_start) for point in message.points]
    positions = np.array([point.positions for point in message.points], dtype=float)
    trajectory = JointTrajectory(
        message.joint_names,
        times,
        positions.reshape(len(times), len(message.joint_names)),
        _slopes(message, "velocities"),
        _slopes(message, "accelerations"),
    )
    trajectory.check_joints(joints)
    return trajectory


def _slopes(message: JointTrajectoryMessage, field: str) -> Array | None:
    """Return velocities or accelerations of all way points, shape (points, joints); None if none has them."""
    lengths = [len(getattr(point, field)) for point in message.points]
    if not any(lengths):
        return None
    if lengths != [len(message.joint_names)] * len(lengths):
        raise CommandError(
            f"trajectory refused: give {field} of every joint at every point, or none; nothing was moved"
        )
    values = np.array([getattr(point, field) for point in message.points], dtype=float)
    return None if np.isnan(values).all() else values


LONGEST_S: Final = 0.2
"""Longest time in [s] over which positions are interpolated from one message to the next."""


class DrivenJoints:
    """Positions of externally driven joints by name, interpolated from one message to the next.

    A joint moves for as long as the difference between the stamps of the last two messages. Attached bodies
    thus see an even motion, one message late, without a jerk at each message.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: tuple[float, dict[str, float]] | None = None
        self._stamp, self._span, self._spent = -np.inf, 0.0, 0.0
        self._from: dict[str, float] = {}
        self._to: dict[str, float] = {}

    def receive(self, positions: Mapping[str, float], stamp: float) -> None:
        """Store a message with its time stamp in [s]; may be called from any thread."""
        with self._lock:
            self._newest = stamp, dict(positions)

    def advance(self, simulation: Simulation) -> dict[str, float]:
        """Return the positions at the end of the next step of all driven joints that the simulation has.

        Call it from the thread of the simulation.
        """
        with self._lock:
            newest, self._newest = self._newest, None
        if newest is not None:
            stamp, positions = newest
            self._from = {name: self._now(name, there) for name, there in positions.items()}
            self._to = positions
            self._span = min(max(stamp - self._stamp, simulation.dt), LONGEST_S)
            self._stamp, self._spent = stamp, 0.0
        self._spent += simulation.dt
        names = simulation.joint_names
        return {name: self._now(name, there) for name, there in self._to.items() if name in names}

    def _now(self, name: str, there: float) -> float:
        if name not in self._to or name not in self._from:
            return there
        share = min(self._spent / self._span, 1.0) if self._span > 0.0 else 1.0
        return self._from[name] + share * (self._to[name] - self._from[name])


TAKEN_OVER: Final = "another command took over"


@dataclass(frozen=True, eq=False)
class Progress:
    """A step of a trajectory, for the k joints that it names.

    Attributes:
        elapsed: Time since its start in [s], >= 0.
        desired: Desired positions in [rad] or [m], or desired efforts in the unit of an effort-controlled
            joint, shape (k,).
        desired_velocities: Their rates per second, shape (k,).
        actual: Actual positions or efforts, shape (k,).
        actual_velocities: Shape (k,); NaN for efforts, whose rates are not measured.
    """

    elapsed: float
    desired: Array
    desired_velocities: Array
    actual: Array
    actual_velocities: Array


class Follower(Protocol):
    """Observer of a trajectory, for example the goal of an action."""

    def follow(self, progress: Progress) -> bool:
        """Process a step of the trajectory; return True to end it. Called in the physics thread."""
        ...

    def give_up(self, reason: str) -> None:
        """Process an early end, for a reason such as "the simulation was reset"; once, from any thread."""
        ...


@dataclass(frozen=True, eq=False)
class _RunningTrajectory:
    """A trajectory with its follower.

    Once it runs, also its start time in [s] and the command, shape (j,), at that time.
    """

    trajectory: JointTrajectory
    follower: Follower | None
    begin: float = 0.0
    start: Array | None = None


class Commanded:
    """Commands of a simulation's joints: set from any thread, applied in the thread that steps it.

    Args:
        on_refusal: Called in that thread with the message of a refused command.

    Attributes:
        driven: Externally driven joints; they follow their driver, not the commands.
        clamped: Total number of commands that were clamped to the limits.
        refused: Total number of commands that the simulation refused.
    """

    def __init__(self, on_refusal: Callable[[str], None]) -> None:
        self._on_refusal = on_refusal
        self._lock = threading.Lock()
        self._newest: Array | _RunningTrajectory | None = None
        self._named: dict[str, float] = {}  # positions of some joints, which override the newest command
        self._delay = 0.0
        self._trajectory: _RunningTrajectory | None = None
        self._leaving: list[tuple[Follower, str]] = []
        self.driven = DrivenJoints()
        self.clamped = self.refused = 0

    # --- from any thread ------------------------------------------------------------------------------

    def command(
        self, target: Array | JointTrajectory, delay_s: float = 0.0, follower: Follower | None = None
    ) -> None:
        """Command joint positions, shape (j,), or a trajectory from the next step on.

        The newest command replaces earlier ones of either kind.

        Args:
            target: Where to go.
            delay_s: In how many simulated seconds a trajectory begins; < 0: it has begun already.
            follower: Observer of the trajectory.
        """
        newest = _RunningTrajectory(target, follower) if isinstance(target, JointTrajectory) else target
        with self._lock:
            before, self._newest, self._delay = self._newest, newest, delay_s
            self._named.clear()
        _give_up(before, TAKEN_OVER)

    def command_named(self, positions: Mapping[str, float]) -> None:
        """Command positions of some joints by name from the next step on; other commands stay."""
        with self._lock:
            self._named.update(positions)

    def leave(self, follower: Follower, reason: str) -> None:
        """End the trajectory of a follower before the next step, if it has not ended by itself."""
        with self._lock:
            self._leaving.append((follower, reason))

    # --- in the thread that steps ---------------------------------------------------------------------

    @property
    def runs_trajectory(self) -> bool:
        """Whether a trajectory is running."""
        return self._trajectory is not None

    def apply(self, simulation: Simulation) -> None:
        """Send the simulation the commands that are due in the next step."""
        with self._lock:
            newest, self._newest = self._newest, None
            named, self._named, delay = self._named, {}, self._delay
            leaving, self._leaving = self._leaving, []
        try:
            if named:
                self._take_over(None)
                _give_up(newest, TAKEN_OVER)
                self._command(simulation, _laid_over(simulation, newest, named))
            elif isinstance(newest, _RunningTrajectory):
                begin = simulation.time + delay
                self._take_over(replace(newest, begin=begin, start=simulation.joint_targets))
            elif newest is not None:
                self._take_over(None)
                self._command(simulation, newest)
            for follower, reason in leaving:
                if self._trajectory is not None and self._trajectory.follower is follower:
                    self._end(reason)
            self._go_on(simulation)
            if driven := self.driven.advance(simulation):
                simulation.command(_laid_over(simulation, None, _within(simulation, driven)))
        except CommandError as error:
            self._end(str(error))
            self.refused += 1
            self._on_refusal(str(error))

    def follow(self, simulation: Simulation) -> None:
        """Pass the completed step to the follower of the trajectory, if any."""
        running = self._trajectory
        if running is None or running.follower is None or simulation.time < running.begin:
            return
        assert running.start is not None
        elapsed = simulation.time - running.begin
        joints = [simulation.joint_names.index(name) for name in running.trajectory.joints]
        desired, desired_velocities = running.trajectory.between(elapsed, running.start[joints])
        by_effort = np.array([joint.by_effort for joint in simulation.robot.joints])
        actual = np.where(by_effort, simulation.joint_efforts, simulation.joint_positions)
        velocities = np.where(by_effort, np.nan, simulation.joint_velocities)
        progress = Progress(elapsed, desired, desired_velocities, actual[joints], velocities[joints])
        if running.follower.follow(progress):
            self._trajectory = None

    def forget(self, reason: str, whose: Callable[[Follower | None], bool] = lambda follower: True) -> None:
        """Drop earlier commands and trajectories; their followers receive the reason.

        Args:
            reason: Why, such as "the simulation was reset".
            whose: Selects by follower what is dropped; commands and trajectories without a follower have
                None.
        """
        with self._lock:
            newest = self._newest
            dropped = (
                newest if whose(newest.follower if isinstance(newest, _RunningTrajectory) else None) else None
            )
            if dropped is not None:
                self._newest = None
            if whose(None):
                self._named.clear()
        _give_up(dropped, reason)
        if self._trajectory is not None and whose(self._trajectory.follower):
            self._end(reason)

    def _go_on(self, simulation: Simulation) -> None:
        if self._trajectory is None:
            return
        running = self._trajectory
        assert running.start is not None
        elapsed = simulation.time + simulation.dt - running.begin  # targets apply at the end of the step
        if running.follower is None and running.trajectory.is_over(elapsed):
            self._trajectory = None
        if elapsed >= 0.0:
            self._command(
                simulation, running.trajectory.sample(elapsed, running.start, simulation.joint_names)
            )

    def _command(self, simulation: Simulation, values: Array) -> None:
        # It checks again: since the message was checked, a scene with other joints may have been loaded.
        accepted = simulation.command(values)
        self.clamped += not np.array_equal(accepted, values)

    def _take_over(self, running: _RunningTrajectory | None) -> None:
        self._end(TAKEN_OVER)
        self._trajectory = running

    def _end(self, reason: str) -> None:
        running, self._trajectory = self._trajectory, None
        _give_up(running, reason)


def _give_up(dropped: Array | _RunningTrajectory | None, reason: str) -> None:
    if isinstance(dropped, _RunningTrajectory) and dropped.follower is not None:
        dropped.follower.give_up(reason)


def _within(simulation: Simulation, positions: Mapping[str, float]) -> dict[str, float]:
    """Return positions by name, clamped to the limits if the simulation enforces them."""
    if not simulation.enforce_limits:
        return dict(positions)
    limits = {joint.name: joint.limits for joint in simulation.robot.joints}
    return {name: limits[name].clamp(position) for name, position in positions.items()}


def _laid_over(
    simulation: Simulation, newest: Array | _RunningTrajectory | None, named: Mapping[str, float]
) -> Array:
    """Return the targets of all joints, of which `named` override the newest command.

    Where that is no array of positions, they override the present targets.
    """
    targets = np.array(newest) if isinstance(newest, np.ndarray) else simulation.joint_targets
    if simulation.enforce_limits:  # nobody commanded a rest pose beyond them
        targets[:] = [
            joint.limits.clamp(target) for joint, target in zip(simulation.robot.joints, targets, strict=True)
        ]
    for name, position in named.items():
        if name in simulation.joint_names:  # otherwise another scene was loaded since
            targets[simulation.joint_names.index(name)] = position
    return targets
