r"""Replay of a session's commands on a model: equilibria, motion in time, or free oscillation.

Along the direction of a point's largest motion, its position is described by

.. math:: c + a e^{-d t} \cos(2 \pi f t + \varphi) + b e^{-t / \tau}

where the time constant of the slow creep is a third of the observed time. The damping ratio is
:math:`d / \sqrt{d^2 + (2 \pi f)^2}`.

A body that is released by a hand oscillates with an amplitude and a phase that depend on the hand, while
frequency and decay belong to the body. Where the release is unknown, a fit of the whole motion would
compensate a wrong amplitude by wrong damping. `release_errors` returns the part of the errors that the fit
must ignore.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from scipy.optimize import least_squares

from softsim_core.base import Array, BoolArray, IndexArray, NotConvergedError, SolverDivergedError
from softsim_core.lab.identification.alignment import Places
from softsim_core.lab.identification.description import SensorDescription
from softsim_core.lab.identification.session import Session
from softsim_core.physics.mechanics import State
from softsim_core.scene import RobotDescription
from softsim_core.simulation import Simulation

FEWEST = 40
"""Least number of positions for an oscillation."""

UNTOLD = 0.3
"""A motion counts as no oscillation if the description leaves a larger part of it unexplained."""


class Ringing(NamedTuple):
    """A damped oscillation.

    Attributes:
        frequency: Frequency in [Hz].
        damping: Ratio to critical damping.
    """

    frequency: float
    damping: float

    @property
    def decay(self) -> float:
        """Decay rate d of the oscillation in [1/s]."""
        return 2.0 * np.pi * self.frequency * self.damping / float(np.sqrt(1.0 - self.damping**2))


def ringing(times: Array, places: Array) -> Ringing | None:
    """Fit the damped oscillation of places (k, 3) in [m] at times (k,) in [s]; None: it is no oscillation."""
    if len(times) < FEWEST:
        return None
    centred = places - places.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    size = float(along.std())
    if not size > 0.0:
        return None
    t, z = times - times[0], along / size
    even = np.linspace(0.0, t[-1], len(t))
    left = np.interp(even, t, z) - np.polyval(np.polyfit(even, np.interp(even, t, z), 2), even)
    found: tuple[float, Array] | None = None
    strength = np.abs(np.fft.rfft(left, 8 * len(left)))
    rates = np.fft.rfftfreq(8 * len(left), even[1])
    start = float(rates[int(np.argmax(strength[1:])) + 1])

    def misfit(x: Array) -> Array:
        shapes = _shapes(t, float(np.exp(x[0])), float(x[1]), t[-1])
        return np.asarray(z - shapes @ np.linalg.lstsq(shapes, z, rcond=None)[0])

    for decay in (0.5, 2.0, 8.0):
        fit = least_squares(misfit, [np.log(decay), start], x_scale=[1.0, 0.05 * start])
        if found is None or fit.cost < found[0]:
            found = (float(fit.cost), fit.x)
    assert found is not None
    decay, frequency = float(np.exp(found[1][0])), abs(float(found[1][1]))
    if (
        np.sqrt(2.0 * found[0] / len(t)) > UNTOLD
        or frequency * t[-1] < 2.0
        or 2.0 * frequency > len(t) / t[-1]
    ):
        return None
    return Ringing(frequency, decay / float(np.hypot(decay, 2.0 * np.pi * frequency)))


def release_errors(times: Array, places: Array, errors: Array, rows: BoolArray) -> Array | None:
    """Return the part of a model's errors that another amplitude and phase would explain.

    Amplitude and phase are common to all sensors. Frequency and decay are those of the model, so errors of
    these remain.

    Args:
        times: Increasing times in [s], shape (k,).
        places: Positions of the sensors in the model in [m], shape (k, s, 3).
        errors: Model minus measurement in [m], shape (k, s, 3).
        rows: Rows to which amplitude and phase are fitted, shape (k,).

    Returns:
        The part in [m], shape (k, s, 3); None where the model does not oscillate in these rows.
    """
    widest = int(np.argmax(places[rows].var(axis=0).sum(axis=-1)))
    swing = ringing(times[rows], places[rows, widest])
    if swing is None:
        return None
    t = times - times[rows][0]
    shapes = _shapes(t, swing.decay, swing.frequency, float(t[rows][-1]))
    flat = places.reshape(len(t), -1)
    _, cosine, sine, _ = np.linalg.lstsq(shapes[rows], flat[rows], rcond=None)[0]
    as_released = shapes[:, 1:2] * cosine + shapes[:, 2:3] * sine
    quarter_later = shapes[:, 1:2] * sine - shapes[:, 2:3] * cosine
    both = np.stack([as_released, quarter_later], axis=-1)
    amounts = np.linalg.lstsq(both[rows].reshape(-1, 2), errors[rows].ravel(), rcond=None)[0]
    return np.asarray((both @ amounts).reshape(errors.shape))


def _shapes(t: Array, decay: float, frequency: float, last: float) -> Array:
    """Return constant, cosine, sine and creep at times (k,) from the first, shape (k, 4)."""
    swing, angle = np.exp(-decay * t), 2.0 * np.pi * frequency * t
    return np.stack(
        [np.ones_like(t), swing * np.cos(angle), swing * np.sin(angle), np.exp(-3.0 * t / last)], axis=1
    )


Order: TypeAlias = Literal["nearest", "rows"]
"""Order of rows: each command the nearest of those left, or as measured.

Models that remember their path are led along all rows as measured.
"""

PARTS: Final = (1, 8)
"""Numbers of parts of the way from the start pose, tried where a row is not found from the one before."""

CLOSE: Final = 1e-7
"""Rows are at rest when the last Newton step moved nothing by more than this, in [m]."""

SAME: Final = 1e-9
"""Times closer than this in [s] count as equal: a command acts in the step that starts when it is given."""

Progress: TypeAlias = Callable[[int, int], None]
"""Called with the finished and the total number of rows or steps."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted motion of the parts that carry a session's sensors.

    Attributes:
        positions: Positions in [m] of rows, or of steps of a replay in time, shape (k, s, 3).
        rotations: Rotations, shape (k, s, 3, 3).
        reached: Whether an equilibrium was found, shape (k,); a row without one has no prediction.
        times: Times of the steps of a replay in time in [s], shape (k,); None: these are the session's rows.
        stopped: Whether the replay was interrupted.
    """

    positions: Array
    rotations: Array
    reached: BoolArray
    times: Array | None = None
    stopped: bool = False

    def at(self, session: Session, delay: float = 0.0) -> tuple[Array, Array, BoolArray]:
        """Return positions, rotations and whether they are known at the rows of the session; delay in [s]."""
        if self.times is None or session.times is None:
            return self.positions, self.rotations, self.reached
        when = session.times - delay
        right = np.clip(np.searchsorted(self.times, when), 1, len(self.times) - 1)
        span = self.times[right] - self.times[right - 1]
        part = np.clip((when - self.times[right - 1]) / span, 0.0, 1.0)[:, None, None]
        positions = (1.0 - part) * self.positions[right - 1] + part * self.positions[right]
        reached = self.reached[right] & (when <= self.times[-1] + span[-1])
        return positions, self.rotations[np.where(part[:, 0, 0] < 0.5, right - 1, right)], reached


class Near(dict[tuple[float, ...], tuple[State, Array]]):
    """Equilibria of a similar model and its joints' rest positions (j,), by joint command.

    The one at the start pose has the key `START`: its command differs if the joint zeros differ.

    Attributes:
        checked: Whether equilibria that are found from these are checked for stability; False where the
            models are so similar that they must be stable.
    """

    checked = True


START: Final = ()


def replay(
    robot: RobotDescription,
    session: Session,
    order: Order | None = None,
    progress: Progress | None = None,
    near: Near | None = None,
) -> Prediction:
    """Replay the commands of a session on a model; an interrupt (Ctrl-C) returns the finished part.

    Args:
        robot: The model, with the session's overrides applied.
        session: The session.
        order: Order in which its rows are solved; None: "rows" if the session orders them, else "nearest".
            Rows in time are played as measured.
        progress: Called with the progress in rows or steps.
        near: Known equilibria at which rows start; the replay adds those that it finds.

    Raises:
        DataError: the commands do not fit the robot.
        SceneError: the scene cannot be built, or has nothing where a sensor sits.
    """
    commands = session.commands(robot)
    if session.times is not None:
        return _in_time(robot, session, commands, progress)
    order = order or ("rows" if session.description.order else "nearest")
    return equilibria(robot, session.description.sensors, commands, order, progress, near)


def in_short_steps(points: Array, start: Array) -> IndexArray:
    """Order points (k, j) so that each is the nearest of those left, beginning at `start` (j,)."""
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
    """Solve the equilibrium of each distinct command (k, j), starting from the previous one.

    With a model that remembers its path, each row is solved, in the given order and from the row before.

    Args:
        robot: The model.
        sensors: The sensors to predict.
        commands: Commands of the joints in [rad], [m] or the joint's own unit, shape (k, j).
        order: Order in which they are solved.
        progress: Called with the progress in commands.
        near: See `replay`.

    Raises:
        SceneError: the scene cannot be built, or has nothing where a sensor sits.
    """
    simulation = Simulation(robot.robot_alone())
    remembers = simulation.remembers_path
    near = Near() if near is None or remembers else near
    places, start = Places(simulation, sensors), np.array(robot.start_joints)
    walk = _Walk(simulation, start, robot.start_shift, near)
    if remembers:
        different, same = commands, np.arange(len(commands))
        sequence = same
    else:
        different, first, same = np.unique(commands, axis=0, return_index=True, return_inverse=True)
        sequence = in_short_steps(different, start) if order == "nearest" else np.argsort(first)
    positions = np.full((len(different), len(sensors), 3), np.nan)
    rotations = np.full((len(different), len(sensors), 3, 3), np.nan)
    stopped = False
    try:
        for done, k in enumerate(sequence.tolist(), start=1):
            command = tuple(different[k].tolist())
            if (found := walk.to(different[k], near.get(command))) is not None:
                if not remembers:
                    near[command] = found, walk.rest
                positions[k], rotations[k] = places.locate(simulation)
            if progress is not None:
                progress(done, len(different))
    except KeyboardInterrupt:
        stopped = True
    same = same.ravel()
    return Prediction(
        positions[same], rotations[same], np.isfinite(positions[same]).all(axis=(1, 2)), None, stopped
    )


class _Walk:
    """Solver that moves from equilibrium to equilibrium, or restarts from the start pose where that fails.

    Bodies may be drawn far from any equilibrium, so even the first one is reached by way of the start pose.
    """

    def __init__(self, simulation: Simulation, start: Array, shift: float, near: Near) -> None:
        self._near = near
        self._simulation, self._start, self._shift = simulation, start, shift
        joints = simulation.model.joints
        self.rest = np.array([joint.rest for joint in joints])
        self._moving = np.array([joint.moves_frame for joint in joints], dtype=np.bool_)
        found = self._try_settle(start, self._here(*near[START])) if START in near else None
        if found is None:
            found = self._try_settle(start)
        if found is not None:
            near[START] = found, self.rest
        self._home = simulation.snapshot()

    def to(self, joints: Array, near: tuple[State, Array] | None) -> State | None:
        """Return the equilibrium at joints (j,), from a near or the last one; None: nothing has changed.

        A near equilibrium of a similar model is tried only briefly: if that fails, the models differ too
        much.
        """
        if near is not None and (found := self._try_settle(joints, self._here(*near))) is not None:
            return found
        if (found := self._try_settle(joints)) is not None or near is not None:
            return found
        before = self._simulation.snapshot()
        for parts in PARTS:
            self._simulation.restore(self._home)
            ways = np.linspace(self._start, joints, parts + 1)[1:]
            for each in ways:
                if (found := self._try_settle(each)) is None:
                    break
            if found is not None:
                return found
        self._simulation.restore(before)
        return None

    def _here(self, state: State, rest: Array) -> State:
        """Return the other model's state with the parts that joints carry in the same place."""
        here = self._simulation.model.empty_state()
        here.copy_from(state)
        here.joint_positions[self._moving] += (self.rest - rest)[self._moving]
        return here

    def _try_settle(self, joints: Array, start: State | None = None) -> State | None:
        try:
            checked = self._near.checked or start is None
            settle = self._simulation.settle
            return settle(joints, self._shift, start=start, tolerance=CLOSE, checked=checked).state
        except NotConvergedError:
            return None


def _in_time(
    robot: RobotDescription, session: Session, commands: Array, progress: Progress | None
) -> Prediction:
    """Simulate the motion from the first row's command, or from rest at time 0, to the last row."""
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
    located = [places.locate(simulation)]
    stopped = False
    try:
        for k in range(1, steps + 1):
            if len(robot.joints):
                row = max(0, int(np.searchsorted(session.times, times[k - 1] + SAME, side="right")) - 1)
                simulation.command(commands[row])
            simulation.step()
            located.append(places.locate(simulation))
            if progress is not None:
                progress(k, steps)
    except KeyboardInterrupt:
        stopped = True
    except SolverDivergedError:
        pass  # later rows stay unreached
    positions = np.array([each for each, _ in located])
    rotations = np.array([turn for _, turn in located])
    return Prediction(positions, rotations, np.ones(len(located), bool), times[: len(located)], stopped)
