"""Comparison of a model with measurements: replay, alignment, errors, and a report as plain data."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from softsim_core.base import Array, BoolArray, DataError, FormerAttribute, listing
from softsim_core.lab.identification.alignment import (
    Alignment,
    align,
    build_nominal_alignment,
    locate_sensors,
    rigid_frame,
)
from softsim_core.lab.identification.description import SessionDescription
from softsim_core.lab.identification.error_measures import Measures, by_region, measures
from softsim_core.lab.identification.model_replay import (
    Order,
    Prediction,
    Ringing,
    release_errors,
    replay,
    ringing,
)
from softsim_core.lab.identification.session import Session
from softsim_core.scene import RobotDescription, load_scene
from softsim_core.scene.io import mark_source, merge

SCALE_APART = 8.0
"""Ratio of measured to simulated motion, or inverse, beyond which the units are assumed to differ."""

TURNED = np.pi / 4.0
"""Rotation of a frame in [rad] beyond which a warning is given."""

SPANS = 5
"""Number of time spans; the delay of each is fitted to the rows of the others."""

AT_REST = 0.5
"""Duration in [s] at the end of a replay in time in which the motion counts as rest."""


@dataclass(frozen=True, slots=True, eq=False)
class OtherErrors:
    """Errors of another model in [m], shape (k, 3): as reported, and with a fitted frame of its own."""

    raw: Array
    aligned: Array


@dataclass(frozen=True, slots=True, eq=False)
class SessionResult:
    """Comparison of a session with a model.

    Attributes:
        session: The measurements.
        predicted: Rows with a prediction of the model, shape (k,).
        alignment: Frame and points, fitted to the training rows as described; None: there is no model.
        raw: Model minus measurement in [m] with frame and points as described, shape (k, s, 3).
        aligned: The same with the alignment; where no rows are held out, the delay of each time span is
            fitted to the other spans.
        positions: Positions of the sensors in the model in [m], shape (k, s, 3).
        others: Errors of other models by name.
        warnings: Warnings for the reader.
        stopped: Whether the replay was interrupted.
    """

    session: Session
    predicted: BoolArray
    alignment: Alignment | None
    raw: Array
    aligned: Array
    positions: Array
    others: dict[str, OtherErrors]
    warnings: tuple[str, ...]
    stopped: bool
    judged, known = FormerAttribute("evaluated"), FormerAttribute("predicted")

    @property
    def evaluated(self) -> BoolArray:
        """Evaluated rows, shape (k,)."""
        return self.session.evaluated & self.predicted

    def fitted_errors(self) -> Array:
        """Return the errors that a calibration minimises in [m], shape (k, s, 3).

        These are the errors `aligned` without the part that an unknown release explains.

        Raises:
            DataError: the release is unknown, and the model does not oscillate.
        """
        time, times = self.session.description.time, self.session.times
        if time is None or times is None or time.release == "known":
            return self.aligned
        released = release_errors(times, self.positions, self.aligned, self.session.fitting & self.predicted)
        if released is None:
            raise DataError(
                f"session {self.session.name}",
                "",
                "its release is unknown, but the model does not ring, so nothing is left to compare; narrow "
                "the bounds, or set release: known",
            )
        return self.aligned - released

    def of(self, rows: BoolArray, raw: bool = False) -> Measures:
        """Return statistics over some rows (k,) and all sensors."""
        return measures((self.raw if raw else self.aligned)[rows & self.predicted])

    @property
    def regions(self) -> dict[str, tuple[float, float, Measures]]:
        """Statistics in thirds of the workspace; see by_region."""
        rows = self.evaluated
        errors, where = self.aligned[rows], self.positions[rows] - self.aligned[rows]
        return by_region(errors.reshape(-1, 3), where.reshape(-1, 3))

    @property
    def beyond(self) -> list[str]:
        """Messages for exceeded limits of the session; none where there is no model."""
        limits = self.session.description.limits
        return [] if self.alignment is None else self.of(self.evaluated).beyond(limits)

    def rest_values(self) -> dict[str, tuple[Array, Array]]:
        """Return each sensor's final position in a replay in time, measured and of the model, (3,) in [m]."""
        times = self.session.times
        if times is None or self.alignment is None or not self.evaluated.any():
            return {}
        rows = self.evaluated & (times > times[self.evaluated].max() - AT_REST)
        model = self.positions[rows].mean(axis=0)
        measured = model - self.aligned[rows].mean(axis=0)
        names = self.session.description.sensor_names
        return {name: (measured[s], model[s]) for s, name in enumerate(names)}

    def ringings(self) -> dict[str, tuple[Ringing, Ringing]]:
        """Return the oscillation of each sensor in a replay in time, measured and of the model."""
        times = self.session.times
        if times is None or self.alignment is None:
            return {}
        rows, ringings = self.evaluated, {}
        for s, name in enumerate(self.session.description.sensor_names):
            model = self.positions[rows, s]
            measured, simulated = (
                ringing(times[rows], model - self.aligned[rows, s]),
                ringing(times[rows], model),
            )
            if measured is not None and simulated is not None:
                ringings[name] = (measured, simulated)
        return ringings


def session_robot(
    name_or_path: str, session: SessionDescription, overrides: Mapping[str, Any] | None = None
) -> RobotDescription:
    """Load the model of a session with its overrides, or with the given ones."""
    whole = merge(mark_source(session.overrides, None), mark_source(overrides or {}, None))
    return load_scene(name_or_path, whole)


def validate_session(
    session: Session,
    robot: RobotDescription | None,
    order: Order | None = None,
    progress: Callable[[int, int], None] | None = None,
    given: Alignment | None = None,
) -> SessionResult:
    """Replay a session's commands and compare the result with the measurements.

    Args:
        session: The measurements.
        robot: The model; None compares other models only.
        order: Order in which equilibria are solved; see replay.
        progress: Called with the progress.
        given: An existing alignment, such as from other rows; None: it is fitted as described.

    Raises:
        DataError: the data do not fit the robot, or do not determine the fitted quantities.
        SceneError: the scene cannot be built, or has nothing where a sensor sits.
        KeyboardInterrupt: interrupted before any row was finished; a later interrupt is reported in the
            result.
    """
    if robot is None or not session.description.replayed:
        nothing = np.full_like(session.measured, np.nan)
        solved = np.zeros(len(nothing), bool)
        others = _others(session)
        return SessionResult(session, solved, None, nothing, nothing, nothing, others, (), False)
    prediction = replay(robot, session, order, progress)
    result = compare_session(session, prediction, given)
    return result if given is not None else _by_other_rows(result, prediction)


def _by_other_rows(result: SessionResult, prediction: Prediction) -> SessionResult:
    """Return the errors of each time span with a delay that was fitted to the other spans.

    A delay that is fitted to all rows hides many errors of a model. If the delay is not fitted, or rows are
    held out, the result stays as it is.
    """
    session, time = result.session, result.session.description.time
    held_out = session.used & ~session.training
    rows = np.flatnonzero(session.fitting & result.predicted)
    if time is None or not time.most_delay or held_out.any() or result.stopped or len(rows) < 2 * SPANS:
        return result
    aligned, positions = result.aligned.copy(), result.positions.copy()
    for span in np.array_split(rows, SPANS):
        training = session.training.copy()
        training[span] = False
        others = compare_session(replace(session, training=training), prediction)
        aligned[span], positions[span] = others.aligned[span], others.positions[span]
    return replace(result, aligned=aligned, positions=positions)


def compare_session(
    session: Session, prediction: Prediction, given: Alignment | None = None
) -> SessionResult:
    """Compare a session with a model's prediction; see validate_session."""
    description = session.description
    described = build_nominal_alignment(np.array([sensor.offset for sensor in description.sensors]))
    session = _from_rest(session, prediction, described.points)
    try:
        alignment = given or _fit_alignment(session, prediction, described)
    except DataError as error:
        if prediction.stopped:  # too few rows are finished
            raise KeyboardInterrupt from error
        raise
    positions, rotations, solved = prediction.at(session, alignment.delay)
    raw_positions, raw_rotations, _ = prediction.at(session)
    raw = described.errors(raw_positions, raw_rotations, session.measured)
    return SessionResult(
        session,
        solved,
        alignment,
        raw,
        alignment.errors(positions, rotations, session.measured),
        locate_sensors(positions, rotations, alignment.points),
        _others(session),
        tuple(_warnings(session, solved, alignment, prediction.stopped)),
        prediction.stopped,
    )


def _from_rest(session: Session, prediction: Prediction, points: Array) -> Session:
    """Return the session with displacement sensors shifted to the model's initial positions."""
    moving = [k for k, sensor in enumerate(session.description.sensors) if sensor.displacement]
    if not moving:
        return session
    assert session.times is not None
    begin = locate_sensors(prediction.positions[:1], prediction.rotations[:1], points)[0]
    measured = session.measured.copy()
    for k in moving:
        measured[:, k] += begin[k] - measured[session.times <= 0.0, k].mean(axis=0)
    return replace(session, measured=measured)


def _fit_alignment(session: Session, prediction: Prediction, described: Alignment) -> Alignment:
    """Fit frame, points and delay to the training rows as described."""
    fit, what = session.description.alignment, f"session {session.name}"
    _need_same_scale(session, prediction)

    def at(delay: float) -> Alignment:
        positions, rotations, solved = prediction.at(session, delay)
        rows = session.fitting & solved
        if not rows.any():
            raise DataError(what, "", "the model reaches no row for training")
        found = align(
            positions[rows],
            rotations[rows],
            session.measured[rows],
            described.points,
            (fit.frame, fit.point),
            what,
        )
        return replace(found, delay=delay, rows=int(rows.sum()) if session.description.fitted_numbers else 0)

    def misfit(delay: float) -> float:
        positions, rotations, solved = prediction.at(session, delay)
        rows = session.fitting & solved
        return measures(at(delay).errors(positions, rotations, session.measured)[rows]).rms

    time = session.description.time
    if time is None or not time.most_delay:
        return at(0.0)
    most = time.most_delay
    delays = np.linspace(-most, most, 41)
    best = float(delays[int(np.argmin([misfit(float(delay)) for delay in delays]))])
    near = (max(-most, best - delays[1] + delays[0]), min(most, best + delays[1] - delays[0]))
    found = float(minimize_scalar(misfit, bounds=near, method="bounded", options={"xatol": 1e-5}).x)
    if abs(found) > 0.99 * most:
        raise DataError(
            what,
            f"column {time.column}",
            f"the measurement comes {1e3 * found:.0f} ms or more after the model, and {1e3 * most:g} ms are "
            "allowed; is its time shifted? set most_delay",
        )
    return at(found)


def _need_same_scale(session: Session, prediction: Prediction) -> None:
    """Reject measurements whose motion between load cases differs greatly in size from the model's."""
    positions, _, solved = prediction.at(session)
    rows = np.flatnonzero(session.fitting & solved)
    cases = session.load_cases[rows]
    if len(rows) < 3 or len(np.unique(cases)) < 2:
        return
    means = [rows[cases == case] for case in np.unique(cases)]
    for s, sensor in enumerate(session.description.sensors):
        model, measured = (
            float(np.std([each[case, s].mean(axis=0) for case in means], axis=0).max())
            for each in (positions, session.measured)
        )
        if min(model, measured) * SCALE_APART < max(model, measured):
            raise DataError(
                session.table.file,
                f"sensor {sensor.name}",
                f"moves {1e3 * measured:.3g} mm where the model moves {1e3 * model:.3g} mm (standard "
                f"deviations); are the units right, {sensor.unit} of {', '.join(sensor.columns)}, and the "
                "commands'?",
            )


def _warnings(session: Session, solved: BoolArray, alignment: Alignment, stopped: bool) -> list[str]:
    warnings = []
    missing = int((session.used & ~solved).sum())
    if missing:
        why = "have no equilibrium of the model" if session.times is None else "come after it diverged"
        if stopped:
            why = "were not replayed"
        warnings.append(f"{missing} of {int(session.used.sum())} rows {why}, and have no error")
    turn = float(np.arccos(np.clip((np.trace(alignment.rotation) - 1.0) / 2.0, -1.0, 1.0)))
    if turn > TURNED:
        warnings.append(
            f"the fitted frame is turned by {np.degrees(turn):.0f} deg; are the axes of the data right?"
        )
    unsure = float(alignment.point_errors.max(initial=0.0))
    if unsure > 0.005:
        warnings.append(
            f"the sensor point is known to {1e3 * unsure:.1f} mm only; measure poses that tilt more"
        )
    return warnings


def _others(session: Session) -> dict[str, OtherErrors]:
    """Return the errors of other models: raw, and with a rigid frame fitted to the training rows."""
    others = {}
    for name, (sensor, positions) in session.others.items():
        measured = session.measured[:, sensor]
        rows = session.fitting
        rotation, shift = rigid_frame(
            positions[rows], measured[rows], f"session {session.name}, model {name}"
        )
        others[name] = OtherErrors(positions - measured, positions - (measured @ rotation.T + shift))
    return others


def summary(results: Sequence[SessionResult]) -> Measures:
    """Return statistics over the evaluated rows of all sessions."""
    return measures(np.concatenate([each.aligned[each.evaluated].reshape(-1, 3) for each in results]))


def plain(name: str, model: str | None, results: Sequence[SessionResult]) -> dict[str, Any]:
    """Return the comparison of a data set with a robot; None: only other models were compared."""
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
    session, report = result.session, {}
    if result.alignment is not None:
        held_out = session.used & ~session.training
        report = {
            "raw": result.of(result.evaluated, raw=True).plain(),
            "aligned": result.of(result.evaluated).plain(),
            "training": result.of(session.fitting).plain(),
            "held_out": result.of(held_out).plain() if held_out.any() else None,
            "suspect": result.of(~session.used).plain() if session.times is None else None,
            "sensors": {
                sensor: measures(result.aligned[result.evaluated, s]).plain()
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
            "alignment": {
                "rotation": result.alignment.rotation.tolist(),
                "shift_m": result.alignment.shift.tolist(),
                "points_m": result.alignment.points.tolist(),
                "point_errors_m": result.alignment.point_errors.tolist(),
                "delay_s": result.alignment.delay,
                "fitted_rows": result.alignment.rows,
            },
            "beyond_limits": result.beyond,
            "warnings": list(result.warnings),
            "each_row": _each_row(result),
        }
    return {
        "rows": len(session.table),
        "used": int(session.used.sum()),
        "judged": "held out" if (session.used & ~session.training).any() else "training",
        **report,
        "others": {
            other: {
                "raw": measures(errors.raw[session.evaluated]).plain(),
                "framed": measures(errors.aligned[session.evaluated]).plain(),
            }
            for other, errors in result.others.items()
        },
    }


def _each_row(result: SessionResult) -> list[dict[str, Any]]:
    """Return one entry per row: line in the table, commands as recorded, errors; null without prediction."""
    session, names = result.session, result.session.description.sensor_names
    columns = session.description.commands
    commands = {name: session.table.numbers(name).tolist() for name in (columns.columns if columns else ())}
    rows = []
    for k, line in enumerate(session.table.lines):
        solved = bool(result.predicted[k])
        rows.append(
            {
                "line": line,
                "time_s": None if session.times is None else float(session.times[k]),
                "used_for": "training" if session.fitting[k] else "held out" if session.used[k] else None,
                "commands": {name: values[k] for name, values in commands.items()},
                "model_m": dict(zip(names, result.positions[k].tolist(), strict=True)) if solved else None,
                "error_m": dict(zip(names, result.aligned[k].tolist(), strict=True)) if solved else None,
                "raw_error_m": dict(zip(names, result.raw[k].tolist(), strict=True)) if solved else None,
            }
        )
    return rows


def read_alignments(file: Path) -> dict[str, Alignment]:
    """Read the alignments by session from a report in JSON.

    Raises:
        DataError: the file is no such report.
    """
    try:
        sessions = json.loads(file.read_text(encoding="utf-8"))["sessions"]
        alignments = {name: each["alignment"] for name, each in sessions.items() if "alignment" in each}
        return {name: _read(each) for name, each in alignments.items()}
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(file, "", f"cannot be read ({error})") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        problem = "is no report of `softsim validate --json` with alignments"
        raise DataError(file, "", f"{problem} ({type(error).__name__})") from error


def _read(data: dict[str, Any]) -> Alignment:
    rotation, points = np.array(data["rotation"], float), np.array(data["points_m"], float)
    shift, delay = np.array(data["shift_m"], float), float(data["delay_s"])
    if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
        raise ValueError("no rotation")
    if shift.shape != (3,) or points.ndim != 2 or points.shape[1] != 3:
        raise ValueError("no shift or points")
    if not all(np.isfinite(each).all() for each in (shift, points)) or not math.isfinite(delay):
        raise ValueError("not finite")
    return Alignment(rotation, shift, points, np.zeros_like(points), delay)


def given_alignment(alignments: dict[str, Alignment], session: Session) -> Alignment:
    """Return the alignment of a session.

    Raises:
        DataError: there is none, or it is for other sensors.
    """
    name, sensors = session.name, len(session.description.sensors)
    if name not in alignments:
        raise DataError(f"session {name}", "", f"no alignment was given; there are {listing(alignments)}")
    if len(alignments[name].points) != sensors:
        raise DataError(f"session {name}", "", f"the alignment given is not one of {sensors} sensors")
    return alignments[name]


def worst(result: SessionResult, count: int) -> list[tuple[int, int, Array]]:
    """Return the largest errors of the evaluated rows: row, sensor and error (3,) in [m], largest first."""
    lengths = np.where(result.evaluated[:, None], np.linalg.norm(result.aligned, axis=2), -1.0)
    order = np.argsort(lengths, axis=None)[::-1][: min(count, int(result.evaluated.sum()) * lengths.shape[1])]
    rows, sensors = np.unravel_index(order, lengths.shape)
    return [(int(k), int(s), result.aligned[k, s]) for k, s in zip(rows, sensors, strict=True)]
