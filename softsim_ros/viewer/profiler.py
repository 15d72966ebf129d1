"""The profiler of the page: durations of the last steps, and the stages of the one that is looked at."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.dynamics.stages import PART_OF
from softsim_ros.viewer.panel import Inbox, Shown
from softsim_ros.viewer.plots import COLOURS
from softsim_ros.viewer.stage_tables import step_table


class Profile:
    """The last steps; they stand still from the moment a person looks at one of them.

    Attributes:
        stages: Names of the stages, length s.
        rows: Number, simulated time in [s] and the time of each stage in [ms], shape (k, 2 + s).
        at: Row that is looked at.
        held: Whether newer steps are kept out.
    """

    def __init__(self) -> None:
        self.stages: tuple[str, ...] = ()
        self.rows: Array = np.zeros((0, 2))
        self.at, self.held = 0, False

    def take(self, stages: tuple[str, ...], rows: Array) -> None:
        """Newer steps: the last of them is looked at, unless these stand still."""
        if not self.held:
            self.stages, self.rows, self.at = stages, rows, max(0, len(rows) - 1)

    def look_at(self, row: int) -> None:
        """Hold the steps, where there are some, and look at the nearest there is."""
        self.held = len(self.rows) > 0
        self.at = max(0, min(row, len(self.rows) - 1))

    def look_at_slowest(self) -> None:
        """Hold the steps and look at the longest."""
        self.look_at(int(np.argmax(self.durations)) if len(self.rows) else 0)

    def follow(self) -> None:
        """Let newer steps in again."""
        self.held = False

    @property
    def durations(self) -> Array:
        """Time of each step with all that follows it, in [ms], shape (k,)."""
        tops = [2 + i for i, name in enumerate(self.stages) if PART_OF.get(name) not in self.stages]
        return np.asarray(self.rows[:, tops].sum(axis=1))

    def table(self) -> str:
        """The tree of the step that is looked at, as HTML; empty while there are no steps."""
        if not len(self.rows):
            return ""
        step, time_s, *times = self.rows[self.at].tolist()
        return step_table(int(step), time_s, dict(zip(self.stages, times, strict=True)))


class ProfilerView:
    """Curve, slider, buttons and tree.

    Args:
        gui: viser's controls, inside the tab.
        inbox: Where events of browsers go.
    """

    HEIGHT: Final = 170

    def __init__(self, gui: Any, inbox: Inbox) -> None:
        self._profile = Profile()
        self._newest: object = None
        series = ("duration", COLOURS[0]), ("looked at", COLOURS[3])
        self._chart = gui.add_uplot(
            tuple(np.zeros(0) for _ in range(3)),
            ({"label": "step"}, *({"label": n, "stroke": c, "width": 1.2} for n, c in series)),
            title="Time of the last steps [ms]",
            scales={"x": {"time": False}},
            height=self.HEIGHT,
        )
        self._slider = gui.add_slider(
            "Step shown", 0, 1, 1, 0, hint="The newest is right; moving it holds the steps still."
        )
        follow = gui.add_checkbox("Follow the newest step", True)
        slowest = gui.add_button("Jump to the slowest step")
        self._table = Shown(gui.add_html(""))
        look_at = self._profile.look_at
        self._row = inbox.on_change(self._slider, lambda row: self._change(lambda: look_at(int(row))))
        self._following = inbox.on_change(follow, self._switch)
        inbox.on_click(slowest, lambda: self._change(self._profile.look_at_slowest))

    def refresh(self, newest: tuple[tuple[str, ...], Array] | None) -> None:
        """Show newer steps: names of their stages, and rows as of `Profile`."""
        if newest is not None and newest is not self._newest and not self._profile.held:
            self._newest = newest
            self._profile.take(*newest)
            self._draw()
        self._row.show(self._profile.at)
        self._following.show(not self._profile.held)

    def _switch(self, follow: bool) -> None:
        self._change(self._profile.follow if follow else lambda: self._profile.look_at(self._profile.at))

    def _change(self, action: Any) -> None:
        action()
        self._draw()

    def _draw(self) -> None:
        profile = self._profile
        durations = profile.durations
        mark = np.zeros(len(durations))
        mark[profile.at : profile.at + 1] = durations.max(initial=0.0)
        self._chart.data = (profile.rows[:, 0].copy(), durations, mark)
        self._slider.max = max(1, len(durations) - 1)
        self._table.show(profile.table())
