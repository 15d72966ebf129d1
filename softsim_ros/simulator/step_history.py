"""The last steps with the time of each of their stages, in a ring."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Final

import numpy as np

from softsim_core.arrays import Array

LENGTH: Final = 1000
"""Steps that are kept."""


class StepHistory:
    """Filled from one thread, read from any.

    Args:
        length: Steps that are kept, >= 1.
    """

    def __init__(self, length: int = LENGTH) -> None:
        self._length, self._count = length, 0
        self._stages: tuple[str, ...] = ()
        self._rows = np.zeros((length, 0))
        self._lock = threading.Lock()

    def add(self, step: int, time_s: float, stages_ms: Mapping[str, float]) -> None:
        """Keep one more step; stages of other names, or an earlier step, begin a new history.

        Args:
            step: Its number.
            time_s: Simulated time at its end in [s].
            stages_ms: Time of each stage in [ms].
        """
        stages = tuple(stages_ms)
        with self._lock:
            last = self._rows[(self._count - 1) % self._length, 0] if self._count else -1
            if stages != self._stages or step <= last:
                self._stages, self._count = stages, 0
                self._rows = np.zeros((self._length, 2 + len(stages)))
            self._rows[self._count % self._length] = (step, time_s, *stages_ms.values())
            self._count += 1

    def steps(self) -> tuple[tuple[str, ...], Array]:
        """Names of the stages, and a row a step, oldest first: number, time in [s], stages in [ms]."""
        with self._lock:
            kept = min(self._count, self._length)
            order = np.arange(self._count - kept, self._count) % self._length
            return self._stages, self._rows[order]
