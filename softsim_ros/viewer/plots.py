"""Curves of the last half minute: joints, effector error, efforts, milliseconds per stage."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from softsim_core.arrays import Array

PERIOD_S: Final = 0.2
WINDOW: Final = 150
COLOURS: Final = ("#1971c2", "#e67700", "#2b8a3e", "#c92a2a", "#9c36b5", "#0c8599", "#868e96", "#5f3dc4")


class Curves:
    """One chart with some series; times in [s] grow.

    Args:
        gui: viser's controls.
        title: Above the chart.
        names: One a series.
    """

    def __init__(self, gui: Any, title: str, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._rows: deque[tuple[float, ...]] = deque(maxlen=WINDOW)
        self._chart = gui.add_uplot(
            self._data(),
            (
                {"label": "s"},
                *({"label": name, "stroke": COLOURS[i % 8], "width": 1.5} for i, name in enumerate(names)),
            ),
            title=title,
            scales={"x": {"time": False}},
            height=170,
        )

    def remove(self) -> None:
        """Take the chart from the page."""
        self._chart.remove()

    def add(self, time_s: float, values: Sequence[float]) -> None:
        """One more row; a time before the last one begins anew."""
        if self._rows and time_s < self._rows[-1][0]:
            self._rows.clear()
        self._rows.append((time_s, *(float(value) for value in values)))
        self._chart.data = self._data()

    def _data(self) -> tuple[Array, ...]:
        if not self._rows:
            return tuple(np.zeros(0) for _ in range(len(self.names) + 1))
        return tuple(np.array(column) for column in zip(*self._rows, strict=True))
