"""The web page of `softsim validate --out`: one file that loads nothing, with the errors in space to turn."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.errors import DataError
from softsim_core.file_writing import write_file
from softsim_core.identification.description import DataSetDescription
from softsim_core.identification.measures import Measures, measures
from softsim_core.identification.report import worst
from softsim_core.identification.validation import SessionResult, summary
from softsim_ros.cli.measurements.validate_script import SCRIPT, STYLE

MOST_POINTS = 4000
"""Errors of a session that are drawn; of more, evenly some."""

MOST_WORST = 8
BINS = 30

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>{title}</title>
<style>{style}</style>
<h1>{title}</h1>
{body}
<script id="data" type="application/json">{data}</script>
<script>{script}</script>
</html>
"""


def write(
    file: Path, description: DataSetDescription, model: str | None, results: Sequence[SessionResult]
) -> None:
    """Write the page.

    Raises:
        DataError: the file cannot be written.
    """
    try:
        write_file(file, page(description, model, results))
    except OSError as error:
        raise DataError(file, "", f"cannot be written ({error.strerror})") from error


def page(description: DataSetDescription, model: str | None, results: Sequence[SessionResult]) -> str:
    """The page's text."""
    asked = [each for each in results if each.alignment is not None]
    told = [("measured by", description.source), ("licence", description.licence)]
    lines = "".join(f"<p><b>{name}</b> {escape(text)}</p>" for name, text in told if text)
    parts = [f"<p>{escape(description.about)}</p>", lines, _table(results, asked)]
    if asked:
        parts.append(_VIEW)
    data = json.dumps({"sessions": [_points(each) for each in asked]}, allow_nan=False)
    title = f"{description.name}: model {model}" if model else f"{description.name}: other models"
    return PAGE.format(
        title=escape(title),
        style=STYLE,
        body="\n".join(parts),
        data=data.replace("<", "\\u003c"),
        script=SCRIPT,
    )


_VIEW = """
<nav id="sessions"></nav>
<p id="note"></p>
<div class="row">
  <figure><canvas id="field" width="760" height="480"></canvas>
    <figcaption>Where it was measured, coloured by the error; lines are the errors,
      <input id="length" type="range" min="0" max="20" value="5"> <span id="times"></span> as long.
      Drag to turn, wheel to come nearer.</figcaption></figure>
  <div>
    <h2>Errors</h2><svg id="histogram" viewBox="0 0 420 150"></svg>
    <h2>Worst</h2><table id="worst"></table>
    <pre id="chosen">Click a line or a point.</pre>
  </div>
</div>
<div class="row"><div><h2>By region</h2><table id="regions"></table></div>
<div><h2>Alignment</h2><table id="alignment"></table></div></div>
"""


def _table(results: Sequence[SessionResult], asked: Sequence[SessionResult]) -> str:
    head = ("session", "errors", "raw mean", "mean", "rms", "p95", "max", "")
    rows = []
    for each in results:
        name, judged = each.session.name, each.judged
        if each.alignment is not None:
            verdict = "; ".join(each.beyond)
            rows.append(_row(name, each.of(judged), each.of(judged, raw=True), verdict))
        for other, errors in each.others.items():
            counted = each.session.judged
            found = measures(errors.aligned[counted]), measures(errors.raw[counted])
            rows.append(_row(f"{name}, {other} *", *found, ""))
    if len(asked) > 1:
        raw = measures(np.concatenate([each.raw[each.judged].reshape(-1, 3) for each in asked]))
        rows.append(_row("all", summary(asked), raw, ""))
    cells = "".join(f"<th>{name}" for name in head)
    told = "Errors in mm, model minus measurement, aligned as described; raw: with nothing fitted."
    stars = " * another model, with a rigid frame of its own." if any(each.others for each in results) else ""
    return f"<table class=numbers><tr>{cells}{''.join(rows)}</table><p>{told}{stars}</p>"


def _row(name: str, aligned: Measures, raw: Measures, verdict: str) -> str:
    values = (raw.mean, aligned.mean, aligned.rms, aligned.p95, aligned.max)
    cells = "".join(f"<td>{1e3 * value:.2f}" for value in values)
    said = f"<td class=beyond>{escape(verdict)}" if verdict else "<td>"
    return f"<tr><td>{escape(name)}<td>{aligned.count}{cells}{said}"


def _points(result: SessionResult) -> dict[str, Any]:
    """What the page draws of a session, in mm."""
    session = result.session
    assert result.alignment is not None
    rows, sensors = np.nonzero(np.repeat(result.judged[:, None], result.aligned.shape[1], axis=1))
    errors = 1e3 * result.aligned[rows, sensors]
    lengths = np.linalg.norm(errors, axis=1)
    names = session.description.sensor_names
    ends = [(session.table.lines[k], names[s]) for k, s in zip(rows.tolist(), sensors.tolist(), strict=True)]
    index = {(int(k), int(s)): n for n, (k, s) in enumerate(zip(rows, sensors, strict=True))}
    drawn = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MOST_POINTS)).astype(int)).tolist()
    top = [index[k, s] for k, s, _ in worst(result, MOST_WORST)]
    shown = sorted({*drawn, *top})
    at = {n: place for place, n in enumerate(shown)}
    counts, edges = np.histogram(lengths, bins=BINS)
    return {
        "name": session.name,
        "note": " ".join([session.description.note, *result.warnings]),
        "places": (1e3 * result.positions[rows, sensors] - errors)[shown].round(4).tolist(),
        "errors": errors[shown].round(4).tolist(),
        "labels": [f"line {line}, {sensor}" for line, sensor in (ends[n] for n in shown)],
        "commands": [_commands(result, int(rows[n])) for n in shown],
        "worst": [at[n] for n in top],
        "counts": counts.tolist(),
        "edges": edges.round(5).tolist(),
        "regions": [
            [name, f"{1e3 * low:.1f} to {1e3 * high:.1f}", found.count, round(1e3 * found.mean, 3)]
            for name, (low, high, found) in result.regions.items()
            if found.count
        ],
        "alignment": _alignment(result),
    }


def _commands(result: SessionResult, row: int) -> str:
    session = result.session
    told = [] if session.times is None else [f"t = {session.times[row]:.3f} s"]
    if (columns := session.description.commands) is not None:
        told += [f"{name} = {session.table.columns[name][row]}" for name in columns.columns]
    return ", ".join(told)


def _alignment(result: SessionResult) -> list[list[str]]:
    alignment, described = result.alignment, result.session.description
    assert alignment is not None

    def three(values: Any, factor: float = 1e3) -> str:
        return ", ".join(f"{factor * value:.2f}" for value in np.asarray(values).tolist())

    rows = []
    if described.alignment.frame:
        turns = "; ".join(three(row, 1.0) for row in alignment.rotation)
        rows += [["rotation of the data's frame", turns], ["its shift in mm", three(alignment.shift)]]
    if described.alignment.point:
        for name, point, spread in zip(
            described.sensor_names, alignment.points, alignment.point_errors, strict=True
        ):
            rows.append([f"point of {name} in mm", f"{three(point)} (standard errors {three(spread)})"])
    if described.time is not None:
        rows.append(["delay in ms", f"{1e3 * alignment.delay:.1f}"])
    return rows or [["nothing is fitted", ""]]
