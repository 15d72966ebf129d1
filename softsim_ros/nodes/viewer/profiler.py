"""Durations of steps and stages as curves, tables and a profile."""

from __future__ import annotations

import html
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from softsim_core.base import Array
from softsim_core.physics.dynamics import PART_OF, stage_tree
from softsim_node import NEWEST_ONLY
from softsim_ros.client import STALE_AFTER_S, RobotState
from softsim_ros.messages import read_step_profile
from softsim_ros.nodes.viewer.panel import HtmlElement, Inbox
from softsim_ros.nodes.viewer.readings import box


class StepStatistics:
    """Subscribes to `stage_statistics` and `step_profile` in the node's namespace.

    Attributes:
        stages: Statistics of each stage of a step, by name.
        profile: Stages and rows of the last steps, see `step_profile`; None until received.
    """

    def __init__(self, node: Node) -> None:
        self.profile: tuple[tuple[str, ...], Array] | None = None
        self.stages: dict[str, dict[str, str]] = {}
        node.create_subscription(DiagnosticArray, "stage_statistics", self._on_stages, NEWEST_ONLY)
        node.create_subscription(Float64MultiArray, "step_profile", self._on_profile, NEWEST_ONLY)

    def _on_stages(self, message: DiagnosticArray) -> None:
        self.stages = {
            status.name: {pair.key: pair.value for pair in status.values} for status in message.status
        }

    def _on_profile(self, message: Float64MultiArray) -> None:
        self.profile = read_step_profile(message)


Stage = Mapping[str, str]

STATISTICS: Final = {
    "calls": ("calls", 0),
    "percent": ("%", 1),
    "mean_ms": ("mean", 2),
    "deviation_ms": ("±", 2),
    "min_ms": ("min", 2),
    "max_ms": ("max", 2),
    "total_ms": ("total", 0),
}
"""Columns of the statistics: value of the topic `stage_statistics`, title, displayed digits."""


def stage_table(stages: Mapping[str, Stage]) -> str:
    """Return a table of each stage over a second: calls, times per call and in total in [ms], percentage."""
    if not stages:
        return box("no statistics yet; is the simulator running?")
    rows = [
        (
            _indent(name, int(values.get("level", "0"))),
            *(
                f"{float(number):.{digits}f}" if (number := values.get(column, "")) else ""
                for column, (_, digits) in STATISTICS.items()
            ),
        )
        for name, values in stages.items()
    ]
    titles = ("stage", *(title for title, _ in STATISTICS.values()))
    return _table("<b>the last second</b>, in ms", titles, rows)


def step_table(step: int, time_s: float, times_ms: Mapping[str, float]) -> str:
    """Return the tree of one step: time of each stage and its own time without its parts.

    Both are also shown in percent.
    """
    tree = stage_tree(times_ms)
    whole = sum(share.total for share in tree if share.level == 0)
    percent = 100.0 / (whole or 1.0)
    rows = [
        (
            _indent(share.name, share.level),
            f"{percent * share.total:.1f}",
            f"{percent * share.own:.1f}",
            f"{share.total:.3f}",
            f"{share.own:.3f}",
        )
        for share in tree
    ]
    title = f"<b>step {step}</b>, t = {time_s:.3f} s: {whole:.3f} ms"
    return _table(title, ("stage", "total %", "self %", "time ms", "self ms"), rows)


def _indent(name: str, level: int) -> str:
    return "\u00a0" * 2 * level + name  # non-breaking spaces, which HTML does not collapse


def _table(title: str, titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table with text in the first column and numbers in the others."""
    body = "".join(f"<tr>{_cells('td', row)}</tr>" for row in rows)
    return box(
        f'{title}<div style="overflow-x:auto"><table style="width:100%;border-spacing:0;font-size:0.9em">'
        f"<tr>{_cells('th', titles)}</tr>{body}</table></div>"
    )


def _cells(tag: str, row: Sequence[str]) -> str:
    sides = ["left"] + ["right"] * (len(row) - 1)
    return "".join(
        f'<{tag} style="text-align:{side};white-space:nowrap;padding:0 1px">{html.escape(value)}</{tag}>'
        for value, side in zip(row, sides, strict=True)
    )


PERIOD_S: Final = 0.2
WINDOW: Final = 150
HEIGHT: Final = 170
"""Height of a chart in pixels."""
COLOURS: Final = ("#1971c2", "#e67700", "#2b8a3e", "#c92a2a", "#9c36b5", "#0c8599", "#868e96", "#5f3dc4")


class TimeAxis:
    """Simulated time of samples taken between the simulator's reports, which arrive once per second.

    Between two reports time is interpolated linearly. After the newest one it grows by the real-time factor,
    and stops while the simulation is paused. If no simulator reports, it is the time since `start` on the
    steady clock, in [s].
    """

    def __init__(self, start: float) -> None:
        self._start = start
        self._reports: deque[tuple[float, float]] = deque(maxlen=WINDOW)
        self._rate = 0.0

    def follow(self, state: RobotState) -> bool:
        """Take the newest state of the robot; return True if time restarted, as after a reset."""
        self._rate = 0.0 if state.stands else state.real_time_factor or 0.0
        if state.time_s is None or (self._reports and state.time_at <= self._reports[-1][0]):
            return False
        is_new = not self._reports or state.time_s < self._reports[-1][1]
        if is_new:
            self._reports.clear()
        self._reports.append((state.time_at, state.time_s))
        return is_new

    def times(self, clock_times_s: Sequence[float]) -> Array:
        """Return simulated times in [s] for times of the steady clock in [s]."""
        steady = np.asarray(clock_times_s, dtype=float)
        if not self._reports:
            return steady - self._start
        reported_at, reported = np.array(self._reports).T
        since = np.clip(steady - reported_at[-1], 0.0, STALE_AFTER_S)
        return np.asarray(np.interp(steady, reported_at, reported) + self._rate * since)


class Curves:
    """One chart with several series over time."""

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
            height=HEIGHT,
        )

    def blank(self, now: float) -> None:
        """Show an empty time axis that ends at `now`, steady clock, in [s]."""
        self._rows.clear()
        self._chart.data = self._nothing(self._axis.times([now - WINDOW * PERIOD_S, now]))

    def add(self, now: float, values: Sequence[float]) -> None:
        """Add a row sampled at `now`, steady clock, in [s]."""
        self._rows.append((now, *(float(value) for value in values)))
        clock_times_s, *columns = zip(*self._rows, strict=True)
        self._chart.data = self._axis.times(clock_times_s), *(np.array(column) for column in columns)

    def _nothing(self, times: Array) -> tuple[Array, ...]:
        """Return values that are not drawn; uPlot would draw no later values if there were none at first."""
        return times, *(np.full(len(times), np.nan) for _ in self.names)


class Profile:
    """The last steps; they are frozen while the user examines one of them.

    Attributes:
        stages: Names of the stages, length s.
        rows: Number, simulated time in [s] and the time of each stage in [ms], shape (k, 2 + s).
        at: Index of the selected row.
        is_frozen: Whether the steps are frozen.
    """

    def __init__(self) -> None:
        self.stages: tuple[str, ...] = ()
        self.rows: Array = np.zeros((0, 2))
        self.at, self.is_frozen = 0, False

    def take(self, stages: tuple[str, ...], rows: Array) -> None:
        """Take newer steps and select the last one, unless the steps are frozen."""
        if not self.is_frozen:
            self.stages, self.rows, self.at = stages, rows, max(0, len(rows) - 1)

    def look_at(self, row: int) -> None:
        """Freeze the steps, if there are any, and select a row, or the nearest one."""
        self.is_frozen = len(self.rows) > 0
        self.at = max(0, min(row, len(self.rows) - 1))

    def look_at_slowest(self) -> None:
        """Freeze the steps and select the longest."""
        self.look_at(int(np.argmax(self.durations)) if len(self.rows) else 0)

    def follow(self) -> None:
        """Unfreeze, so that newer steps are shown again."""
        self.is_frozen = False

    @property
    def durations(self) -> Array:
        """Time of each step including what follows it, in [ms], shape (k,)."""
        tops = [2 + i for i, name in enumerate(self.stages) if PART_OF.get(name) not in self.stages]
        return np.asarray(self.rows[:, tops].sum(axis=1))

    def table(self) -> str:
        """Return the tree of the selected step as HTML; empty if there are no steps."""
        if not len(self.rows):
            return ""
        step, time_s, *times = self.rows[self.at].tolist()
        return step_table(int(step), time_s, dict(zip(self.stages, times, strict=True)))


class ProfilerView:
    """Chart, slider, buttons and tree of the profiler."""

    def __init__(self, gui: Any, inbox: Inbox) -> None:
        self._profile = Profile()
        self._newest: object = None
        series = ("duration", COLOURS[0]), ("looked at", COLOURS[3])
        self._chart = gui.add_uplot(
            tuple(np.zeros(0) for _ in range(3)),
            ({"label": "step"}, *({"label": n, "stroke": c, "width": 1.2} for n, c in series)),
            title="Time of the last steps [ms]",
            scales={"x": {"time": False}},
            height=HEIGHT,
        )
        self._slider = gui.add_slider(
            "Step shown", 0, 1, 1, 0, hint="The newest is right; moving it holds the steps still."
        )
        follow = gui.add_checkbox("Follow the newest step", True)
        slowest = gui.add_button("Jump to the slowest step")
        self._table = HtmlElement(gui.add_html(""))
        look_at = self._profile.look_at
        self._row = inbox.on_change(self._slider, lambda row: self._change(lambda: look_at(int(row))))
        self._following = inbox.on_change(follow, self._switch)
        inbox.on_click(slowest, lambda: self._change(self._profile.look_at_slowest))

    def refresh(self, newest: tuple[tuple[str, ...], Array] | None) -> None:
        """Show newer steps: names of their stages, and rows as in `Profile`."""
        if newest is not None and newest is not self._newest and not self._profile.is_frozen:
            self._newest = newest
            self._profile.take(*newest)
            self._draw()
        self._row.show(self._profile.at)
        self._following.show(not self._profile.is_frozen)

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
