"""What a model does under the commands of a session: row by row in equilibrium, or in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.errors import NotConvergedError, SolverDivergedError
from softsim_core.identification.description import SensorDescription
from softsim_core.identification.places import Places
from softsim_core.identification.session import Session
from softsim_core.mechanics.state import State
from softsim_core.scene.robot import RobotDescription
from softsim_core.simulation import Simulation

Order: TypeAlias = Literal["nearest", "rows"]
"""Rows so that each command is the nearest of those left, or as they were measured."""

PARTS: Final = (1, 8)
"""A row that is not found from the one before is tried from the start pose: at once, then in many parts."""

CLOSE: Final = 1e-7
"""Rows are at rest where the last of Newton's steps moved nothing by more, in [m]."""

SAME: Final = 1e-9
"""Times that differ by less, in [s], are one: a command acts in the step that begins when it was given."""

Progress: TypeAlias = Callable[[int, int], None]
"""Told what is done, and what there is in all."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What sensors of a session sit on, as the model has it.

    Attributes:
        positions: In [m], shape (k, s, 3); of rows, or of steps of a replay in time.
        rotations: Shape (k, s, 3, 3).
        reached: Whether it was found, shape (k,); a row without an equilibrium has none.
        times: Of the steps of a replay in time in [s], shape (k,); None: these are the session's rows.
        stopped: Whether it was interrupted.
    """

    positions: Array
    rotations: Array
    reached: BoolArray
    times: Array | None = None
    stopped: bool = False

    def at(self, session: Session, delay: float = 0.0) -> tuple[Array, Array, BoolArray]:
        """Positions, rotations and whether they are known, at the rows of a session.

        Args:
            session: That which was replayed.
            delay: By how much its sensors are late, in [s].
        """
        if self.times is None or session.times is None:
            return self.positions, self.rotations, self.reached
        when = session.times - delay
        right = np.clip(np.searchsorted(self.times, when), 1, len(self.times) - 1)
        span = self.times[right] - self.times[right - 1]
        part = np.clip((when - self.times[right - 1]) / span, 0.0, 1.0)[:, None, None]
        positions = (1.0 - part) * self.positions[right - 1] + part * self.positions[right]
        reached = self.reached[right] & (when <= self.times[-1] + span[-1])
        return positions, self.rotations[np.where(part[:, 0, 0] < 0.5, right - 1, right)], reached


Near: TypeAlias = dict[tuple[float, ...], tuple[State, Array]]
"""Equilibria of a model that differs little, and its joints' rest positions (j,), by the joints' command.

The one at the start pose is at `START`: its command is another one where zero is another position.
"""

START: Final = ()


def replay(
    robot: RobotDescription,
    session: Session,
    order: Order = "nearest",
    progress: Progress | None = None,
    near: Near | None = None,
) -> Prediction:
    """Give a model the commands of a session; an interrupt (Ctrl-C) keeps what is done.

    Args:
        robot: The model, the session's overrides laid over it.
        session: The session.
        order: In which its rows are solved; rows in time are played as they are.
        progress: Told rows or steps.
        near: Where rows in equilibrium begin that it knows; it takes over those that are found.

    Raises:
        DataError: the commands do not fit the robot.
        SceneError: the scene cannot be built, or has nothing where a sensor sits.
    """
    commands = session.commands(robot)
    if session.times is not None:
        return _in_time(robot, session, commands, progress)
    return equilibria(robot, session.description.sensors, commands, order, progress, near)


def in_short_steps(points: Array, start: Array) -> IndexArray:
    """An order in which each of points (k, j) is the nearest of those left, from `start` (j,) on."""
    left, here = np.ones(len(points), bool), start
    order = np.zeros(len(points), dtype=np.int64)
    for k in range(len(points)):
        far = np.where(left, ((points - here) ** 2).sum(axis=1), np.inf)
        order[k] = nearest = int(np.argmin(far))
        left[nearest], here = False, points[nearest]
    return order


def equilibria(
    robot: RobotDescription,
    sensors: Sequence[SensorDescription],
    commands: Array,
    order: Order = "nearest",
    progress: Progress | None = None,
    near: Near | None = None,
) -> Prediction:
    """The equilibrium of each different command (k, j), each from the one before; the rest as in `replay`.

    Args:
        robot: The model.
        sensors: What is looked at.
        commands: Of the joints, in [rad], [m] or the joint's own unit, shape (k, j).
        order: In which they are solved.
        progress: Told commands.
        near: See `replay`.

    Raises:
        SceneError: the scene cannot be built, or has nothing where a sensor sits.
    """
    near = {} if near is None else near
    simulation = Simulation(robot.robot_alone())
    places, start = Places(simulation, sensors), np.array(robot.start_joints)
    walk = _Walk(simulation, start, robot.start_shift, near)
    different, same = np.unique(commands, axis=0, return_inverse=True)
    first = np.array([int(np.flatnonzero(same == k)[0]) for k in range(len(different))])
    if order == "nearest":
        sequence = in_short_steps(different, start)
    else:
        sequence = np.argsort(first)
    positions = np.full((len(different), len(sensors), 3), np.nan)
    rotations = np.full((len(different), len(sensors), 3, 3), np.nan)
    stopped = False
    try:
        for done, k in enumerate(sequence.tolist(), start=1):
            command = tuple(different[k].tolist())
            if (found := walk.to(different[k], near.get(command))) is not None:
                near[command] = found, walk.rest
                positions[k], rotations[k] = places.seen(simulation)
            if progress is not None:
                progress(done, len(different))
    except KeyboardInterrupt:
        stopped = True
    same = same.ravel()
    return Prediction(
        positions[same], rotations[same], np.isfinite(positions[same]).all(axis=(1, 2)), None, stopped
    )


class _Walk:
    """Goes from equilibrium to equilibrium; where the next is not found from the last, from the start pose.

    Bodies may be drawn far from any equilibrium, so even the first is reached by way of the start pose.
    """

    def __init__(self, simulation: Simulation, start: Array, shift: float, near: Near) -> None:
        self._simulation, self._start, self._shift = simulation, start, shift
        joints = simulation.model.joints
        self.rest = np.array([joint.rest for joint in joints])
        self._moving = np.array([joint.moves_frame for joint in joints], dtype=np.bool_)
        found = self._settled(start, self._here(*near[START])) if START in near else None
        if found is None:
            found = self._settled(start)
        if found is not None:
            near[START] = found, self.rest
        self._home = simulation.snapshot()

    def to(self, joints: Array, near: tuple[State, Array] | None) -> State | None:
        """The equilibrium of joints (j,), from one that is near or from the last; None: nothing has moved.

        What is not found from one of a model that differs little is soon given up: it differs too much.
        """
        if near is not None and (found := self._settled(joints, self._here(*near))) is not None:
            return found
        if (found := self._settled(joints)) is not None or near is not None:
            return found
        before = self._simulation.snapshot()
        for parts in PARTS:
            self._simulation.restore(self._home)
            ways = np.linspace(self._start, joints, parts + 1)[1:]
            for each in ways:
                if (found := self._settled(each)) is None:
                    break
            if found is not None:
                return found
        self._simulation.restore(before)
        return None

    def _here(self, state: State, rest: Array) -> State:
        """A state of the other model with what its joints carry in the same place, wherever zero is here."""
        here = self._simulation.model.empty_state()
        here.copy_from(state)
        here.joint_positions[self._moving] += (self.rest - rest)[self._moving]
        return here

    def _settled(self, joints: Array, start: State | None = None) -> State | None:
        try:
            return self._simulation.settle(joints, self._shift, start=start, tolerance=CLOSE).state
        except NotConvergedError:
            return None


def _in_time(
    robot: RobotDescription, session: Session, commands: Array, progress: Progress | None
) -> Prediction:
    """The motion from the first row's command, or from rest at time 0, to the last row."""
    time = session.description.time
    assert time is not None
    assert session.times is not None
    simulation = Simulation(robot)
    places = Places(simulation, session.description.sensors)
    begin = 0.0 if time.start == "rest" else float(session.times[0])
    if time.start == "equilibrium":
        simulation.settle(commands[0], robot.start_shift)
    last = session.times[session.used].max() + time.most_delay
    steps = max(1, int(np.ceil((last - begin) / simulation.dt)))
    times = np.asarray(begin + simulation.dt * np.arange(steps + 1), dtype=np.float64)
    seen = [places.seen(simulation)]
    stopped = False
    try:
        for k in range(1, steps + 1):
            if len(robot.joints):
                row = max(0, int(np.searchsorted(session.times, times[k - 1] + SAME, side="right")) - 1)
                simulation.command(commands[row])
            simulation.step()
            seen.append(places.seen(simulation))
            if progress is not None:
                progress(k, steps)
    except KeyboardInterrupt:
        stopped = True
    except SolverDivergedError:
        pass  # what comes later is not reached
    positions = np.array([each for each, _ in seen])
    rotations = np.array([turn for _, turn in seen])
    return Prediction(positions, rotations, np.ones(len(seen), bool), times[: len(seen)], stopped)
