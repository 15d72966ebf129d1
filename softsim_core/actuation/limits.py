"""Joint limits (position and speed) and the check of a joint command: defined here and nowhere else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from softsim_core.errors import CommandError, SceneError, listing


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Interval and top speed of a joint.

    Attributes:
        lower: Smallest position in [rad] (revolute) or [m] (prismatic, cable).
        upper: Largest position, same unit, >= lower.
        speed: Largest speed in [rad/s] or [m/s], > 0.

    Raises:
        SceneError: the interval is empty or the speed is not positive.
    """

    lower: float = -math.inf
    upper: float = math.inf
    speed: float = math.inf

    def __post_init__(self) -> None:
        if not self.lower <= self.upper:  # also rejects NaN
            raise SceneError(f"joint limits need lower <= upper, not [{self.lower}, {self.upper}]")
        if not self.speed > 0.0:
            raise SceneError(f"joint speed limit must be > 0, not {self.speed}")

    def clamp(self, position: float) -> float:
        """The nearest allowed position, same unit as the limits."""
        return min(max(position, self.lower), self.upper)

    def towards(self, current: float, target: float, dt: float) -> float:
        """Position after moving from `current` towards the clamped `target` for `dt` seconds."""
        reach = self.speed * dt
        return min(max(self.clamp(target), current - reach), current + reach)


def check_command(values: Sequence[float], joints: Sequence[str]) -> list[float]:
    """A command of one finite number a joint, in joint order; refused whole otherwise.

    Args:
        values: Commanded positions in [rad] or [m], one a joint.
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
        if not math.isfinite(value):
            raise CommandError(
                f"command {value} for joint {joint} refused: expected a finite number; nothing was moved"
            )
    return [float(value) for value in values]
