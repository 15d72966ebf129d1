"""A thread that calls a function at a fixed rate; nothing is queued and nothing is caught up."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PeriodFigures:
    """How well a rate was kept, over the newest calls.

    Attributes:
        mean_s: Mean period in [s].
        worst_s: Largest deviation of a period from the wanted one in [s].
        missed: Calls left out because the one before came too late, in total.
    """

    mean_s: float
    worst_s: float
    missed: int


class PeriodicThread:
    """Calls `tick` every `period` seconds of the steady clock until it is stopped, or raises.

    Args:
        tick: Called in the thread.
        period: Time between calls in [s], finite and > 0.
        name: Name of the thread.

    Attributes:
        failure: What `tick` raised: the thread has ended; None while it lives, or was stopped.

    Raises:
        ValueError: the period is not allowed.
    """

    def __init__(self, tick: Callable[[], None], period: float, name: str = "servo_board_writer") -> None:
        if not 0.0 < period < math.inf:  # also refuses NaN
            raise ValueError(f"period {period} s refused; it must be finite and > 0 s")
        self._tick, self.period = tick, period
        self.failure: Exception | None = None
        self._stopped, self._wake = False, threading.Event()
        self._periods: deque[float] = deque(maxlen=max(1, round(1.0 / period)))
        self._missed = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ask the thread to end; it may be in its last call still."""
        self._stopped = True
        self._wake.set()

    def hurry(self) -> None:
        """Make the next call at once; the beat goes on from there."""
        self._wake.set()

    def join(self) -> None:
        """Wait for the end of the thread; call it without a lock that `tick` takes."""
        if self._thread is not threading.current_thread():
            self._thread.join()

    def figures(self) -> PeriodFigures | None:
        """Of the newest second; None before two calls."""
        periods = tuple(self._periods)
        if not periods:
            return None
        worst = max(abs(each - self.period) for each in periods)
        return PeriodFigures(sum(periods) / len(periods), worst, self._missed)

    def _run(self) -> None:
        try:
            self._keep_time()
        except Exception as error:  # told to whoever supervises the thread
            self.failure = error

    def _keep_time(self) -> None:
        due = time.monotonic()
        last: float | None = None
        while True:
            hurried = self._wake.wait(max(due - time.monotonic(), 0.0))
            if self._stopped:
                return
            now = time.monotonic()
            if hurried:
                self._wake.clear()
                due = now
            elif last is not None:
                self._periods.append(now - last)
            last = now
            self._tick()
            due += self.period
            late = time.monotonic() - due
            if late > 0.0:  # the missed calls are left out; the next one keeps the beat
                skipped = int(late / self.period) + 1
                self._missed += skipped
                due += skipped * self.period
