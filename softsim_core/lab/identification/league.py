r"""A league: every model of a measured robot on the same rows, beside regressions that know no physics.

The regression is a polynomial of degree 3 in the commands, scaled to :math:`[-1, 1]`, with a ridge penalty
:math:`\lambda`: the coefficients minimise :math:`\|\Phi c - Y\|^2 + \lambda \|c\|^2`, where the columns of
:math:`\Phi` and :math:`Y` are centred. The penalty is the one with the least error of cross-validation in the
training rows, in folds of the kind that is held out: stretches of the run where a data set holds rows out,
load cases drawn at random where it does not.

Source: Hastie, Tibshirani, Friedman 2009, The elements of statistical learning, sections 3.4 and 7.10.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any, Literal, TypeAlias

import numpy as np

from softsim_core.base import Array, BoolArray, DataError, IndexArray
from softsim_core.lab.identification.description import DataSet, ModelDescription
from softsim_core.lab.identification.error_measures import Measures, measures
from softsim_core.lab.identification.session import Session, load_session
from softsim_core.lab.identification.validation import SessionResult, session_robot, validate_session

Kind: TypeAlias = Literal["ours", "other", "regression", "published"]
"""Kind of a model: a robot of this library, positions in the tables, a regression, errors others state."""

DEGREE = 3
"""Degree of the regression's polynomial."""

FOLDS = 5
"""Number of folds whose errors are predicted from the others, where no rows are held out."""

PENALTIES = np.geomspace(1e-8, 1e4, 49)
"""Ridge penalties to choose from, over the largest squared singular value of the features."""

REGRESSION = "cubic regression"


@dataclass(frozen=True, slots=True)
class LeagueEntry:
    """Errors of a model over all sessions of a data set.

    Attributes:
        data_set: Name of the data set.
        model: Name of the robot, of another model, or of the regression.
        kind: Kind of the model.
        numbers: Count of fitted numbers: identified parameters, frames, sensor points and delays, or the
            coefficients of the regression; None: unknown.
        training: Errors of the training rows.
        held_out: Errors of the held-out rows; for a regression of a data set without any, of folds.
        percent: Root mean square of the held-out rows, or else of the training rows, in percent of the
            robot's length; None: the length is not given.
        milliseconds: Time of a row; None: it was not measured.
        note: Rows to which the parameters were fitted, and rows without prediction.
    """

    data_set: str
    model: str
    kind: Kind
    numbers: int | None
    training: Measures
    held_out: Measures
    percent: float | None
    milliseconds: float | None = None
    note: str = ""

    def plain(self) -> dict[str, Any]:
        """Return the entry for JSON, errors in [mm]."""
        own = {name: getattr(self, name) for name in ("data_set", "model", "kind", "numbers")}
        errors = {"training": self.training.plain(), "held_out": self.held_out.plain()}
        rest = {"percent_of_length": self.percent, "ms_per_row": self.milliseconds, "note": self.note}
        return {**own, **errors, **rest}


def league_entries(
    data: DataSet, every: int = 1, progress: Callable[[str, int, int], None] | None = None
) -> list[LeagueEntry]:
    """Compare all models of a data set on its rows: the robot, further models, others and a regression.

    Args:
        data: The data set.
        every: Only each N-th row of static sessions is compared.
        progress: Called with the model's name and the progress in a session.

    Raises:
        DataError: a table is missing or wrong, or does not fit a robot.
        SceneError: a robot cannot be built.
    """
    description = data.description
    sessions = [load_session(data, each, every) for each in description.sessions]
    models = description.models or (ModelDescription(robot=description.robot),)
    entries, replayed = [], [each for each in sessions if each.description.replayed]
    for model in models if replayed else ():
        begin = time.perf_counter()
        results = [_validated(data, model.robot, each, progress) for each in replayed]
        spent = time.perf_counter() - begin
        numbers = model.parameters + sum(each.description.fitted_numbers for each in replayed)
        unsolved = sum(int((each.session.used & ~each.predicted).sum()) for each in results)
        notes = [model.note] * bool(model.note) + [f"{unsolved} rows without equilibrium"] * bool(unsolved)
        found = [(each.session, each.aligned, each.predicted) for each in results]
        rows = sum(len(each.table) for each in replayed)
        entry = _entry(data, (model.robot, "ours", numbers), found, "; ".join(notes))
        entries.append(replace(entry, milliseconds=1e3 * spent / rows))
    return entries + _other_entries(data, sessions) + _regression_entries(data, sessions)


def _validated(
    data: DataSet, robot: str, session: Session, progress: Callable[[str, int, int], None] | None
) -> SessionResult:
    model = session_robot(data.model_file(robot), session.description)

    def report(done: int, total: int) -> None:
        if progress is not None:
            progress(f"{robot}, {session.name}", done, total)

    result = validate_session(session, model, progress=report)
    if result.stopped:
        raise KeyboardInterrupt
    return result


def _entry(
    data: DataSet,
    named: tuple[str, Kind, int | None],
    found: Sequence[tuple[Session, Array, BoolArray]],
    note: str = "",
) -> LeagueEntry:
    """Return an entry from its model, kind and numbers, and from errors (k, s, 3) and rows of sessions."""
    training = [errors[session.fitting & rows] for session, errors, rows in found]
    held_out = [errors[session.used & ~session.training & rows] for session, errors, rows in found]
    return _entry_of(data, named, _pooled(training), _pooled(held_out), note)


def _pooled(errors: Sequence[Array]) -> Measures:
    return measures(np.concatenate([each.reshape(-1, 3) for each in errors]))


def _entry_of(
    data: DataSet, named: tuple[str, Kind, int | None], training: Measures, held_out: Measures, note: str
) -> LeagueEntry:
    length, rms = data.description.length, (held_out if held_out.count else training).rms
    percent = None if length is None or not np.isfinite(rms) else 100.0 * rms / length
    return LeagueEntry(data.description.name, *named, training, held_out, percent, note=note)


def _other_entries(data: DataSet, sessions: Sequence[Session]) -> list[LeagueEntry]:
    """Return the entries of the models whose positions are in the tables, and of published errors."""
    found: dict[str, list[tuple[Session, Array, BoolArray]]] = {}
    for session in sessions:
        result = validate_session(session, None)
        for name, errors in result.others.items():
            rows = np.ones(len(session.used), bool)
            found.setdefault(name, []).append((session, errors.aligned[:, None], rows))
    entries = [_entry(data, (name, "other", 6 * len(each)), each) for name, each in found.items()]
    nothing = _pooled([np.empty((0, 3))])
    for each in data.description.published:
        mean, rms = (np.nan if e is None else 1e-3 * e for e in (each.mean_mm, each.rms_mm))
        error = Measures(0, mean, rms, np.nan, np.nan)
        entries.append(_entry_of(data, (each.model, "published", None), error, nothing, each.note))
    return entries


def _regression_entries(data: DataSet, sessions: Sequence[Session]) -> list[LeagueEntry]:
    """Return the entry of the regression over the static sessions with commands; none without any."""
    training, others, numbers = [], [], 0
    for session in sessions:
        if session.description.commands is None or session.times is not None:
            continue
        rows = np.flatnonzero(session.fitting)
        held_out = np.flatnonzero(session.used & ~session.training)
        cases = np.unique(session.load_cases[rows])
        if len(cases) < FOLDS:
            continue
        training.append(regression_errors(session, rows, rows))
        if len(held_out):
            others.append(regression_errors(session, rows, held_out))
        else:
            for fold in _folds(session, rows):
                others.append(regression_errors(session, np.setdiff1d(rows, fold), fold))
        numbers += training[-1][0].size * len(_powers(len(session.description.commands.columns)))
    if not training:
        return []
    split = any((each.used & ~each.training).any() for each in sessions)
    note = "" if split else f"held out: {FOLDS} folds"
    named: tuple[str, Kind, int] = (REGRESSION, "regression", numbers)
    return [_entry_of(data, named, _pooled(training), _pooled(others), note)]


def regression_errors(session: Session, training: IndexArray, rows: IndexArray) -> Array:
    """Return errors of the cubic regression in [m], shape (k, s, 3).

    Args:
        session: Rows with commands.
        training: Indices of the rows to which it is fitted.
        rows: Indices of the rows that it predicts.
    """
    columns = session.description.commands
    if columns is None:
        raise DataError(f"session {session.name}", "commands", "a regression needs commands; there are none")
    commands = np.stack([session.table.numbers(name, columns.unit) for name in columns.columns], axis=1)
    low, high = commands[training].min(axis=0), commands[training].max(axis=0)
    scaled = (2.0 * commands - low - high) / np.where(high > low, high - low, 1.0)
    features = np.stack(
        [scaled[:, list(power)].prod(axis=1) for power in _powers(len(columns.columns))], axis=1
    )
    readings = session.measured.reshape(len(features), -1)
    largest = np.linalg.norm(features[training] - features[training].mean(axis=0), 2) ** 2
    errors = np.zeros(len(PENALTIES))
    for fold in _folds(session, training):
        predict = _ridge(features, readings, np.setdiff1d(training, fold))
        errors += [((predict(fold, each * largest) - readings[fold]) ** 2).sum() for each in PENALTIES]
    best = PENALTIES[int(np.argmin(errors))] * largest
    predicted = _ridge(features, readings, training)(rows, best)
    return np.asarray((predicted - readings[rows]).reshape(len(rows), -1, 3))


def _folds(session: Session, rows: IndexArray) -> list[IndexArray]:
    """Divide rows as they are held out: stretches, or, where none are, load cases drawn at random."""
    if (session.used & ~session.training).any():
        return np.array_split(rows, FOLDS)
    cases = session.load_cases[rows]  # rows of one stay together: one would predict the other
    drawn = np.random.default_rng(0).permutation(np.unique(cases))
    return [rows[np.isin(cases, part)] for part in np.array_split(drawn, FOLDS)]


def _ridge(features: Array, readings: Array, rows: IndexArray) -> Callable[[IndexArray, float], Array]:
    """Return a function that predicts readings of rows with a penalty, fitted to other rows."""
    centre, middle = features[rows].mean(axis=0), readings[rows].mean(axis=0)
    u, s, vt = np.linalg.svd(features[rows] - centre, full_matrices=False)
    along = u.T @ (readings[rows] - middle)

    def predict(others: IndexArray, penalty: float) -> Array:
        shrunk = (s / (s**2 + penalty))[:, None] * along
        return np.asarray((features[others] - centre) @ (vt.T @ shrunk) + middle)

    return predict


def _powers(commands: int) -> list[tuple[int, ...]]:
    """Return the indices of the factors of each monomial, without the constant."""
    return [p for k in range(1, DEGREE + 1) for p in combinations_with_replacement(range(commands), k)]
