r"""Motions and poses that identify a robot's parameters: grids, steps, chirps, next poses.

Between two points all joints follow one minimum-jerk profile,

.. math:: q(t) = q_0 + (q_1 - q_0) (10 \tau^3 - 15 \tau^4 + 6 \tau^5), \quad \tau = t / T,

with largest speed :math:`1.875\, |q_1 - q_0| / T` and largest acceleration :math:`5.774\, |q_1 - q_0| / T^2`;
T is the shortest time that respects both limits of every joint.

Source: Flash, Hogan 1985 (minimum jerk).

The existing rows and one more contain the information on the parameters p and on the frame and sensor points
a of its session :math:`I = \sum_i J_i^T J_i / \sigma^2` where J are the slopes of the errors by both. The
information on p alone is :math:`I_{pp} - I_{pa} I_{aa}^{-1} I_{ap}`. Candidates are spread evenly about the
measured commands. They are selected one after another, each time the one that increases the determinant most.

Source: Fedorov 1972, Theory of optimal experiments (D-optimality, one point after another).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

import numpy as np
from scipy.stats import qmc

from softsim_core.base import Array, DataError, FieldError, SceneError, listing, need_positive
from softsim_core.lab.identification.alignment import Alignment, locate_sensors
from softsim_core.lab.identification.fitting import Calibration
from softsim_core.lab.identification.model_replay import Near, Prediction, equilibria, in_short_steps
from softsim_core.lab.identification.validation import compare_session
from softsim_core.physics.mechanics import cross_matrices
from softsim_core.scene import RobotDescription

Kind: TypeAlias = Literal["grid", "steps", "chirp", "ring_down"]

KINDS: Final[tuple[Kind, ...]] = get_args(Kind)

TOP_SPEED: Final = 1.875
TOP_ACCELERATION: Final = 10.0 / np.sqrt(3.0)
"""Peak speed and peak acceleration of a minimum-jerk profile of unit length and unit duration."""

CLOSE: Final = 0.98
"""Part of the limits that fast motions use, so that rounding does not exceed a limit."""

UNLIMITED_S: Final = 0.5
"""Time in [s] in which a joint without speed limit crosses its range."""

SPEEDING_S: Final = 0.1
"""Time in [s] in which a joint without acceleration limit reaches its top speed."""

LEAD_S: Final = 0.3
"""Standstill before a motion in time, in [s]."""

MOST_LISTED: Final = 20_000
"""Grids with more points than this are sampled point by point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExcitationSettings:
    """Settings of excitation motions.

    Attributes:
        kinds: Kinds of motion.
        reach: Used part of the range between the start pose and each limit, in (0, 1].
        speed: Part of the speed and acceleration limits for moves from pose to pose, in (0, 1].
        poses: Largest number of grid poses; a larger grid is sampled.
        levels: Positions of each joint in the grid, >= 2.
        hold_s: Duration of each step in [s].
        ringing_s: Duration of the free motion in [s].
        chirp_s: Duration of the chirp in [s].
        lowest_hz, highest_hz: Frequency range of the chirp in [Hz].
        seed: Seed of the samples.
        period_s: Interval between commands in [s].
    """

    kinds: tuple[Kind, ...] = KINDS
    reach: float = 0.5
    speed: float = 0.5
    poses: int = 30
    levels: int = 3
    hold_s: float = 1.0
    ringing_s: float = 2.0
    chirp_s: float = 10.0
    lowest_hz: float = 0.3
    highest_hz: float = 5.0
    seed: int = 0
    period_s: float = 0.02

    def __post_init__(self) -> None:
        owner = "excitation"
        for kind in self.kinds:
            if kind not in KINDS:
                raise FieldError(owner, "kinds", repr(kind), f"some of {listing(KINDS)}")
        for name in ("reach", "speed"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise FieldError(owner, name, getattr(self, name), "in (0, 1]")
        if self.poses < 1:
            raise FieldError(owner, "poses", self.poses, ">= 1")
        if self.levels < 2:
            raise FieldError(owner, "levels", self.levels, ">= 2")
        for name in ("hold_s", "ringing_s", "chirp_s", "period_s"):
            need_positive(owner, name, getattr(self, name), "s")
        need_positive(owner, "lowest_hz", self.lowest_hz, "Hz")
        if not self.lowest_hz < self.highest_hz <= 0.25 / self.period_s:
            allowed = f"between lowest_hz = {self.lowest_hz:g} and {0.25 / self.period_s:g} Hz"
            raise FieldError(owner, "highest_hz", self.highest_hz, allowed)


@dataclass(frozen=True, slots=True, eq=False)
class MotionLimits:
    """Motion limits of a robot's j joints, in [rad], [m] or the unit of their commands.

    Attributes:
        home: Start and end of every motion, shape (j,).
        low, high: Range of positions, with home inside, shape (j,).
        speed, acceleration: Finite limits, shape (j,).
    """

    home: Array
    low: Array
    high: Array
    speed: Array
    acceleration: Array


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A sequence of commands in time.

    Attributes:
        name: Name of the session to measure.
        commands: One every `period_s`, shape (k, j).
        period_s: Interval between commands in [s].
        free: Only the free motion after the last changing command is evaluated.
    """

    name: str
    commands: Array
    period_s: float
    free: bool = False

    @property
    def duration_s(self) -> float:
        """Duration in [s]."""
        return len(self.commands) * self.period_s


def motion_limits_of(robot: RobotDescription, reach: float) -> MotionLimits:
    """Return the motion limits for a part `reach` of a robot's ranges between start pose and joint limits.

    Raises:
        SceneError: the robot has no joints, or one without position limits.
    """
    if not robot.joints:
        raise SceneError(f"{robot.name} has no joints; nothing can be excited")
    limits = [joint.limits for joint in robot.joints]
    lower, upper = (np.array([getattr(each, name) for each in limits]) for name in ("lower", "upper"))
    for joint, low, high in zip(robot.joints, lower.tolist(), upper.tolist(), strict=True):
        if not np.isfinite((low, high)).all() or not low < high:
            raise SceneError(
                f"joint {joint.name} of {robot.name} has the limits [{low:g}, {high:g}]; give it a finite "
                "range in the robot's file (limits: lower, upper): motions keep within it"
            )
    home = np.clip(robot.start_joints, lower, upper)
    speed = np.minimum([each.speed for each in limits], (upper - lower) / UNLIMITED_S)
    acceleration = np.minimum([each.acceleration for each in limits], speed / SPEEDING_S)
    low, high = home + reach * (lower - home), home + reach * (upper - home)
    return MotionLimits(home, low, high, speed, acceleration)


def way(start: Array, goal: Array, limits: MotionLimits, share: float, period_s: float) -> Array:
    """Return commands (k, j) from `start` to `goal` in the shortest time within a share of the limits.

    The start itself is not included.
    """
    far = np.abs(goal - start)
    slow = TOP_SPEED * far / (share * limits.speed)
    heavy = np.sqrt(TOP_ACCELERATION * far / (share * limits.acceleration))
    count = max(1, int(np.ceil(max(slow.max(), heavy.max()) / period_s)))
    tau = np.arange(1, count + 1)[:, None] / count
    return np.asarray(start + (goal - start) * (10.0 * tau**3 - 15.0 * tau**4 + 6.0 * tau**5))


def grid(limits: MotionLimits, settings: ExcitationSettings) -> Array:
    """Return grid poses (n, j) in an order of short moves; a large grid is sampled by the seed."""
    joints, levels = len(limits.home), settings.levels
    random = np.random.default_rng(settings.seed)
    if levels**joints <= MOST_LISTED:
        places = np.stack(np.meshgrid(*[np.arange(levels)] * joints, indexing="ij"), axis=-1)
        places = places.reshape(-1, joints)
        places = places[random.permutation(len(places))[: settings.poses]]
    else:
        places = np.unique(random.integers(levels, size=(settings.poses, joints)), axis=0)
    parts = places / (levels - 1)
    span = limits.high - limits.low
    order = in_short_steps(parts, (limits.home - limits.low) / span)
    return np.asarray(limits.low + span * parts[order])


def steps(limits: MotionLimits, settings: ExcitationSettings) -> Motion:
    """Move each joint in turn as fast as allowed: up, down and home, with a pause after each."""
    parts = [_still(limits.home, LEAD_S, settings)]
    for joint in range(len(limits.home)):
        for target in (limits.high[joint], limits.low[joint], limits.home[joint]):
            goal = limits.home.copy()
            goal[joint] = target
            parts += [
                way(parts[-1][-1], goal, limits, CLOSE, settings.period_s),
                _still(goal, settings.hold_s, settings),
            ]
    return Motion("steps", np.concatenate(parts), settings.period_s)


def chirp(limits: MotionLimits, settings: ExcitationSettings) -> Motion:
    """Return a chirp: all joints oscillate about the middle with rising frequency and evenly spaced phases.

    The amplitude at each frequency is the largest that reach, speed and acceleration allow.
    """
    count, period = round(settings.chirp_s / settings.period_s), settings.period_s
    t = np.arange(count) * period
    rate = (settings.highest_hz - settings.lowest_hz) / settings.chirp_s
    turn = 2.0 * np.pi * (settings.lowest_hz + rate * t)[:, None]
    phase = 2.0 * np.pi * (settings.lowest_hz * t + 0.5 * rate * t**2)[:, None]
    swing, middle = 0.5 * (limits.high - limits.low), 0.5 * (limits.high + limits.low)
    joints = len(limits.home)
    late = 2.0 * np.pi * np.arange(joints) / joints
    width = np.minimum(np.minimum(swing, limits.speed / turn), limits.acceleration / turn**2)
    ends = np.minimum(1.0, np.minimum(t, t[-1] - t) / (0.1 * settings.chirp_s))[:, None]
    swings = width * np.sin(phase + late) * (3.0 * ends**2 - 2.0 * ends**3)
    speeds = np.diff(swings, axis=0, prepend=0.0 * swings[:1]) / period
    most = np.maximum(
        np.abs(speeds).max(axis=0) / limits.speed,
        np.abs(np.diff(speeds, axis=0)).max(axis=0) / period / limits.acceleration,
    )
    swings *= np.minimum(1.0, CLOSE / np.maximum(most, 1e-12))
    begin = way(limits.home, middle, limits, CLOSE, period)
    parts = [_still(limits.home, LEAD_S, settings), begin, middle + swings]
    parts += [way(middle, limits.home, limits, CLOSE, period), _still(limits.home, LEAD_S, settings)]
    return Motion("chirp", np.concatenate(parts), period)


def ring_down(limits: MotionLimits, settings: ExcitationSettings) -> Motion:
    """Move the first joint away and back as fast as allowed, then leave it in free motion."""
    goal = limits.home.copy()
    farther = limits.high[0] - limits.home[0] >= limits.home[0] - limits.low[0]
    goal[0] = limits.high[0] if farther else limits.low[0]
    period = settings.period_s
    away = way(limits.home, goal, limits, CLOSE, period)
    back = way(goal, limits.home, limits, CLOSE, period)
    lead, ringing = (_still(limits.home, each, settings) for each in (LEAD_S, settings.ringing_s))
    return Motion("ring_down", np.concatenate([lead, away, back, ringing]), period, free=True)


def motions(limits: MotionLimits, settings: ExcitationSettings) -> list[Motion]:
    """Return the requested motions in time."""
    made = {"steps": steps, "chirp": chirp, "ring_down": ring_down}
    return [made[kind](limits, settings) for kind in settings.kinds if kind in made]


def _still(pose: Array, seconds: float, settings: ExcitationSettings) -> Array:
    return np.tile(pose, (max(1, round(seconds / settings.period_s)), 1))


BEYOND = 0.1
"""Part of the measured range of commands by which candidates extend beyond it."""


@dataclass(frozen=True, slots=True, eq=False)
class NextPoses:
    """Poses that are worth measuring next.

    Attributes:
        session: The session to which they would be added.
        joints: Names of the joints.
        commands: The poses, the best first, shape (n, j).
        errors: Standard errors of the parameters at present, and expected with the first pose, the first two,
            and so on, shape (n + 1, p).
    """

    session: str
    joints: tuple[str, ...]
    commands: Array
    errors: Array


def next_poses(
    result: Calibration,
    count: int = 5,
    candidates: int = 64,
    seed: int = 0,
    done: Callable[[int, int], None] | None = None,
) -> NextPoses:
    """Return the poses that add the most information on the parameters.

    The calibration must not have been interrupted. The seed is that of the candidates. `done` is called with
    the finished and the total number of candidate replays.

    Raises:
        DataError: no session consists of poses at rest.
    """
    problem, sessions = result.problem, result.problem.misfit.sessions
    chosen = next((k for k, each in enumerate(sessions) if each.times is None), -1)
    if chosen < 0:
        raise DataError(f"calibration {result.description.name}", "", "has no session of poses at rest")
    session = sessions[chosen]
    best = (result.values - problem.low) / problem.span
    around = problem.look_around(best)
    slopes, _ = problem.information(best)
    replayed = [around.here[chosen], *(each[chosen] for each in around.moved)]
    there_are = session.fitting & np.logical_and.reduce([each.reached for each in replayed])
    alignment = compare_session(session, replayed[0]).alignment
    assert alignment is not None
    fit = session.description.alignment
    aligned = alignment, (fit.frame, fit.point)
    measured = _slopes(replayed, around.steps, *aligned)[there_are]
    commands = _candidates(result, chosen, candidates, seed)
    offered = _slopes(
        _replay_candidates(result, chosen, commands, around.steps, done), around.steps, *aligned
    )
    offered = offered / problem.noise
    reached = np.isfinite(offered).all(axis=(1, 2))
    if not reached.any():
        raise DataError(f"session {session.name}", "commands", "no candidate has an equilibrium")
    size = len(best)
    flat = measured.reshape(-1, measured.shape[-1]) / problem.noise
    information = flat.T @ flat
    # priors, and all other sessions, each aligned by itself
    counts = [3 * len(each.description.sensors) * int(each.fitting.sum()) for each in sessions]
    first = sum(counts[:chosen])
    other = np.delete(slopes, np.arange(first, first + counts[chosen]), axis=0)
    information[:size, :size] += other.T @ other + problem.prior_slopes.T @ problem.prior_slopes
    taken: list[int] = []
    errors = [_errors(information, size)]
    each = np.einsum("nra,nrb->nab", offered, offered)
    for _ in range(min(count, int(reached.sum()))):
        left_over = [k for k in np.flatnonzero(reached).tolist() if k not in taken]
        taken.append(max(left_over, key=lambda k: _worth(information + each[k], size)))
        information = information + each[taken[-1]]
        errors.append(_errors(information, size))
    names = problem.misfit.robot(chosen, result.values).joint_names
    return NextPoses(session.name, names, commands[taken], np.array(errors) * problem.span)


def _candidates(result: Calibration, chosen: int, count: int, seed: int) -> Array:
    """Return commands (n, j) around those of a session, within the joint limits; Sobol 1967."""
    misfit = result.problem.misfit
    robot, session = misfit.robot(chosen, result.values), misfit.sessions[chosen]
    measured = session.commands(robot)[session.fitting]
    low, high = measured.min(axis=0), measured.max(axis=0)
    margin = BEYOND * (high - low)
    low = np.maximum(low - margin, [joint.limits.lower for joint in robot.joints])
    high = np.minimum(high + margin, [joint.limits.upper for joint in robot.joints])
    even = qmc.Sobol(len(low), seed=seed).random(2 ** int(np.ceil(np.log2(count))))[:count]
    return np.asarray(low + even * (high - low))


def _replay_candidates(
    result: Calibration, chosen: int, commands: Array, steps: Array, done: Callable[[int, int], None] | None
) -> list[Prediction]:
    """Replay candidates as fitted, then with each parameter changed by its step in parts of the bounds."""
    problem, found = result.problem, (result.values - result.problem.low) / result.problem.span
    sensors = problem.misfit.sessions[chosen].description.sensors
    near = Near()
    replayed: list[Prediction] = []
    for each in (np.zeros(len(steps)), *np.diag(steps)):
        model = problem.misfit.robot(chosen, problem.values(found + each))
        replayed.append(equilibria(model, sensors, commands, near=near))
        if replayed[-1].stopped:
            raise KeyboardInterrupt
        if done is not None:
            done(len(replayed), len(steps) + 1)
    return replayed


def _slopes(
    replayed: Sequence[Prediction], steps: Array, alignment: Alignment, fit: tuple[bool, bool]
) -> Array:
    """Return slopes of errors by parameters, then by frame and points if they `fit`, shape (k, 3 s, p + a).

    Rows are replayed first as fitted, then with each parameter changed by its step in parts of the bounds.
    """
    here, *moved = replayed
    points, (count, sensors) = alignment.points, here.positions.shape[:2]
    located = locate_sensors(here.positions, here.rotations, points)
    columns = [
        (locate_sensors(each.positions, each.rotations, points) - located) / step
        for each, step in zip(moved, steps, strict=True)
    ]
    frame, point = fit
    if frame:
        centre = np.nanmean(located, axis=(0, 1))
        columns += [*np.moveaxis(cross_matrices(located - centre), -1, 0)]
        columns += [np.broadcast_to(-axis, located.shape) for axis in np.eye(3)]
    if point:
        for s in range(sensors):
            of = np.zeros((count, sensors, 3, 3))
            of[:, s] = here.rotations[:, s]
            columns += [*np.moveaxis(of, -1, 0)]
    return np.asarray(np.stack(columns, axis=-1).reshape(count, 3 * sensors, -1))


def _alone(information: Array, size: int) -> Array:
    """Return the information on the first `size` numbers with the others eliminated, (size, size)."""
    if len(information) == size:
        return information
    across = information[:size, size:]
    return np.asarray(
        information[:size, :size]
        - across @ np.linalg.pinv(information[size:, size:], hermitian=True) @ across.T
    )


def _worth(information: Array, size: int) -> float:
    sizes = np.linalg.eigvalsh(_alone(information, size))
    return float(np.log(np.maximum(sizes, 1e-12)).sum())


def _errors(information: Array, size: int) -> Array:
    alone = _alone(information, size)
    sizes, axes = np.linalg.eigh(alone)
    return np.asarray(np.sqrt((axes**2 / np.maximum(sizes, 1e-12)).sum(axis=1)))
