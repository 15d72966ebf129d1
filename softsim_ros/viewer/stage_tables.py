"""Where the time of a step goes, as HTML: statistics of the last second, the tree of one step."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from softsim_core.dynamics.stages import stage_tree
from softsim_ros.viewer.readings import box

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
"""Columns of the statistics: value of the topic `stage_statistics`, its title, and digits that find room."""


def stage_table(stages: Mapping[str, Stage]) -> str:
    """Statistics of each stage over a second: calls, times of a call and of all in [ms], percent."""
    if not stages:
        return box("no statistics yet; is the simulator running?")
    rows = [
        (
            _indented(name, int(values.get("level", "0"))),
            *(_rounded(values.get(column, ""), digits) for column, (_, digits) in STATISTICS.items()),
        )
        for name, values in stages.items()
    ]
    titles = ("stage", *(title for title, _ in STATISTICS.values()))
    return _table("<b>the last second</b>, in ms", titles, rows)


def step_table(step: int, time_s: float, times_ms: Mapping[str, float]) -> str:
    """The tree of one step: time of each stage, its own time without its parts, and both as percent."""
    tree = stage_tree(times_ms)
    whole = sum(share.total for share in tree if share.level == 0)
    percent = 100.0 / (whole or 1.0)
    rows = [
        (
            _indented(share.name, share.level),
            f"{percent * share.total:.1f}",
            f"{percent * share.own:.1f}",
            f"{share.total:.3f}",
            f"{share.own:.3f}",
        )
        for share in tree
    ]
    title = f"<b>step {step}</b>, t = {time_s:.3f} s: {whole:.3f} ms"
    return _table(title, ("stage", "total %", "self %", "time ms", "self ms"), rows)


def _indented(name: str, level: int) -> str:
    return "\u00a0" * 2 * level + name  # spaces that do not collapse


def _rounded(number: str, digits: int) -> str:
    return f"{float(number):.{digits}f}" if number else ""


def _table(title: str, titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose first column is words, the others numbers."""
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
