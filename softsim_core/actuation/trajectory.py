"""Joint trajectories: named joints, way points in time, linear interpolation in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.arrays import Array
from softsim_core.errors import CommandError, listing


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectory:
    """Way points of some joints; the joints it does not name stay where they are commanded.

    Attributes:
        joints: Names of the k joints it moves, each once.
        times: Seconds after the start, shape (p,), p >= 1, finite, >= 0 and strictly increasing.
        positions: Positions in [rad] or [m], shape (p, k), finite.

    Raises:
        CommandError: anything else; the trajectory is refused as a whole.
    """

    joints: tuple[str, ...]
    times: Array
    positions: Array

    def __init__(self, joints: Sequence[str], times: ArrayLike, positions: ArrayLike) -> None:
        object.__setattr__(self, "joints", tuple(joints))
        object.__setattr__(self, "times", _floats("times", times))
        object.__setattr__(self, "positions", _floats("positions", positions))
        self._check()

    def _check(self) -> None:
        joints, times, positions = self.joints, self.times, self.positions
        twice = [name for name in dict.fromkeys(joints) if joints.count(name) > 1]
        if not joints or twice:
            problem = f"it names {listing(twice)} twice" if twice else "it names no joint"
            raise _refused(f"{problem}; expected each moved joint once")
        if times.ndim != 1 or len(times) == 0:
            raise _refused("it has no way points; expected at least one time with a position for each joint")
        if positions.shape != (len(times), len(joints)):
            raise _refused(
                f"positions of shape {positions.shape} do not fit {len(times)} times and {len(joints)} joints"
                f" ({listing(joints)}); expected shape {(len(times), len(joints))}"
            )
        if not np.isfinite(times).all() or times[0] < 0.0 or (np.diff(times) <= 0.0).any():
            raise _refused(f"times {_short(times)} s must be finite, >= 0 and strictly increasing")
        if not np.isfinite(positions).all():
            point, joint = (int(index) for index in np.argwhere(~np.isfinite(positions))[0])
            value = positions[point, joint]
            raise _refused(
                f"position {value} of joint {joints[joint]} at way point {point} is not a finite number"
            )

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
            raise _refused(f"unknown joint {listing(unknown)}; known joints: {listing(joint_names)}")

    def sample(
        self, time: float, start_positions: ArrayLike, joint_names: Sequence[str] | None = None
    ) -> Array:
        """The command at `time`: linear from the start positions at 0 through the way points, then held.

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
            raise _refused(
                f"{command.size} start positions do not fit {len(names)} joints ({listing(names)})"
            )
        for column, name in enumerate(self.joints):
            index = names.index(name)
            times, values = self.times, self.positions[:, column]
            if times[0] > 0.0:
                times, values = np.append(0.0, times), np.append(command[index], values)
            command[index] = np.interp(time, times, values)
        return command

    def is_over(self, time: float) -> bool:
        """Whether the last way point is reached at `time` in [s] (a nanosecond of rounding is forgiven)."""
        return time >= self.duration - 1e-9


def _floats(what: str, values: ArrayLike) -> Array:
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise _refused(f"{what} are not all numbers in rows of equal length") from error


def _refused(problem: str) -> CommandError:
    return CommandError(f"trajectory refused: {problem}; nothing was moved")


def _short(values: Array) -> str:
    return np.array2string(values, threshold=6, separator=", ")
