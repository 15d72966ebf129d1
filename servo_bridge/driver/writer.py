"""A thread that calls a function at a fixed rate, nothing queued or caught up; and calls that may hang."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

HANG_S = 1.0
"""A call that has lasted for so long in [s] does not come back: five times what a write may take."""

LONGEST_LOOK_S = 0.15
"""Time in [s] that one look stands for at most: longer, and it was this computer that slept."""

JOIN_S = 1.0
"""Longest wait in [s] for the end of a thread, or of a call that may hang."""


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
        call: Number of the call that runs now; None between calls.

    Raises:
        ValueError: the period is not allowed.
    """

    def __init__(self, tick: Callable[[], None], period: float, name: str = "servo_board_writer") -> None:
        if not 0.0 < period < math.inf:  # also refuses NaN
            raise ValueError(f"period {period} s refused; it must be finite and > 0 s")
        self._tick, self.period = tick, period
        self.failure: Exception | None = None
        self.call: int | None = None
        self._calls = 0
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

    def join(self, timeout_s: float = JOIN_S) -> bool:
        """Wait for the end of the thread; call it without a lock that `tick` takes.

        Returns:
            Whether it has ended, or ends with the call from which it was joined; False: `tick` hangs.
        """
        if self._thread is threading.current_thread():
            return True
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

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
            self._calls += 1
            self.call = self._calls
            self._tick()
            self.call = None
            due += self.period
            late = time.monotonic() - due
            if late > 0.0:  # the missed calls are left out; the next one keeps the beat
                skipped = int(late / self.period) + 1
                self._missed += skipped
                due += skipped * self.period


class HangWatch:
    """Whether a thread's call does not come back, judged by looks at it while it lasts.

    A look counts for little, however long ago the one before was: a computer that slept finds no hang.

    Args:
        thread: Watched.
        clock: Steady clock in [s].
    """

    def __init__(self, thread: PeriodicThread, clock: Callable[[], float] = time.monotonic) -> None:
        self._thread, self._clock = thread, clock
        self._call: int | None = None
        self._looked, self._lasted_s = clock(), 0.0

    @property
    def hangs(self) -> bool:
        """Whether the looks so far say so."""
        return self._lasted_s >= HANG_S

    def look(self) -> bool:
        """Look now; call it several times a second. Whether the call hangs."""
        now, call = self._clock(), self._thread.call
        same = call is not None and call == self._call
        self._lasted_s = self._lasted_s + min(now - self._looked, LONGEST_LOOK_S) if same else 0.0
        self._call, self._looked = call, now
        return self.hangs


def ends_in_time(call: Callable[[], object], timeout_s: float = JOIN_S) -> bool:
    """Make a call that may hang in a thread of its own; whether it came back, also with an error, in time."""

    def run() -> None:
        with contextlib.suppress(Exception):  # whoever closes a port that failed can do no more about it
            call()

    thread = threading.Thread(target=run, name="servo_board_closer", daemon=True)
    thread.start()
    thread.join(timeout_s)
    return not thread.is_alive()
