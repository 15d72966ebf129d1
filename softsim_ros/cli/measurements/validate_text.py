"""What `softsim validate` prints: a table of errors, and what stands behind it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.identification.description import DataSetDescription
from softsim_core.identification.measures import Measures, measures
from softsim_core.identification.report import worst
from softsim_core.identification.validation import SessionResult, summary
from softsim_core.mechanics.pose import rotation_log

HEAD = ("session", "errors", "raw mean", "mean", "rms", "p95", "max")
SHOWN_WORST = 3


def sentences(
    description: DataSetDescription, model: str | None, results: Sequence[SessionResult]
) -> list[str]:
    """The report in lines."""
    asked = [each for each in results if each.alignment is not None]
    told = [f"{description.name}: {description.about}" if description.about else description.name]
    if model is not None:
        told.append(f"model: {model}; errors in mm, model minus measurement, aligned as described")
    told += ["", *_table(results, asked)]
    for each in results:
        told += ["", f"{each.session.name}: {each.session.description.note}".rstrip(": "), *_details(each)]
    if missing := [n for n in description.session_names if n not in {r.session.name for r in results}]:
        told += ["", f"not compared: {', '.join(missing)}"]
    return told


def _table(results: Sequence[SessionResult], asked: Sequence[SessionResult]) -> list[str]:
    rows: list[tuple[str, ...]] = [HEAD]
    for each in results:
        name, judged = each.session.name, each.judged
        if each.alignment is not None:
            rows.append((name, *_cells(each.of(judged), each.of(judged, raw=True))))
        for other, errors in each.others.items():
            rows_judged = each.session.judged
            found = measures(errors.aligned[rows_judged]), measures(errors.raw[rows_judged])
            rows.append((f"{name}, {other} *", *_cells(*found)))
    if len(asked) > 1:
        raw = measures(np.concatenate([each.raw[each.judged].reshape(-1, 3) for each in asked]))
        rows.append(("all", *_cells(summary(asked), raw)))
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEAD))]
    lines = [
        "  ".join(
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    if any(each.others for each in results):
        lines.append("* another model; a rigid frame is fitted, no sensor point: the data have no tilt of it")
    return lines


def _cells(aligned: Measures, raw: Measures) -> tuple[str, ...]:
    values = (raw.mean, aligned.mean, aligned.rms, aligned.p95, aligned.max)
    return (str(aligned.count), *(f"{1e3 * value:.2f}" for value in values))


def _details(result: SessionResult) -> list[str]:
    session = result.session
    left_out = len(session.used) - int(session.used.sum())
    rows = [("rows", f"{len(session.used)}, of which {left_out} left out")]
    held_out = session.used & ~session.training
    if held_out.any() and result.alignment is not None:
        fit, judged = result.of(session.fitting), result.of(held_out)
        rows.append(
            (
                "training",
                f"{fit.count} errors, mean {_mm(fit.mean)}; held out {judged.count}, {_mm(judged.mean)}",
            )
        )
    if result.alignment is None:
        return _lines(rows)
    description, alignment = session.description, result.alignment
    turn = np.degrees(rotation_log(alignment.rotation))
    if description.alignment.frame:
        rows.append(
            ("frame", f"turned by ({_three(turn)}) deg, shifted by ({_three(1e3 * alignment.shift)}) mm")
        )
    if description.alignment.point:
        for name, point, spread in zip(
            description.sensor_names, alignment.points, alignment.point_errors, strict=True
        ):
            rows.append(
                (f"point {name}", f"({_three(1e3 * point)}) mm, standard error ({_three(1e3 * spread)}) mm")
            )
    if description.time is not None and description.time.most_delay:
        rows.append(("delay", f"{1e3 * alignment.delay:.1f} ms"))
    if len(description.sensors) > 1:
        for s, name in enumerate(description.sensor_names):
            found = measures(result.aligned[result.judged, s])
            rows.append(
                (f"sensor {name}", f"mean {_mm(found.mean)}, rms {_mm(found.rms)}, max {_mm(found.max)}")
            )
    for name, (measured, of_model) in result.rest_values().items():
        away = 1e3 * (of_model - measured)
        rows.append((f"at rest {name}", f"model minus measured ({_three(away)}) mm"))
    for name, (measured_ring, model_ring) in result.ringings().items():
        told = ", ".join(
            f"{words} {ring.frequency:.2f} Hz and damping ratio {ring.damping:.3f}"
            for words, ring in (("measured", measured_ring), ("model", model_ring))
        )
        rows.append((f"rings {name}", told))
    if session.times is None:
        for region, (begin, end, found) in result.regions.items():
            told = f"{1e3 * begin:.1f} to {1e3 * end:.1f} mm: mean {_mm(found.mean)} of {found.count}"
            rows.append((region, told))
        for row, s, error in worst(result, SHOWN_WORST):
            where = f"line {session.table.lines[row]}, {description.sensor_names[s]}"
            rows.append(
                ("worst", f"{where}: {_mm(float(np.linalg.norm(error)))}, ({_three(1e3 * error)}) mm")
            )
    rows += [("note", warning) for warning in result.warnings]
    return _lines(rows)


def _lines(rows: Sequence[tuple[str, str]]) -> list[str]:
    width = max(len(name) for name, _ in rows)
    return [f"  {name:<{width}}  {value}" for name, value in rows]


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.2f} mm"


def _three(values: object) -> str:
    return ", ".join(f"{value:.2f}" for value in np.asarray(values, dtype=float).tolist())
