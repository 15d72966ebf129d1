"""What a driver's packets are for: nothing, to follow commands, or to go to rest and end there. No I/O."""

from __future__ import annotations

import threading
from typing import Literal, TypeAlias

from servo_bridge.safety import ServoMotion

REST_REPEATS = 3
"""Last packets are sent so often: one byte lost on the line does not decide where the servos stay."""

Aim: TypeAlias = Literal["listen", "follow", "settle"]


class Course:
    """The present aim, and how far the way to rest has come.

    Attributes:
        settled: Set while the servos are not on the way to rest.
    """

    def __init__(self) -> None:
        self.settled = threading.Event()
        self.settled.set()
        self._aim: Aim = "follow"
        self._settle_until = 0.0
        self._rest_packets = 0  # sent at the end of the way to rest

    @property
    def listens(self) -> bool:
        """Whether no pose is to be sent."""
        return self._aim == "listen"

    @property
    def settles(self) -> bool:
        """Whether the servos are on the way to rest."""
        return self._aim == "settle"

    @property
    def arrived(self) -> bool:
        """Whether the newest way to rest ended there."""
        return self._rest_packets >= REST_REPEATS

    def follow(self) -> None:
        """Follow commands from now on."""
        self._aim = "follow"

    def settle(self, until: float) -> None:
        """Go to rest; after the time `until` in [s] brake and stay where the servos are by then."""
        self._aim, self._rest_packets = "settle", 0
        self._settle_until = until
        self.settled.clear()

    def end(self) -> None:
        """Only listen from now on."""
        self._aim = "listen"
        self.settled.set()

    def step(self, motion: ServoMotion, now: float) -> tuple[float, ...]:
        """The next pose in [rad] to send."""
        if not self.settles:
            return motion.step(now)
        return motion.brake(now) if self._late(now) else motion.step_to_rest(now)

    def sent(self, motion: ServoMotion, now: float) -> bool:
        """The pose of `step` has left: whether the way to rest ends with it, arrived or out of time."""
        if not self.settles:
            return False
        self._rest_packets += motion.at_rest
        return self.arrived or (self._late(now) and motion.standing)

    def _late(self, now: float) -> bool:
        return now >= self._settle_until
