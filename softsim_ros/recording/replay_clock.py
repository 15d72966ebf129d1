"""Where a replay stands: bag time as a function of the steady clock, with speed and pause."""

from __future__ import annotations

import math


class ReplayClock:
    """Bag time that runs at `speed` from a position on.

    Args:
        now: Steady clock in [s].
        position: Bag time to begin at in [s].
        speed: Seconds of the bag a second of the clock, > 0.

    Attributes:
        paused: Whether it stands still.
    """

    def __init__(self, now: float, position: float = 0.0, speed: float = 1.0) -> None:
        self._since, self._position, self._speed = now, position, speed
        self.paused = False

    def position(self, now: float) -> float:
        """Bag time in [s]."""
        return self._position + (0.0 if self.paused else (now - self._since) * self._speed)

    def wait_s(self, position: float, now: float) -> float:
        """How long until a bag time comes: 0 or less where it has passed, infinite while paused."""
        return math.inf if self.paused else (position - self.position(now)) / self._speed

    def set_speed(self, speed: float, now: float) -> None:
        """Go on from here at another speed."""
        self._position, self._since = self.position(now), now
        self._speed = speed

    def seek(self, position: float, now: float) -> None:
        """Go on from another bag time."""
        self._position, self._since = position, now

    def pause(self, paused: bool, now: float) -> None:
        """Stop here, or go on."""
        self._position, self._since = self.position(now), now
        self.paused = paused
