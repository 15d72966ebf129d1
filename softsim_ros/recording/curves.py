"""Charts of a report: quantities of a bag over time, or a message about missing topics; drawn as SVG."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from softsim_core import RobotDescription
from softsim_core.base import Array
from softsim_ros import figure_data
from softsim_ros.recording.bag import Bag
from softsim_ros.recording.tables import diagnostic_row

MM = 1000.0
DEGREES = math.degrees(1.0)
SIZE_INCHES = (8.0, 2.6)
FRAME = (0.10, 0.18, 0.69, 0.76)
"""Left, bottom, width and height of every chart as fractions of the picture, so that all time axes align."""

MOST_POINTS = 2000
"""Largest number of drawn points of a curve; more make the file larger, but the picture no finer."""

STYLES: dict[str, dict[str, Any]] = {
    "line": {"linewidth": 1.3},
    "dashed": {"linewidth": 1.0, "linestyle": "--"},
    "steps": {"linewidth": 1.0, "linestyle": ":", "drawstyle": "steps-post"},
}


@dataclass(frozen=True)
class Curve:
    """A quantity over time.

    Attributes:
        name: Name in the legend; an empty one is left out.
        times: Time since the bag's first message in [s], shape (n,).
        values: In the chart's unit, shape (n,).
        style: "line", "dashed", or "steps" for values that are constant until the next one.
        colour: Number of the colour; curves that belong together share one.
    """

    name: str
    times: Array
    values: Array
    style: str = "line"
    colour: int = 0


@dataclass(frozen=True)
class Chart:
    """Curves with one axis.

    Attributes:
        title: Title above the chart.
        unit: Unit of the vertical axis.
        curves: Curves to draw; empty if data are missing.
        levels: Horizontal lines, such as limits.
        caption: Text below the title: what is missing, or what the chart shows.
    """

    title: str
    unit: str
    curves: tuple[Curve, ...] = ()
    levels: tuple[float, ...] = ()
    caption: str = ""


@dataclass
class _Series:
    """Rows that are collected one by one."""

    times: list[float] = field(default_factory=list)
    rows: list[Sequence[float]] = field(default_factory=list)

    def curve(self, name: str, column: int, scale: float, style: str = "line", colour: int = 0) -> Curve:
        values = np.array([row[column] if column < len(row) else math.nan for row in self.rows])
        return Curve(name, np.array(self.times), scale * values, style, colour)


def charts(bag: Bag, robot: RobotDescription | None) -> list[Chart]:
    """Return all charts of a report, each with its curves or with a message about missing topics.

    The robot gives the units and limits of its joints; it is None if it is not known here.
    """
    return [
        *_joint_charts(bag, robot),
        *_effector_charts(bag),
        _from_diagnostics(
            bag,
            "Residuals of inverse control",
            "mm, rad",
            "/inverse_controller",
            "residual_mm",
            "residual_rad",
        ),
        _stress(bag),
        _from_diagnostics(bag, "Real-time factor", "-", "/simulator", "real_time_factor", levels=(0.0, 1.0)),
        _from_diagnostics(bag, "Time of each stage of a step", "ms", "/simulator", "_ms"),
    ]


def missing(bag: Bag, *topics: str) -> str:
    """Return a message about topics that a bag does not contain; an empty string if it contains all."""
    names = [bag.topic(topic) for topic in topics if not bag.counts.get(bag.topic(topic))]
    return f"Not in this recording: {', '.join(names)}." if names else ""


def _series(bag: Bag, topic: str, row: Callable[[Any], Sequence[float]]) -> _Series:
    """Return the rows of all messages on a topic of the robot."""
    series = _Series()
    for stamp, message in bag.messages(bag.topic(topic)):
        series.times.append(1e-9 * (stamp - bag.begin_ns))
        series.rows.append(row(message))
    return series


def _joint_charts(bag: Bag, robot: RobotDescription | None) -> Iterator[Chart]:
    names: list[str] = []
    for _, message in bag.messages(bag.topic("joint_states")):
        names = list(message.name)
        break
    absent = missing(bag, "joint_states")
    positions = _series(bag, "joint_states", lambda message: message.position.tolist())
    efforts = _series(bag, "joint_states", lambda message: message.effort.tolist())
    commands = _series(bag, "position_controller/commands", lambda message: message.data.tolist())
    kinds = {joint.name: joint for joint in robot.joints} if robot else {}
    groups = (
        ("Joint angles", "deg", DEGREES, "N m", [n for n in names if _revolute(kinds, n)]),
        ("Joint travels", "mm", MM, "N", [n for n in names if not _revolute(kinds, n)]),
    )
    if robot is None:
        no_limits = f"No limits are drawn: there is no robot called {bag.robot} here."
    else:
        no_limits = "Dotted: commands. The joints have no limits."
    if not names:
        yield Chart("Joint angles", "deg", caption=absent)
        yield Chart("Torques and tensions", "N m", caption=absent)
    for title, unit, scale, effort_unit, group in groups:
        if not group:
            continue
        curves, levels = [], set()
        for colour, name in enumerate(group):
            column = names.index(name)
            curves.append(positions.curve(name, column, scale, "line", colour))
            if commands.rows:
                curves.append(commands.curve("", column, scale, "steps", colour))
            if name in kinds:
                limits = kinds[name].limits
                levels |= {scale * limit for limit in (limits.lower, limits.upper) if math.isfinite(limit)}
        caption = "Dotted: commands. Dashed: limits." if levels else no_limits
        yield Chart(title, unit, tuple(curves), tuple(sorted(levels)), caption)
        limit_lines = tuple(
            efforts.curve(name, names.index(name), 1.0, "line", colour) for colour, name in enumerate(group)
        )
        what = "Torques the servos hold" if effort_unit == "N m" else "Tensions and forces"
        yield Chart(what, effort_unit, limit_lines)


def _revolute(kinds: Mapping[str, object], name: str) -> bool:
    return getattr(kinds.get(name), "kind", "revolute") == "revolute"


def _place(message: Any) -> Sequence[float]:
    at = message.pose.position
    return at.x, at.y, at.z


def _effector_charts(bag: Bag) -> Iterator[Chart]:
    poses, goals = (_series(bag, f"effector_{name}", _place) for name in ("pose", "goal"))
    absent, no_goal = missing(bag, "effector_pose"), missing(bag, "effector_goal")
    curves = [poses.curve(axis, k, MM, "line", k) for k, axis in enumerate("xyz")] if poses.rows else []
    if goals.rows and curves:
        curves += [goals.curve("", k, MM, "steps", k) for k in range(3)]
    yield Chart(
        "Effector", "mm", tuple(curves), caption=absent or no_goal or "Dotted: goal of inverse control."
    )
    if not (poses.rows and goals.rows):
        yield Chart("Distance to the goal", "mm", caption=missing(bag, "effector_pose", "effector_goal"))
        return
    times = np.array(poses.times)
    newest = np.searchsorted(np.array(goals.times), times, side="right") - 1
    is_received = newest >= 0
    distance = np.linalg.norm(np.array(poses.rows) - np.array(goals.rows)[newest.clip(0)], axis=1)
    yield Chart("Distance to the goal", "mm", (Curve("", times[is_received], MM * distance[is_received]),))


def _from_diagnostics(
    bag: Bag, title: str, unit: str, component: str, *keys: str, levels: tuple[float, ...] = ()
) -> Chart:
    """Return a chart of values in /diagnostics whose keys end so, of the component whose name ends so."""
    points: dict[str, _Series] = {}
    for stamp, message in bag.messages("/diagnostics"):
        for status in message.status:
            if not status.name.endswith(component):
                continue
            for key, value in diagnostic_row(status).items():
                if isinstance(value, float) and key.endswith(keys):
                    series = points.setdefault(key, _Series())
                    series.times.append(1e-9 * (stamp - bag.begin_ns))
                    series.rows.append((value,))
    if not points:
        absent = f"Not in this recording: reports of {component.strip('/')} in /diagnostics."
        return Chart(title, unit, caption=absent)
    names = {key: key.removesuffix("_ms").replace("_", " ") for key in points}  # the axis has the unit
    if len(points) == 1:
        names = dict.fromkeys(points, "")  # the title names it
    curves = [each.curve(names[key], 0, 1.0, "line", k) for k, (key, each) in enumerate(points.items())]
    return Chart(title, unit, tuple(curves), levels)


def _stress(bag: Bag) -> Chart:
    def largest(message: Any) -> Sequence[float]:
        return (float(np.frombuffer(message.data, dtype="<f4").reshape(-1, 4)[:, 3].max(initial=0.0)),)

    series = _series(bag, "mesh/points", largest)
    curves = (series.curve("", 0, 1e-3),) if series.rows else ()
    return Chart("Largest von Mises stress", "kPa", curves, caption=missing(bag, "mesh/points"))


def draw(chart: Chart, duration_s: float) -> str:
    """Return a chart, of one curve or more, as an SVG document with a time axis of 0..`duration_s` in [s]."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_INCHES)
    axes = figure.add_axes(FRAME)
    for curve in chart.curves:
        times, values = decimate_curve(curve)
        axes.plot(
            times, values, label=curve.name or None, color=f"C{curve.colour % 10}", **STYLES[curve.style]
        )
    for level in chart.levels:
        axes.axhline(level, color="0.5", linewidth=0.8, linestyle="--")
    axes.set(xlabel="s", ylabel=chart.unit, xlim=(0.0, max(duration_s, 1e-3)))
    axes.ticklabel_format(useOffset=False)
    axes.grid(color="0.9")
    if any(curve.name for curve in chart.curves):
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")
    return figure_data(figure, "svg", metadata={"Date": None}).decode()


def decimate_curve(curve: Curve) -> tuple[Any, Any]:
    """Return times and values of a curve with at most MOST_POINTS.

    A longer curve has the lowest and the highest value of each interval.
    """
    count = len(curve.times)
    if count <= MOST_POINTS:
        return curve.times, curve.values
    edges = np.linspace(0, count, MOST_POINTS // 2 + 1).astype(int)
    indices = []
    for begin, end in pairwise(edges):
        stretch = np.nan_to_num(curve.values[begin:end])
        indices += sorted({begin + int(stretch.argmin()), begin + int(stretch.argmax())})
    return curve.times[indices], curve.values[indices]
