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
"""Steps of a motion shorter than this in [s] are none: nothing is divided by them."""

ROUND_OFF, LEAST = 1e-6, 1e-12
"""A position beyond a limit by this part of the larger limit, or by LEAST of its unit, is at the limit."""

ARRIVED = 1e-9
"""A motion whose way to stop is at most this in [rad] or [m] may end on its target."""


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Interval, top speed and top acceleration of a joint.

    Attributes:
        lower: Smallest position in [rad] (revolute), [m] (prismatic), or the unit of an actuator's command.
        upper: Largest position, same unit, >= lower.
        speed: Largest speed in [rad/s] or [m/s], > 0.
        acceleration: Largest change of speed in [rad/s^2] or [m/s^2], > 0; the servo bridge keeps it.

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
        """The nearest allowed position, same unit as the limits."""
        return min(max(position, self.lower), self.upper)

    def allows(self, position: float) -> bool:
        """Whether a position lies within the limits, but for the round-off of whoever computed it."""
        largest = max((abs(limit) for limit in (self.lower, self.upper) if math.isfinite(limit)), default=0.0)
        return abs(position - self.clamp(position)) <= ROUND_OFF * largest + LEAST

    def step(self, current: float, velocity: float, target: float, dt: float) -> tuple[float, float]:
        """One step of a motion that keeps every limit and comes to a stop on the clamped `target`.

        After each step there is room left to stop, at the limit of acceleration and whatever the lengths of
        the steps to come: a target that stays is not passed by more than `ARRIVED`. One that jumps nearer
        than the way to stop is passed, at full braking, and reached from the other side.

        Args:
            current: Position in [rad] or [m].
            velocity: Speed of the step before in [rad/s] or [m/s].
            target: Wanted position.
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
        wanted = math.copysign(min(_stopping_speed(abs(way), self.acceleration, dt), self.speed), way)
        return self._advance(current, min(max(wanted, velocity - change), velocity + change), dt)

    def brake(self, current: float, velocity: float, dt: float) -> tuple[float, float]:
        """One step of coming to a stop at the acceleration limit; arguments and result as of `step`."""
        if not dt > SHORTEST_STEP_S:
            return current, velocity
        speed = math.copysign(max(abs(velocity) - self.acceleration * dt, 0.0), velocity)
        return self._advance(current, speed, dt)

    def _advance(self, current: float, speed: float, dt: float) -> tuple[float, float]:
        free = current + speed * dt
        after = self.clamp(free)
        return after, (speed if after == free else 0.0)


def _stopping_speed(way: float, acceleration: float, dt: float) -> float:
    """Largest speed v of a step of `dt` after which v^2 / (2 a), the way to stop, is left of `way` >= 0.

    Steps that brake fully cover at most v^2 / (2 a), in the limit of short ones. So v dt + v^2 / (2 a) = way,
    whose root is written without a difference of near numbers.
    """
    return 2.0 * way / (dt + math.sqrt(dt * dt + 2.0 * way / acceleration))


def check_command(values: Sequence[float], joints: Sequence[str]) -> list[float]:
    """A command of one finite number per joint, in joint order; refused whole otherwise.

    Args:
        values: Commanded positions in [rad] or [m], one per joint.
        joints: Joint names in command order.

    Returns:
        The values as floats, shape (len(joints),), not yet clamped.

    Raises:
        CommandError: wrong length, or a value that is not a finite number.
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
"""A command given longer ago than this in [s], or so far ahead, is refused: clocks differ or it got stuck."""

NOTHING: Final = 1e-9
"""A velocity or effort up to this, in [rad/s], [m/s], [N m] or [N], is round-off and counts as 0."""

LONGEST_NAME: Final = 40
"""So many characters of a foreign name are shown in a refusal."""


def check_named_command(
    names: Sequence[str], positions: Sequence[float], joints: Sequence[str]
) -> dict[str, float]:
    """Positions by joint of a command for some joints, in any order.

    A NaN stands for no command: that joint is left out.

    Args:
        names: Joints of the command, each once.
        positions: In [rad] or [m], one a name.
        joints: Joints that there are.

    Raises:
        CommandError: unknown or repeated names, another number of positions, or an infinite one.
    """
    if len(names) > len(joints):
        raise _refused(f"it names {len(names)} joints of {len(joints)} ({listing(joints)})")
    if len(names) != len(positions):
        raise _refused(f"it has {len(positions)} positions for {len(names)} names; give one for each")
    unknown = [name for name in names if name not in joints]
    if unknown:
        raise _refused(f"unknown joints {_short(unknown)}; known joints: {listing(joints)}")
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise _refused(f"it names {_short(twice)} twice; name every joint once")
    command = {name: float(value) for name, value in zip(names, positions, strict=True) if value == value}
    for name, value in command.items():
        if math.isinf(value):
            raise _refused(f"{value} for joint {name} is not finite; NaN stands for no command")
    return command


def check_positions_only(velocities: Sequence[float], efforts: Sequence[float]) -> None:
    """Refuse a command that says more than positions, which nothing here obeys.

    Raises:
        CommandError: it has velocities or efforts that are neither NaN nor 0 but for round-off.
    """
    if says_something(velocities) or says_something(efforts):
        raise _refused(
            "only positions are taken; leave velocity and effort empty, or fill them with NaN or 0"
        )


def says_something(values: Sequence[float]) -> bool:
    """Whether any of the values of an optional field is neither NaN nor 0, but for round-off."""
    return any(abs(value) > NOTHING for value in values)


def check_age(given_s: float, now_s: float) -> None:
    """Refuse a command given too long ago, or in the future; time 0 says nothing.

    Args:
        given_s: Its time stamp in [s].
        now_s: The time of whoever obeys, on the clock of the stamps.

    Raises:
        CommandError: further from now than MOST_LATE_S.
    """
    late = now_s - given_s
    if given_s != 0.0 and abs(late) > MOST_LATE_S:
        side = f"{late:.1f} s ago" if late > 0.0 else f"{-late:.1f} s ahead"
        raise _refused(
            f"it is stamped {side}, allowed are {MOST_LATE_S:g} s; use one clock, or stamp it 0 for now"
        )


def _short(names: Sequence[str]) -> str:
    return listing([name[:LONGEST_NAME] for name in names])


def _refused(problem: str) -> CommandError:
    return CommandError(f"joint command refused: {problem}; nothing was moved")
