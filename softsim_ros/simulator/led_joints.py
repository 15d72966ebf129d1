"""Joints that somebody else moves, such as those of a real arm: they go where its joint states say."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Final

import numpy as np

from softsim_core.simulation import Simulation

LONGEST_S: Final = 0.2
"""The way from one message to the next takes this long at most, in [s]."""


class LedJoints:
    """Positions of joints by name, on their way from one message to the next.

    A joint takes as long from one place to the next as there is between the stamps of the messages: what
    hangs on it feels an even motion, one message late, and no jerk at each of them.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: tuple[float, dict[str, float]] | None = None
        self._stamp, self._span, self._spent = -np.inf, 0.0, 0.0
        self._from: dict[str, float] = {}
        self._to: dict[str, float] = {}

    def hear(self, positions: Mapping[str, float], stamp: float) -> None:
        """Take a message of a time stamp in [s]; from any thread."""
        with self._lock:
            self._newest = stamp, dict(positions)

    def advance(self, simulation: Simulation) -> dict[str, float]:
        """Where joints that the simulation has are led at the end of the next step; in its thread."""
        with self._lock:
            newest, self._newest = self._newest, None
        if newest is not None:
            stamp, positions = newest
            self._from = {name: self._now(name, there) for name, there in positions.items()}
            self._to = positions
            self._span = min(max(stamp - self._stamp, simulation.dt), LONGEST_S)
            self._stamp, self._spent = stamp, 0.0
        self._spent += simulation.dt
        known = simulation.joint_names
        return {name: self._now(name, there) for name, there in self._to.items() if name in known}

    def _now(self, name: str, there: float) -> float:
        if name not in self._to or name not in self._from:
            return there
        share = min(self._spent / self._span, 1.0) if self._span > 0.0 else 1.0
        return self._from[name] + share * (self._to[name] - self._from[name])
