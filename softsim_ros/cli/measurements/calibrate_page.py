"""The web page of `softsim calibrate --report`: the parameters found, and their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softsim_core.base import DataError, write_file
from softsim_ros.cli.measurements.calibrate_report import RequestedResults, interval, report_lines, verdict
from softsim_ros.cli.measurements.validate_report import PAGE, STYLE

if TYPE_CHECKING:
    from softsim_core.lab.identification import Calibration

WIDE, HIGH = 240, 18
"""Size of a parameter's bar in pixels."""

_OWN_STYLE = """
table.matrix td, table.matrix th { padding: .25rem .5rem; text-align: center; border: 1px solid #fff }
table.matrix th:first-child { text-align: right } svg.bar { width: 240px; height: 18px }
td, th { white-space: nowrap } pre { max-width: none }
"""


def write(file: Path, robot: str, result: Calibration, further: RequestedResults) -> None:
    """Write the page.

    Raises:
        DataError: the file cannot be written.
    """
    try:
        write_file(file, page(robot, result, further))
    except OSError as error:
        raise DataError(file, "", f"cannot be written ({error.strerror})") from error


def page(robot: str, result: Calibration, further: RequestedResults) -> str:
    """Return the page as HTML; `robot` is the model that was fitted."""
    text = "\n".join([*report_lines(result), *further.report_lines(result)])
    stopped = "<p class=beyond>Interrupted: the best that was tried.</p>" if result.stopped else ""
    body = [
        f"<p>{result.evaluations} replays of {sum(result.rows.values())} rows.</p>{stopped}",
        f"<h2>Parameters</h2>{_parameters(result, further)}",
        "<p>Line: what was allowed; dark part: 95 % interval, wider where neighbouring rows err alike; "
        "ring: where the search began.</p>",
        f"<h2>Correlations</h2>{_correlations(result)}",
        "<p>Near 1 or -1 only their combination is determined: one compensates the other.</p>",
        f"<h2>Sessions</h2>{_sessions(result, further)}",
        f"<details open><summary>In words</summary><pre>{escape(text)}</pre></details>",
    ]
    return PAGE.format(
        title=escape(f"{result.description.name}: what was found of {robot}"),
        style=STYLE + _OWN_STYLE,
        body="\n".join(body),
        data="{}",
        script="",
    )


def _parameters(result: Calibration, further: RequestedResults) -> str:
    start = result.problem.values(result.problem.start)
    half = result.half_widths
    rows = []
    for k, name in enumerate(result.names):
        by_profile = "" if further.intervals is None else interval(*further.intervals[k])
        rows.append(
            [
                name,
                f"{result.values[k]:.4g}",
                f"{half[k]:.3g}" if np.isfinite(half[k]) else "?",
                result.units[k],
                by_profile,
                f"{start[k]:g}",
                verdict(result, k).partition(":")[0],
            ]
        )
    head = ["", "found", "+- 95 %", "unit", "by profile" if further.intervals else "", "began at", "", ""]
    bars = [_bar(result, k, float(half[k])) for k in range(len(result.names))]
    return _table(head, rows, bars)


def _bar(result: Calibration, k: int, half: float) -> str:
    """Return a bar with bounds, interval, value and start of a parameter."""
    problem = result.problem

    def at(value: float) -> float:
        part = (value - problem.low[k]) / problem.span[k]
        return 6.0 + (WIDE - 12.0) * float(np.clip(part, 0.0, 1.0))

    value, middle = float(result.values[k]), HIGH / 2
    reach = half if np.isfinite(half) else float(problem.span[k])
    start = at(float(problem.values(problem.start)[k]))
    colour = "#345" if result.found[k] else "#b00020"
    return (
        f'<svg class="bar" viewBox="0 0 {WIDE} {HIGH}">'
        f'<line x1="6" x2="{WIDE - 6}" y1="{middle}" y2="{middle}" stroke="#bbb" stroke-width="2"/>'
        f'<line x1="{at(value - reach):.1f}" x2="{at(value + reach):.1f}" y1="{middle}" y2="{middle}" '
        f'stroke="{colour}" stroke-width="6" opacity=".55"/>'
        f'<circle cx="{start:.1f}" cy="{middle}" r="4" fill="none" stroke="#888"/>'
        f'<circle cx="{at(value):.1f}" cy="{middle}" r="4" fill="{colour}"/></svg>'
    )


def _correlations(result: Calibration) -> str:
    """Return a table of correlations with coloured cells: blue below 0, red above."""
    head = "".join(f"<th>{escape(name)}" for name in result.names)
    rows = []
    for k, name in enumerate(result.names):
        cells = "".join(_cell(float(value)) for value in result.correlation[k])
        rows.append(f"<tr><th>{escape(name)}{cells}")
    return f'<table class="matrix"><tr><th>{head}{"".join(rows)}</table>'


def _cell(value: float) -> str:
    if not np.isfinite(value):
        return "<td>?"
    hue, ink = (0 if value > 0.0 else 220), ("#fff" if abs(value) > 0.7 else "#222")
    return (
        f'<td style="color: {ink}; background: hsl({hue} 80% {97.0 - 42.0 * abs(value):.0f}%)">{value:+.2f}'
    )


def _sessions(result: Calibration, further: RequestedResults) -> str:
    folds = further.folds
    rows = [
        [
            name,
            str(count),
            f"{1e3 * result.before[name]:.3f}",
            f"{1e3 * result.after[name]:.3f}",
            "" if folds is None else f"{1e3 * folds.left_out[name]:.3f}",
        ]
        for name, count in result.rows.items()
    ]
    left_out = "" if folds is None else f"rows left out, {folds.count} folds"
    return _table(["mean error in mm", "rows", "before", "after", left_out], rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], further: Sequence[str] = ()) -> str:
    """Return a table of text rows; `further` is drawn after each row."""
    lines = ["".join(f"<th>{escape(each)}" for each in head)]
    drawn = [f"<td>{each}" for each in further] or [""] * len(rows)
    for row, behind in zip(rows, drawn, strict=True):
        lines.append("".join(f"<td>{escape(each)}" for each in row) + behind)
    return f"<table class=numbers><tr>{'<tr>'.join(lines)}</table>"
