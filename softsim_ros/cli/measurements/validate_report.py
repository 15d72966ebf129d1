"""The report of `softsim validate`: a table of errors, and a self-contained web page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from softsim_core.lab.identification import (
    DataSetDescription,
    Measures,
    SessionResult,
    measures,
    summary,
    worst,
)
from softsim_core.physics.mechanics import rotation_log
from softsim_ros import render_page
from softsim_ros.cli import table_lines

HEAD = ("session", "errors", "raw mean", "mean", "rms", "p95", "max")
SHOWN_WORST = 3


def report_lines(
    description: DataSetDescription, model: str | None, results: Sequence[SessionResult]
) -> list[str]:
    """Return the report as lines of text."""
    lines = [f"{description.name}: {description.about}" if description.about else description.name]
    if model is not None:
        lines.append(f"model: {model}; errors in mm, model minus measurement, aligned as described")
    lines += ["", *_text_table(results)]
    for each in results:
        lines += ["", f"{each.session.name}: {each.session.description.note}".rstrip(": "), *_details(each)]
    if missing := [n for n in description.session_names if n not in {r.session.name for r in results}]:
        lines += ["", f"not compared: {', '.join(missing)}"]
    return lines


def _errors(results: Sequence[SessionResult]) -> list[tuple[str, ...]]:
    """Return the rows of the table: a session, its errors in mm, and which limits they exceed."""
    rows: list[tuple[str, ...]] = []
    for each in results:
        name, evaluated = each.session.name, each.evaluated
        if each.alignment is not None:
            found = each.of(evaluated), each.of(evaluated, raw=True)
            rows.append((name, *_cells(*found), "; ".join(each.beyond)))
        for other, errors in each.others.items():
            counted = each.session.evaluated
            found = measures(errors.aligned[counted]), measures(errors.raw[counted])
            rows.append((f"{name}, {other} *", *_cells(*found), ""))
    asked = [each for each in results if each.alignment is not None]
    if len(asked) > 1:
        raw = measures(np.concatenate([each.raw[each.evaluated].reshape(-1, 3) for each in asked]))
        rows.append(("all", *_cells(summary(asked), raw), ""))
    return rows


def _text_table(results: Sequence[SessionResult]) -> list[str]:
    rows = [HEAD, *(row[:-1] for row in _errors(results))]
    lines = table_lines(rows, ">")
    if any(each.others for each in results):
        lines.append("* another model; a rigid frame is fitted, no sensor point: the data have no tilt of it")
    return lines


def _cells(aligned: Measures, raw: Measures) -> tuple[str, ...]:
    values = (raw.mean, aligned.mean, aligned.rms, aligned.p95, aligned.max)
    return (str(aligned.count), *(f"{1e3 * value:.2f}" for value in values))


def _details(result: SessionResult) -> list[str]:
    rows = list(_detail_rows(result))
    width = max(len(name) for name, _ in rows)
    return [f"  {name:<{width}}  {value}" for name, value in rows]


def _detail_rows(result: SessionResult) -> Iterator[tuple[str, str]]:
    session, description = result.session, result.session.description
    left_out = len(session.used) - int(session.used.sum())
    yield "rows", f"{len(session.used)}, of which {left_out} left out"
    if result.alignment is None:
        return
    held_out = session.used & ~session.training
    if held_out.any():
        fit, tested = result.of(session.fitting), result.of(held_out)
        text = f"{fit.count} errors, mean {_mm(fit.mean)}; held out {tested.count}, {_mm(tested.mean)}"
        yield "training", text
    yield from _alignment(result)
    if len(description.sensors) > 1:
        for s, name in enumerate(description.sensor_names):
            found = measures(result.aligned[result.evaluated, s])
            yield f"sensor {name}", f"mean {_mm(found.mean)}, rms {_mm(found.rms)}, max {_mm(found.max)}"
    for name, (measured, of_model) in result.rest_values().items():
        yield f"at rest {name}", f"model minus measured ({_three(1e3 * (of_model - measured))}) mm"
    for name, rings in result.ringings().items():
        yield (
            f"rings {name}",
            ", ".join(
                f"{words} {ring.frequency:.2f} Hz and damping ratio {ring.damping:.3f}"
                for words, ring in zip(("measured", "model"), rings, strict=True)
            ),
        )
    if session.times is None:
        for region, (begin, end, found) in result.regions.items():
            yield region, f"{1e3 * begin:.1f} to {1e3 * end:.1f} mm: mean {_mm(found.mean)} of {found.count}"
        for row, s, error in worst(result, SHOWN_WORST):
            where = f"line {session.table.lines[row]}, {description.sensor_names[s]}"
            yield "worst", f"{where}: {_mm(float(np.linalg.norm(error)))}, ({_three(1e3 * error)}) mm"
    for warning in result.warnings:
        yield "note", warning


def _alignment(result: SessionResult) -> Iterator[tuple[str, str]]:
    """Yield what was fitted: the frame of the data, the points of the sensors, the delay."""
    alignment, description = result.alignment, result.session.description
    assert alignment is not None
    if description.fitted_numbers:
        rows = f"{description.fitted_numbers} numbers to {alignment.rows} training rows"
        yield "fitted", rows if alignment.rows else "nothing; the alignment was given"
    if description.alignment.frame:
        turn = np.degrees(rotation_log(alignment.rotation))
        yield "frame", f"turned by ({_three(turn)}) deg, shifted by ({_three(1e3 * alignment.shift)}) mm"
    if description.alignment.point:
        points = zip(description.sensor_names, alignment.points, alignment.point_errors, strict=True)
        for name, point, spread in points:
            yield f"point {name}", f"({_three(1e3 * point)}) mm, standard error ({_three(1e3 * spread)}) mm"
    if description.time is not None and description.time.most_delay:
        yield "delay", f"{1e3 * alignment.delay:.1f} ms"


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.2f} mm"


def _three(values: object) -> str:
    return ", ".join(f"{value:.2f}" for value in np.asarray(values, dtype=float).tolist())


MOST_POINTS = 4000
"""Largest number of drawn errors of a session; of more, an evenly spaced selection is drawn."""

MOST_WORST = 8
BINS = 30


def validation_page(
    description: DataSetDescription, model: str | None, results: Sequence[SessionResult]
) -> str:
    """Return the report as a page of HTML."""
    asked = [each for each in results if each.alignment is not None]
    return render_page(
        "validation.html",
        title=f"{description.name}: model {model}" if model else f"{description.name}: other models",
        about=description,
        head=(*HEAD, ""),
        errors=_errors(results),
        others=any(each.others for each in results),
        data={"sessions": [_points(each) for each in asked]},
    )


def _points(result: SessionResult) -> dict[str, Any]:
    """Return the data that the page draws of a session, in mm."""
    session = result.session
    assert result.alignment is not None
    rows, sensors = np.nonzero(np.repeat(result.evaluated[:, None], result.aligned.shape[1], axis=1))
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
            (name, f"{1e3 * low:.1f} to {1e3 * high:.1f} mm", f"{found.count} errors, mean {_mm(found.mean)}")
            for name, (low, high, found) in result.regions.items()
            if found.count
        ],
        "alignment": list(_alignment(result)) or [("nothing is fitted", "")],
    }


def _commands(result: SessionResult, row: int) -> str:
    session = result.session
    texts = [] if session.times is None else [f"t = {session.times[row]:.3f} s"]
    if (columns := session.description.commands) is not None:
        texts += [f"{name} = {session.table.columns[name][row]}" for name in columns.columns]
    return ", ".join(texts)
