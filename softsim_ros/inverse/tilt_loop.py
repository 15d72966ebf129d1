"""The closed loop on tilts between its messages: reference, measure, time, and when to hold. No ROS."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.inverse.closed_loop import TiltController, TiltGains


class LoopStep(NamedTuple):
    """One step of the loop: tilts about x and y in [rad], shape (2,); time in [s] since it was switched on.

    A step that holds has not run the law: the command is the last one, and its time does not count.
    """

    time: float
    reference: Array
    command: Array
    measure: Array
    holds: bool


class TiltLoop:
    """Runs the controller at the times it is asked to.

    Args:
        gains: Of the controller.
        measure_timeout: A measure older than this, in [s], holds the command.
    """

    def __init__(self, gains: TiltGains, measure_timeout: float) -> None:
        self.controller = TiltController(gains)
        self.measure_timeout = measure_timeout
        self.reference = np.zeros(2)
        self._measure = np.zeros(2)
        self._measured_at = -math.inf
        self.begin(0.0)

    @property
    def has_measure(self) -> bool:
        """Whether anything was ever measured."""
        return math.isfinite(self._measured_at)

    def begin(self, now: float) -> None:
        """Forget integral, command and time; `now` is a steady clock in [s]."""
        self.controller.reset()
        self._time = 0.0
        self._origin = self._last = now

    def measured(self, tilts: Array, now: float) -> None:
        """Take a measure: tilts about x and y in [rad], shape (2,), finite."""
        self._measure, self._measured_at = tilts.copy(), now

    def is_stale(self, now: float) -> bool:
        """Whether the measure is too old to be used."""
        return now - self._measured_at > self.measure_timeout

    def step(self, now: float) -> LoopStep | None:
        """One step at `now`; None before the first measure."""
        if not self.has_measure:
            self._origin = self._last = now
            return None
        holds = self.is_stale(now)
        if holds:
            self._origin += now - self._last
        else:
            time = now - self._origin
            # The difference of what is logged, so that the log gives the commands again to the last bit.
            self.controller.update(self.reference, self._measure, max(time - self._time, 0.0))
            self._time = max(time, self._time)
        self._last = now
        command = self.controller.command
        return LoopStep(self._time, self.reference.copy(), command, self._measure.copy(), holds)
