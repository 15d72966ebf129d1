"""Results of validation as plain data for JSON, and alignments back from it."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import DataError, listing
from softsim_core.identification.alignment import Alignment
from softsim_core.identification.measures import measures
from softsim_core.identification.session import Session
from softsim_core.identification.validation import SessionResult, summary


def plain(name: str, model: str | None, results: Sequence[SessionResult]) -> dict[str, Any]:
    """Everything that is told of a data set beside a model.

    Args:
        name: Of the data set.
        model: Of the robot; None: only other models were compared.
        results: Of the sessions.
    """
    asked = [each for each in results if each.alignment is not None]
    return {
        "data_set": name,
        "robot": model,
        "all": summary(asked).plain() if asked else None,
        "passed": all(not each.beyond for each in asked),
        "stopped": any(each.stopped for each in results),
        "sessions": {each.session.name: _session(each) for each in results},
    }


def _session(result: SessionResult) -> dict[str, Any]:
    session, told = result.session, {}
    if result.alignment is not None:
        held_out = session.used & ~session.training
        told = {
            "raw": result.of(result.judged, raw=True).plain(),
            "aligned": result.of(result.judged).plain(),
            "training": result.of(session.fitting).plain(),
            "held_out": result.of(held_out).plain() if held_out.any() else None,
            "suspect": result.of(~session.used).plain() if session.times is None else None,
            "sensors": {
                sensor: measures(result.aligned[result.judged, s]).plain()
                for s, sensor in enumerate(session.description.sensor_names)
            },
            "regions": {
                region: {"from_mm": 1e3 * begin, "to_mm": 1e3 * end, **found.plain()}
                for region, (begin, end, found) in result.regions.items()
            },
            "rest_values": {
                sensor: {"measured_m": measured.tolist(), "model_m": model.tolist()}
                for sensor, (measured, model) in result.rest_values().items()
            },
            "ringing": {
                sensor: {"measured": measured._asdict(), "model": model._asdict()}
                for sensor, (measured, model) in result.ringings().items()
            },
            "alignment": _alignment(result.alignment),
            "beyond_limits": result.beyond,
            "warnings": list(result.warnings),
            "each_row": _each_row(result),
        }
    return {
        "rows": len(session.table),
        "used": int(session.used.sum()),
        "judged": "held out" if (session.used & ~session.training).any() else "training",
        **told,
        "others": {
            other: {
                "raw": measures(errors.raw[session.judged]).plain(),
                "framed": measures(errors.aligned[session.judged]).plain(),
            }
            for other, errors in result.others.items()
        },
    }


def _each_row(result: SessionResult) -> list[dict[str, Any]]:
    """Rows: line in the table, commands as it has them, errors; null where the model has none."""
    session, names = result.session, result.session.description.sensor_names
    columns = session.description.commands
    commands = {name: session.table.numbers(name).tolist() for name in (columns.columns if columns else ())}
    rows = []
    for k, line in enumerate(session.table.lines):
        known = bool(result.known[k])
        rows.append(
            {
                "line": int(line),
                "time_s": None if session.times is None else float(session.times[k]),
                "used_for": "training" if session.fitting[k] else "held out" if session.used[k] else None,
                "commands": {name: values[k] for name, values in commands.items()},
                "model_m": dict(zip(names, result.positions[k].tolist(), strict=True)) if known else None,
                "error_m": dict(zip(names, result.aligned[k].tolist(), strict=True)) if known else None,
                "raw_error_m": dict(zip(names, result.raw[k].tolist(), strict=True)) if known else None,
            }
        )
    return rows


def _alignment(alignment: Alignment) -> dict[str, Any]:
    return {
        "rotation": alignment.rotation.tolist(),
        "shift_m": alignment.shift.tolist(),
        "points_m": alignment.points.tolist(),
        "point_errors_m": alignment.point_errors.tolist(),
        "delay_s": alignment.delay,
    }


def read_alignments(file: Path) -> dict[str, Alignment]:
    """The alignments in a report that was written as JSON, by session.

    Raises:
        DataError: the file is no such report.
    """
    try:
        sessions = json.loads(file.read_text(encoding="utf-8"))["sessions"]
        told = {name: each["alignment"] for name, each in sessions.items() if "alignment" in each}
        return {name: _read(each) for name, each in told.items()}
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(file, "", f"cannot be read ({error})") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        problem = "is no report of `softsim validate --json` with alignments"
        raise DataError(file, "", f"{problem} ({type(error).__name__})") from error


def _read(told: dict[str, Any]) -> Alignment:
    rotation, points = np.array(told["rotation"], float), np.array(told["points_m"], float)
    shift, delay = np.array(told["shift_m"], float), float(told["delay_s"])
    if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
        raise ValueError("no rotation")
    if shift.shape != (3,) or points.ndim != 2 or points.shape[1] != 3:
        raise ValueError("no shift or points")
    if not all(np.isfinite(each).all() for each in (shift, points)) or not math.isfinite(delay):
        raise ValueError("not finite")
    return Alignment(rotation, shift, points, np.zeros_like(points), delay)


def given_alignment(alignments: dict[str, Alignment], session: Session) -> Alignment:
    """That of a session.

    Raises:
        DataError: there is none, or for other sensors.
    """
    name, sensors = session.name, len(session.description.sensors)
    if name not in alignments:
        raise DataError(f"session {name}", "", f"no alignment was given; there are {listing(alignments)}")
    if len(alignments[name].points) != sensors:
        raise DataError(f"session {name}", "", f"the alignment given is not one of {sensors} sensors")
    return alignments[name]


def worst(result: SessionResult, count: int) -> list[tuple[int, int, Array]]:
    """The largest errors among the judged: row, sensor and error (3,) in [m], largest first."""
    lengths = np.where(result.judged[:, None], np.linalg.norm(result.aligned, axis=2), -1.0)
    order = np.argsort(lengths, axis=None)[::-1][: min(count, int(result.judged.sum()) * lengths.shape[1])]
    rows, sensors = np.unravel_index(order, lengths.shape)
    return [(int(k), int(s), result.aligned[k, s]) for k, s in zip(rows, sensors, strict=True)]
