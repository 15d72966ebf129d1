"""A thread that calls a function at a fixed rate without catching up, and a watch for calls that hang."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

HANG_S = 1.0  # a call that has lasted this long in [s] counts as hanging: five times what a write may take
LONGEST_LOOK_S = 0.15  # most time in [s] that one check counts for; in a longer gap this computer was asleep
JOIN_S = 1.0  # longest wait in [s] for the end of a thread, or of a call that may hang


@dataclass(frozen=True, slots=True)
class PeriodFigures:
    """Regularity of the newest calls."""

    mean_s: float  # mean period in [s]
    worst_s: float  # largest deviation of a period from the nominal one in [s]
    missed: int  # total number of calls that were skipped because the one before was late


class PeriodicThread:
    """Thread that calls `tick` every `period` seconds of the steady clock until `stop`, or until it raises.

    The period in [s] is finite and > 0.

    Attributes:
        failure: The exception of `tick` that ended the thread; None while it runs, and after `stop`.
        call: Number of the call in progress; None between calls.

    Raises:
        ValueError: the period is not allowed.
    """

    def __init__(self, tick: Callable[[], None], period: float) -> None:
        if not 0.0 < period < math.inf:  # also refuses NaN
            raise ValueError(f"period {period} s refused; it must be finite and > 0 s")
        self._tick, self.period = tick, period
        self.failure: Exception | None = None
        self.call: int | None = None
        self._calls = 0
        self._stopped, self._wake = False, threading.Event()
        self._periods: deque[float] = deque(maxlen=max(1, round(1.0 / period)))
        self._missed = 0
        self._thread = threading.Thread(target=self._run, name="servo_board_writer", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Ask the thread to end; its last call may still be in progress."""
        self._stopped = True
        self._wake.set()

    def hurry(self) -> None:
        """Make the next call at once; later calls follow at the period from there."""
        self._wake.set()

    def join(self, timeout_s: float = JOIN_S) -> bool:
        """Wait for the end of the thread; call it without a lock that `tick` takes.

        Returns:
            True if it has ended, or ends with the call from which it was joined; False if `tick` hangs.
        """
        if self._thread is threading.current_thread():
            return True
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def figures(self) -> PeriodFigures | None:
        """Return the regularity over the newest second; None before two calls."""
        periods = tuple(self._periods)
        if not periods:
            return None
        worst = max(abs(each - self.period) for each in periods)
        return PeriodFigures(sum(periods) / len(periods), worst, self._missed)

    def _run(self) -> None:
        try:
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
                if late > 0.0:  # skip the missed calls; the next one is on the original schedule
                    skipped = int(late / self.period) + 1
                    self._missed += skipped
                    due += skipped * self.period
        except Exception as error:  # reported by the supervisor of the thread, see `failure`
            self.failure = error


class HangDetector:
    """Detects a call of a thread that does not return, by repeated checks while it lasts.

    One check counts for at most LONGEST_LOOK_S, however long ago the one before was, so a computer that slept
    finds no hang.
    """

    def __init__(self, thread: PeriodicThread, clock: Callable[[], float] = time.monotonic) -> None:
        self._thread, self._clock = thread, clock
        self._call: int | None = None
        self._looked, self._lasted_s = clock(), 0.0

    @property
    def hangs(self) -> bool:
        """Whether the watched call counts as hanging."""
        return self._lasted_s >= HANG_S

    def look(self) -> bool:
        """Check now and return whether the call hangs; call this several times per second."""
        now, call = self._clock(), self._thread.call
        same = call is not None and call == self._call
        self._lasted_s = self._lasted_s + min(now - self._looked, LONGEST_LOOK_S) if same else 0.0
        self._call, self._looked = call, now
        return self.hangs


def run_with_timeout(call: Callable[[], object]) -> None:
    """Run a call that may hang in a thread of its own, and wait for its end, also by an error, for JOIN_S."""

    def run() -> None:
        with contextlib.suppress(Exception):  # nothing more can be done about a port that fails to close
            call()

    thread = threading.Thread(target=run, name="servo_board_closer", daemon=True)
    thread.start()
    thread.join(JOIN_S)
