r"""How far a calibration can be trusted: errors of rows that were left out, intervals by profile likelihood.

Rows are dealt into folds; the parameters are fitted to all but one fold, by one Gauss-Newton step from those
of all rows with the slopes there, and that fold is compared. A profile of a parameter is the least sum of
squares with it held at a value, with the noise of the whole fit; its 95 % interval reaches to where this has
grown by the square of its half width in standard errors.

Sources: Stone 1974, Cross-validatory choice; Venzon, Moolgavkar 1988, Profile-likelihood-based intervals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from softsim_core.arrays import Array, BoolArray
from softsim_core.errors import DataError
from softsim_core.identification.fit import Calibration
from softsim_core.identification.misfit import mean_distance
from softsim_core.identification.problem import Problem
from softsim_core.identification.session import Session
from softsim_core.identification.validation import compared

ROUNDS: Final = 4
"""Places that are tried for an end of an interval."""

CLOSE: Final = 0.05
"""Part of the growth sought by which an end of an interval is missed at most."""

Done = Callable[[int, int], None]
"""Told what is done, and what there is in all."""


@dataclass(frozen=True, slots=True)
class Folds:
    """Mean errors in [m], by session: of rows that were fitted, and of rows that were left out."""

    count: int
    fitted: dict[str, float]
    left_out: dict[str, float]

    @property
    def ratio(self) -> float:
        """Error of rows that were left out over that of fitted ones, over all sessions."""
        return float(np.mean(list(self.left_out.values())) / np.mean(list(self.fitted.values())))


def cross_validated(result: Calibration, count: int = 5, seed: int = 0, done: Done | None = None) -> Folds:
    """Errors of rows that were not fitted.

    Args:
        result: The calibration, not interrupted.
        count: Folds.
        seed: Deals the rows; those of sessions in time are cut into as many spans.
        done: Told how many folds are done.

    Raises:
        DataError: a session has too few rows.
    """
    problem = result.problem
    best = (result.values - problem.low) / problem.span
    around = problem.look_around(best)
    generator, sessions = np.random.default_rng(seed), problem.misfit.sessions
    fold_of = [_dealt(each, count, generator) for each in sessions]
    fitted: dict[str, list[float]] = {each.name: [] for each in sessions}
    left_out: dict[str, list[float]] = {each.name: [] for each in sessions}
    for fold in range(count):
        training = [
            replace(each, training=each.training & (of != fold))
            for each, of in zip(sessions, fold_of, strict=True)
        ]
        here, slopes = problem.again(around, training)
        part = np.clip(best - np.linalg.lstsq(slopes, here, rcond=None)[0], 0.0, 1.0)
        predictions = problem.misfit.replayed(problem.values(part))
        for session, whole, of, prediction in zip(training, sessions, fold_of, predictions, strict=True):
            compare = compared(session, prediction)
            errors, known = compare.fitted_errors(), compare.known
            fitted[session.name].append(mean_distance(errors[session.fitting & known]))
            left_out[session.name].append(mean_distance(errors[whole.fitting & (of == fold) & known]))
        if done is not None:
            done(fold + 1, count)
    return Folds(count, _means(fitted), _means(left_out))


def _means(parts: dict[str, list[float]]) -> dict[str, float]:
    return {name: float(np.mean(each)) for name, each in parts.items()}


def _dealt(session: Session, count: int, generator: np.random.Generator) -> Array:
    """The fold of each row that fits, shape (k,); -1 elsewhere."""
    rows = np.flatnonzero(session.fitting)
    if len(rows) < 2 * count:
        raise DataError(f"session {session.name}", "", f"{len(rows)} rows are too few for {count} folds")
    folds = np.full(len(session.table), -1)
    even = np.arange(len(rows)) * count // len(rows)
    folds[rows] = even if session.times is not None else generator.permutation(even)
    return folds


def profiled(result: Calibration, parameter: int, done: Done | None = None) -> tuple[float, float]:
    """95 % interval of a parameter by profile likelihood; an end at a bound or beyond is infinite.

    Args:
        result: The calibration, not interrupted.
        parameter: Its number.
        done: Told how many of the two ends are found.
    """
    problem, ends = result.problem, []
    best = (result.values - problem.low) / problem.span
    slopes, left = problem.slopes(best), problem.residuals(best)
    least = float(left @ left)
    wanted = float(result.quantiles[parameter] * result.widening[parameter]) ** 2
    others = np.arange(len(best)) != parameter
    along = np.zeros_like(best)  # how the others follow, to first order
    along[parameter] = 1.0
    inverse = np.linalg.pinv(slopes[:, others])
    along[others] = -inverse @ slopes[:, parameter]
    first = float(np.sqrt(wanted)) / max(float(np.linalg.norm(slopes @ along)), 1e-12)
    for number, sign in enumerate((-1.0, 1.0)):
        ends.append(_end(problem, best, sign * along, inverse, others, (least, wanted, first)))
        if done is not None:
            done(number + 1, 2)
    low, high = ends
    return (
        float(result.values[parameter] - problem.span[parameter] * low),
        float(result.values[parameter] + problem.span[parameter] * high),
    )


def _end(
    problem: Problem,
    best: Array,
    along: Array,
    inverse: Array,
    others: BoolArray,
    sought: tuple[float, float, float],
) -> float:
    """How far a parameter goes until the least sum of squares has grown as wanted; infinite beyond a bound.

    Args:
        problem: What is minimised.
        best: The parameters found, in parts of their bounds, shape (p,).
        along: How all change with a unit of the parameter that is held, shape (p,).
        inverse: Pseudo-inverse of the slopes of the others, shape (p - 1, n).
        others: Which these are, shape (p,).
        sought: The least sum of squares, its growth that is sought, and where to try first.
    """
    least, wanted, away = sought
    held = int(np.flatnonzero(~others)[0])
    room = (1.0 - best[held]) if along[held] > 0.0 else best[held]
    for _ in range(ROUNDS):
        if away >= room:
            return np.inf
        part = np.clip(best + away * along, 0.0, 1.0)
        residuals = problem.residuals(part)
        part[others] = np.clip(part[others] - inverse @ residuals, 0.0, 1.0)
        better = problem.residuals(part)
        growth = max(min(float(better @ better), float(residuals @ residuals)) - least, 1e-12 * wanted)
        if abs(growth - wanted) < CLOSE * wanted:
            break
        away *= float(np.clip(np.sqrt(wanted / growth), 0.3, 3.0))
    return away
