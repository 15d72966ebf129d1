"""Joint trajectories through way points in time, and animations that scale a motion over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.base import Array, CommandError, SceneError, known_names, listing

Mode: TypeAlias = Literal["once", "loop", "pingpong"]

_DIGITS = 9
"""Decimals to which phases are rounded, so that steps of dt reach 0.05, 0.5, 1 exactly, without drift."""


def _phase(elapsed: float, duration: float) -> float:
    return max(0.0, round(elapsed / duration, _DIGITS))


def check_animation(duration: float, mode: str, delay: float = 0.0) -> None:
    """Refuse an animation that cannot be played.

    Raises:
        SceneError: the duration in [s] is not > 0, the mode is unknown, or the delay in [s] is not >= 0.
    """
    if not 0.0 < duration < math.inf:
        raise SceneError(f"an animation's duration must be > 0 s, not {duration}")
    if mode not in get_args(Mode):
        raise SceneError(
            f"unknown animation mode {mode!r}; {known_names(mode, get_args(Mode), 'known modes:')}"
        )
    if not 0.0 <= delay < math.inf:
        raise SceneError(f"an animation's delay must be >= 0 s, not {delay}")


def factor_at(elapsed: float, duration: float, mode: Mode = "once") -> float:
    """Return the factor of an animation after `elapsed` seconds.

    Args:
        elapsed: Time since factor 0 in [s]; negative counts as 0.
        duration: Seconds from factor 0 to factor 1, > 0.
        mode: "once": rises to 1 and stays. "loop": rises repeatedly; a round ends with 1, and the next step
            continues from 0. "pingpong": rises to 1, falls to 0, rises again.

    Returns:
        Factor in 0..1, without drift: after n steps of dt it is the nearest float to its decimal value.

    Raises:
        SceneError: unknown mode, or a duration that is not > 0.
    """
    check_animation(duration, mode)
    phase = _phase(elapsed, duration)
    if mode == "once":
        return min(phase, 1.0)
    if mode == "loop":
        return 0.0 if phase == 0.0 else round(phase - (math.ceil(phase) - 1), _DIGITS)
    return round(1.0 - abs(1.0 - math.fmod(phase, 2.0)), _DIGITS)


def is_over(elapsed: float, duration: float, mode: Mode = "once") -> bool:
    """Return whether the factor has reached its end, which happens only in mode "once"."""
    return mode == "once" and _phase(elapsed, duration) >= 1.0


ROUND_OFF = 1e-6
"""Share of a joint's fastest velocity below which its last one is rounding of a planner, and counts as 0."""

LEAST_SPEED = 1e-9
"""Speed in [rad/s] or [m/s] below which a last velocity counts as 0, too."""


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectory:
    """Way points of some joints; other joints stay at their commands.

    Attributes:
        joints: Names of the k joints it moves, each once.
        times: Seconds after the start, shape (p,), p >= 1, finite, >= 0 and strictly increasing.
        positions: Positions in [rad] or [m], shape (p, k), finite.
        velocities: Velocities at the way points in [rad/s] or [m/s], same shape; the last ones are 0. None:
            linear interpolation.
        accelerations: Accelerations at the way points in [rad/s^2] or [m/s^2], same shape, only with
            velocities: quintic interpolation. None: cubic interpolation, if velocities are given.

    Raises:
        CommandError: anything else; the trajectory is refused as a whole.
    """

    joints: tuple[str, ...]
    times: Array
    positions: Array
    velocities: Array | None
    accelerations: Array | None

    def __init__(
        self,
        joints: Sequence[str],
        times: ArrayLike,
        positions: ArrayLike,
        velocities: ArrayLike | None = None,
        accelerations: ArrayLike | None = None,
    ) -> None:
        object.__setattr__(self, "joints", tuple(joints))
        object.__setattr__(self, "times", _floats("times", times))
        object.__setattr__(self, "positions", _floats("positions", positions))
        for name, values in (("velocities", velocities), ("accelerations", accelerations)):
            object.__setattr__(self, name, None if values is None else _floats(name, values))
        self._check()

    def _check(self) -> None:
        joints, times, positions = self.joints, self.times, self.positions
        twice = [name for name in dict.fromkeys(joints) if joints.count(name) > 1]
        if not joints or twice:
            problem = f"it names {listing(twice)} twice" if twice else "it names no joint"
            raise _make_trajectory_error(f"{problem}; expected each moved joint once")
        if times.ndim != 1 or len(times) == 0:
            raise _make_trajectory_error(
                "it has no way points; expected at least one time with a position for each joint"
            )
        if positions.shape != (len(times), len(joints)):
            raise _make_trajectory_error(
                f"positions of shape {positions.shape} do not fit {len(times)} times and {len(joints)} joints"
                f" ({listing(joints)}); expected shape {(len(times), len(joints))}"
            )
        if not np.isfinite(times).all() or times[0] < 0.0 or (np.diff(times) <= 0.0).any():
            raise _make_trajectory_error(
                f"times {_short(times)} s must be finite, >= 0 and strictly increasing"
            )
        if not np.isfinite(positions).all():
            point, joint = (int(index) for index in np.argwhere(~np.isfinite(positions))[0])
            value = positions[point, joint]
            raise _make_trajectory_error(
                f"position {value} of joint {joints[joint]} at way point {point} is not a finite number"
            )

        for name, values in (("velocities", self.velocities), ("accelerations", self.accelerations)):
            if values is not None and (values.shape != self.positions.shape or not np.isfinite(values).all()):
                raise _make_trajectory_error(f"its {name} are not one finite number for each position")
        if self.accelerations is not None and self.velocities is None:
            raise _make_trajectory_error("accelerations need velocities; give both, or positions alone")
        if self.velocities is not None:
            fastest = np.abs(self.velocities).max(axis=0)
            if (np.abs(self.velocities[-1]) > ROUND_OFF * fastest + LEAST_SPEED).any():
                raise _make_trajectory_error("the velocities of its last way point must be 0: there it stops")
            self.velocities[-1] = 0.0

    @property
    def duration(self) -> float:
        """Time of the last way point in [s]."""
        return float(self.times[-1])

    def check_joints(self, joint_names: Sequence[str]) -> None:
        """Refuse a trajectory for joints that a robot does not have.

        Raises:
            CommandError: a name is not among `joint_names`.
        """
        unknown = [name for name in self.joints if name not in joint_names]
        if unknown:
            hint = known_names(unknown[0], joint_names, "known joints:")
            raise _make_trajectory_error(f"unknown joint {listing(unknown)}; {hint}")

    def sample(
        self, time: float, start_positions: ArrayLike, joint_names: Sequence[str] | None = None
    ) -> Array:
        """Return the command at `time`: from the start positions through the way points, then constant.

        Args:
            time: Seconds after the start; negative counts as 0.
            start_positions: Command in [rad] or [m] at time 0, one per joint of `joint_names`.
            joint_names: Joints of the command, in its order; None: the trajectory's own joints.

        Returns:
            Command in [rad] or [m], shape (len(joint_names),); joints that the trajectory does not name keep
            their start position.

        Raises:
            CommandError: start positions of the wrong length, or a joint that is not among `joint_names`.
        """
        names = self.joints if joint_names is None else tuple(joint_names)
        self.check_joints(names)
        command = _floats("start positions", start_positions)
        if command.shape != (len(names),):
            raise _make_trajectory_error(
                f"{command.size} start positions do not fit {len(names)} joints ({listing(names)})"
            )
        moved = [names.index(name) for name in self.joints]
        command[moved], _ = self.between(time, command[moved])
        return command

    def between(self, time: float, start: Array) -> tuple[Array, Array]:
        """Return positions and velocities of the trajectory's own joints; see `sample`.

        Args:
            time: Seconds after the start; negative counts as 0.
            start: Command of these joints in [rad] or [m] at time 0, shape (k,).

        Returns:
            Positions in [rad] or [m] and velocities in [rad/s] or [m/s], shapes (k,); the velocities are 0
            once the last way point is reached.
        """
        time = max(time, 0.0)
        after = int(np.searchsorted(self.times, time, side="right"))
        still = np.zeros(len(start))
        if after == len(self.times):
            return np.asarray(self.positions[-1]), still
        begin = float(self.times[after - 1]) if after else 0.0
        first = self._slopes(after - 1) if after else (start, still, still)
        length = float(self.times[after]) - begin
        share = (time - begin) / length
        if self.velocities is None:
            way = self.positions[after] - first[0]
            return np.asarray(first[0] + share * way), np.asarray(way / length)
        return _curve(share, length, first, self._slopes(after), quintic=self.accelerations is not None)

    def _slopes(self, point: int) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations of a way point; zeros where they are not given."""
        still = np.zeros(self.positions.shape[1])
        return (
            self.positions[point],
            still if self.velocities is None else self.velocities[point],
            still if self.accelerations is None else self.accelerations[point],
        )

    def is_over(self, time: float) -> bool:
        """Return whether the last way point is reached at `time` in [s], with a tolerance of a nanosecond."""
        return time >= self.duration - 1e-9


def _curve(
    share: float,
    length: float,
    first: tuple[Array, Array, Array],
    last: tuple[Array, Array, Array],
    *,
    quintic: bool,
) -> tuple[Array, Array]:
    """Return positions and velocities (k,) on the cubic or quintic between two way points (Hermite).

    Args:
        share: Share of the time between the way points, 0 to 1.
        length: Time between the way points in [s].
        first: Positions, velocities and, for a quintic, accelerations at the first one, shapes (k,).
        last: The same at the last one.
        quintic: Whether to match the accelerations.
    """
    (p0, v0, a0), (p1, v1, a1) = first, last
    c = [p0, length * v0, 0.5 * length**2 * a0 if quintic else 0.0 * p0]
    way, speed = p1 - p0 - c[1] - c[2], length * v1 - c[1] - 2.0 * c[2]
    if quintic:
        bend = length**2 * a1 - 2.0 * c[2]
        c += [
            10.0 * way - 4.0 * speed + 0.5 * bend,
            -15.0 * way + 7.0 * speed - bend,
            6.0 * way - 3.0 * speed + 0.5 * bend,
        ]
    else:
        c[2] = 3.0 * way - speed
        c.append(speed - 2.0 * way)
    slopes = [power * coefficient for power, coefficient in enumerate(c)][1:]
    return _polynomial(c, share), _polynomial(slopes, share) / length


def _polynomial(coefficients: Sequence[Array], at: float) -> Array:
    """Return the values of polynomials, shape (k,), from coefficients (k,) in ascending powers."""
    return np.asarray(sum(each * at**power for power, each in enumerate(coefficients)))


def _floats(what: str, values: ArrayLike) -> Array:
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise _make_trajectory_error(f"{what} are not all numbers in rows of equal length") from error


def _make_trajectory_error(problem: str) -> CommandError:
    return CommandError(f"trajectory refused: {problem}; nothing was moved")


def _short(values: Array) -> str:
    return np.array2string(values, threshold=6, separator=", ")
