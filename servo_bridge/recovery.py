"""What the bridge wants to reach by itself, and when to try: at start and after a lost port. Pure."""

from __future__ import annotations

from random import Random
from typing import Literal, TypeAlias

Wish: TypeAlias = Literal["none", "configure", "activate"]

DELAYS_S = (0.5, 1.0, 2.0, 4.0, 5.0)
"""Waiting times between tries in [s]; the last one repeats."""


PROVEN_S = 5.0
"""A state that lasted for so long in [s] counts as reached; one lost earlier goes on with the back-off."""


class Recovery:
    """A wished state and a back-off between the tries to reach it, on a steady clock that is passed in.

    Args:
        jitter: Each delay is longer or shorter by up to this fraction, so that several bridges part.
        random: Where the jitter comes from.
    """

    def __init__(self, jitter: float = 0.0, random: Random | None = None) -> None:
        self._jitter, self._random = jitter, random or Random()
        self.wish: Wish = "none"
        self.tries = 0
        self._next_try = 0.0
        self._reached: float | None = None

    def want(self, wish: Wish, now: float, *, wait: bool) -> None:
        """Set the wish; the first try is due at once, or after a delay.

        The delay is the first one, unless what was reached before was lost again before it had proven itself.
        """
        flapping = self._reached is not None and now - self._reached < PROVEN_S
        self.wish, self._reached = wish, None
        if not (wait and flapping):
            self.tries = 0
        self._next_try = now
        if wait:
            self.failed(now)

    def reached(self, now: float) -> None:
        """The wish came true."""
        self.wish, self._reached = "none", now

    def give_up(self) -> None:
        """Want nothing any more."""
        self.wish = "none"

    def due(self, now: float) -> bool:
        """Whether it is time to try."""
        return self.wish != "none" and now >= self._next_try

    def failed(self, now: float) -> None:
        """The try did not succeed: wait longer before the next."""
        self._next_try = now + self._delay(self.tries)
        self.tries += 1

    def _delay(self, tries: int) -> float:
        delay = DELAYS_S[min(tries, len(DELAYS_S) - 1)]
        return delay * (1.0 + self._jitter * self._random.uniform(-1.0, 1.0))
