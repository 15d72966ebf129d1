"""Curves of the last half minute: joints, effector error, efforts, milliseconds per stage."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from softsim_core.arrays import Array
from softsim_ros.client.state import STALE_AFTER_S, RobotState

PERIOD_S: Final = 0.2
WINDOW: Final = 150
COLOURS: Final = ("#1971c2", "#e67700", "#2b8a3e", "#c92a2a", "#9c36b5", "#0c8599", "#868e96", "#5f3dc4")


class TimeAxis:
    """Simulated time of values that are seen between the simulator's reports, which come once a second.

    Time grows evenly between two reports. After the newest it grows by the real-time factor, and stands while
    the simulation does. Where no simulator reports, it is the time since `start`.

    Args:
        start: Time of the steady clock in [s].
    """

    def __init__(self, start: float) -> None:
        self._start = start
        self._reports: deque[tuple[float, float]] = deque(maxlen=WINDOW)
        self._rate = 0.0

    def follow(self, state: RobotState) -> bool:
        """Take what is known of the robot; True where time begins anew, as it does with a reset."""
        self._rate = 0.0 if state.stands else state.real_time_factor or 0.0
        if state.time_s is None or (self._reports and state.time_at <= self._reports[-1][0]):
            return False
        is_new = not self._reports or state.time_s < self._reports[-1][1]
        if is_new:
            self._reports.clear()
        self._reports.append((state.time_at, state.time_s))
        return is_new

    def times(self, seen: Sequence[float]) -> Array:
        """Return simulated times in [s] of times of the steady clock in [s]."""
        steady = np.asarray(seen, dtype=float)
        if not self._reports:
            return steady - self._start
        reported_at, reported = np.array(self._reports).T
        since = np.clip(steady - reported_at[-1], 0.0, STALE_AFTER_S)
        return np.asarray(np.interp(steady, reported_at, reported) + self._rate * since)


class Curves:
    """One chart with some series.

    Args:
        gui: viser's controls.
        title: Above the chart.
        names: One a series.
        axis: Times of the rows.
    """

    def __init__(self, gui: Any, title: str, names: Sequence[str], axis: TimeAxis) -> None:
        self.names, self._axis = tuple(names), axis
        self._rows: deque[tuple[float, ...]] = deque(maxlen=WINDOW)
        self._chart = gui.add_uplot(
            self._nothing(np.array([0.0, WINDOW * PERIOD_S])),
            (
                {"label": "t [s]"},
                *({"label": name, "stroke": COLOURS[i % 8], "width": 1.5} for i, name in enumerate(names)),
            ),
            title=title,
            scales={"x": {"time": False}},
            height=170,
        )

    def blank(self, now: float) -> None:
        """Show an axis of time that ends at `now`, steady clock, in [s], and nothing else."""
        self._rows.clear()
        self._chart.data = self._nothing(self._axis.times([now - WINDOW * PERIOD_S, now]))

    def add(self, now: float, values: Sequence[float]) -> None:
        """Add a row that is seen at `now`, steady clock, in [s]."""
        self._rows.append((now, *(float(value) for value in values)))
        seen, *columns = zip(*self._rows, strict=True)
        self._chart.data = self._axis.times(seen), *(np.array(column) for column in columns)

    def _nothing(self, times: Array) -> tuple[Array, ...]:
        """Values that are not drawn; without any, uPlot would not draw later ones either."""
        return times, *(np.full(len(times), np.nan) for _ in self.names)
