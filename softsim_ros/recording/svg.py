"""Charts as SVG, drawn without a screen."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from softsim_ros import figure_data
from softsim_ros.recording.curves import Chart, Curve

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


def draw(chart: Chart, duration_s: float) -> str:
    """Return the chart as an SVG document.

    Args:
        chart: Chart with at least one curve.
        duration_s: End of the time axis in [s], the same for all charts of a report.
    """
    figure = Figure(figsize=SIZE_INCHES)
    FigureCanvasSVG(figure)
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
