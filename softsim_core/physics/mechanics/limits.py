"""Joint limits (position, speed, acceleration), the check of a joint command, and commands by joint name."""

from __future__ import annotations

import math
import numbers
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from softsim_core.base import CommandError, SceneError, listing

SHORTEST_STEP_S = 1e-9
"""Shorter steps than this in [s] move nothing, since the step divides by them."""

ROUND_OFF, LEAST = 1e-6, 1e-12
"""Round-off at a limit, as a fraction of the larger limit; at least LEAST of its unit."""

ARRIVED = 1e-9
"""A motion may end on its target if its stopping distance is at most this in [rad] or [m]."""


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Interval, top speed and top acceleration of a joint.

    Attributes:
        lower: Smallest position in [rad] (revolute), [m] (prismatic), or the unit of an actuator's command.
        upper: Largest position, same unit, >= lower.
        speed: Largest speed in [rad/s] or [m/s], > 0.
        acceleration: Largest change of speed in [rad/s^2] or [m/s^2], > 0; `step` and `brake` apply it.

    Raises:
        SceneError: the interval is empty, or the speed or the acceleration is not positive.
    """

    lower: float = -math.inf
    upper: float = math.inf
    speed: float = math.inf
    acceleration: float = math.inf

    def __post_init__(self) -> None:
        if not self.lower <= self.upper:  # also rejects NaN
            raise SceneError(f"joint limits need lower <= upper, not [{self.lower}, {self.upper}]")
        if not self.speed > 0.0:
            raise SceneError(f"joint speed limit must be > 0, not {self.speed}")
        if not self.acceleration > 0.0:
            raise SceneError(f"joint acceleration limit must be > 0, not {self.acceleration}")

    def clamp(self, position: float) -> float:
        """Return the nearest allowed position, same unit as the limits."""
        return min(max(position, self.lower), self.upper)

    def allows(self, position: float) -> bool:
        """Return whether a position lies within the limits, up to round-off."""
        largest = max((abs(limit) for limit in (self.lower, self.upper) if math.isfinite(limit)), default=0.0)
        return abs(position - self.clamp(position)) <= ROUND_OFF * largest + LEAST

    def step(self, current: float, velocity: float, target: float, dt: float) -> tuple[float, float]:
        """Advance a motion towards the clamped `target` by one step within all limits.

        After each step the motion can still stop before the target at the limit of acceleration, whatever the
        lengths of later steps: it passes a fixed target by at most `ARRIVED`. If the target jumps to within
        the stopping distance, the motion brakes fully, passes it and returns.

        Args:
            current: Position in [rad] or [m].
            velocity: Speed of the step before in [rad/s] or [m/s].
            target: Target position.
            dt: Length of the step in [s]; one below `SHORTEST_STEP_S` changes nothing.

        Returns:
            Position and speed after the step.
        """
        if not dt > SHORTEST_STEP_S:
            return current, velocity
        goal = self.clamp(target)
        way, change = goal - current, self.acceleration * dt
        straight = way / dt
        if (
            abs(straight) <= min(self.speed, math.sqrt(2.0 * self.acceleration * ARRIVED))
            and abs(straight - velocity) <= change
        ):
            return goal, straight
        desired = math.copysign(min(_stopping_speed(abs(way), self.acceleration, dt), self.speed), way)
        return self._advance(current, min(max(desired, velocity - change), velocity + change), dt)

    def brake(self, current: float, velocity: float, dt: float) -> tuple[float, float]:
        """Brake for one step at the acceleration limit; arguments and result as in `step`."""
        if not dt > SHORTEST_STEP_S:
            return current, velocity
        speed = math.copysign(max(abs(velocity) - self.acceleration * dt, 0.0), velocity)
        return self._advance(current, speed, dt)

    def _advance(self, current: float, speed: float, dt: float) -> tuple[float, float]:
        free = current + speed * dt
        after = self.clamp(free)
        return after, (speed if after == free else 0.0)


def _stopping_speed(way: float, acceleration: float, dt: float) -> float:
    """Return the largest speed v of a step of `dt` from which the motion can stop within `way` >= 0.

    Steps at full braking cover at most v^2 / (2 a), the limit for short ones. So v dt + v^2 / (2 a) = way,
    with the root in a form without a difference of nearly equal numbers.
    """
    return 2.0 * way / (dt + math.sqrt(dt * dt + 2.0 * way / acceleration))


def check_command(values: Sequence[float], joints: Sequence[str]) -> list[float]:
    """Return a checked command of one finite number per joint, in joint order.

    Args:
        values: Commanded positions in [rad] or [m], one per joint.
        joints: Joint names in command order.

    Returns:
        The values as floats, shape (len(joints),), not yet clamped.

    Raises:
        CommandError: the length is wrong or a value is not a finite number.
    """
    if len(values) != len(joints):
        raise CommandError(
            f"command of {len(values)} values refused: expected {len(joints)} ({listing(joints)}); "
            "nothing was moved"
        )
    for joint, value in zip(joints, values, strict=True):
        if not isinstance(value, numbers.Real) or not math.isfinite(value):
            raise CommandError(
                f"command {value} for joint {joint} refused: expected a finite number; nothing was moved"
            )
    return [float(value) for value in values]


MOST_LATE_S: Final = 0.5
"""Largest difference in [s] between a command's time stamp and the clock; others are refused."""

NOTHING: Final = 1e-9
"""A velocity or effort up to this, in [rad/s], [m/s], [N m] or [N], is round-off and counts as 0."""

LONGEST_NAME: Final = 40
"""Longest part of an unknown name in an error message, in characters."""


def check_named_command(
    names: Sequence[str], positions: Sequence[float], joints: Sequence[str]
) -> dict[str, float]:
    """Return positions by joint of a command for some joints, in any order.

    NaN means no command: that joint is left out.

    Args:
        names: Joints of the command, each once.
        positions: Positions in [rad] or [m], one per name.
        joints: All joints.

    Raises:
        CommandError: names are unknown or repeated, their number differs from that of the positions, or a
            position is infinite.
    """
    if len(names) > len(joints):
        raise _make_command_error(f"it names {len(names)} joints of {len(joints)} ({listing(joints)})")
    if len(names) != len(positions):
        raise _make_command_error(
            f"it has {len(positions)} positions for {len(names)} names; give one for each"
        )
    unknown = [name for name in names if name not in joints]
    if unknown:
        raise _make_command_error(f"unknown joints {_short(unknown)}; known joints: {listing(joints)}")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise _make_command_error(f"it names {_short(twice)} twice; name every joint once")
    command = {name: float(value) for name, value in zip(names, positions, strict=True) if value == value}
    for name, value in command.items():
        if math.isinf(value):
            raise _make_command_error(f"{value} for joint {name} is not finite; NaN stands for no command")
    return command


def check_positions_only(velocities: Sequence[float], efforts: Sequence[float]) -> None:
    """Refuse a command with velocities or efforts; only positions are supported.

    Raises:
        CommandError: a velocity or effort is neither NaN nor 0, up to round-off.
    """
    if says_something(velocities) or says_something(efforts):
        raise _make_command_error(
            "only positions are taken; leave velocity and effort empty, or fill them with NaN or 0"
        )


def says_something(values: Sequence[float]) -> bool:
    """Return whether any value of an optional field is neither NaN nor 0, up to round-off."""
    return any(abs(value) > NOTHING for value in values)


def check_age(stamp_s: float, now_s: float) -> None:
    """Refuse a command given too long ago, or in the future; time 0 is not checked.

    Args:
        stamp_s: Its time stamp in [s].
        now_s: Time of the receiver, on the clock of the stamps.

    Raises:
        CommandError: the times differ by more than MOST_LATE_S.
    """
    late = now_s - stamp_s
    if stamp_s != 0.0 and abs(late) > MOST_LATE_S:
        side = f"{late:.1f} s ago" if late > 0.0 else f"{-late:.1f} s ahead"
        raise _make_command_error(
            f"it is stamped {side}, allowed are {MOST_LATE_S:g} s; use one clock, or stamp it 0 for now"
        )


def _short(names: Sequence[str]) -> str:
    return listing([name[:LONGEST_NAME] for name in names])


def _make_command_error(problem: str) -> CommandError:
    return CommandError(f"joint command refused: {problem}; nothing was moved")
