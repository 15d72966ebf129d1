"""Joint limits (position, speed, acceleration) and the check of a joint command: defined only here."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from dataclasses import dataclass

from softsim_core.errors import CommandError, SceneError, listing

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
