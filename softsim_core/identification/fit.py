r"""Parameters of a model found from measurements, and what the measurements do not tell.

With the errors e(p) of all training rows, each session aligned as it is described for each p anew,

.. math:: \min_p \sum_i \rho(|e_i|^2 / s^2) + \sum_k (p_k - p_k^0)^2 / \sigma_k^2

within bounds; priors only where they are given. From the slopes J of the errors at the end follow standard
errors and correlations, as if errors were independent of each other; where those of neighbouring rows are
alike, intervals are wider, see `alike`. A parameter whose 95 % interval is wider than its bounds has not been
found, whatever number stands there.

Source: Seber, Wild 1989, Nonlinear regression (intervals from linearisation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy.stats import qmc

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.errors import DataError, SceneError
from softsim_core.identification.alike import widening
from softsim_core.identification.calibration import CalibrationDescription, calibration_sessions
from softsim_core.identification.expressions import filled
from softsim_core.identification.files import DataSet
from softsim_core.identification.misfit import Misfit, Progress
from softsim_core.identification.replay import Prediction, in_short_steps
from softsim_core.identification.session import Session

QUANTILE = 1.96
"""Standard errors in half of a 95 % interval."""

STEP = 0.004
"""Part of its bounds by which a parameter is moved to see what changes."""

ENOUGH = 1e-4
"""Part of their bounds, and of the sum of squares, by which the last round changes the parameters at most."""

ALIKE = 0.02
"""Ends of searches that differ by less of the bounds, from each other, are one."""


@dataclass(frozen=True, slots=True, eq=False)
class Around:
    """Predictions of all sessions at a place, and with each parameter moved by a step.

    Attributes:
        part: The place, in parts of the bounds, shape (p,).
        steps: Of each parameter, in parts of its bounds, shape (p,).
        here: Of the sessions.
        moved: Of the sessions, for each parameter.
    """

    part: Array
    steps: Array
    here: list[Prediction]
    moved: list[list[Prediction]]


class Problem:
    """What is minimised, in parts of the bounds: errors over the scale, then priors.

    Attributes:
        misfit: Errors of the rows.
        low: Lower bounds, shape (p,).
        span: Between the bounds, shape (p,).
        scale: What errors are divided by, in [m].
        around: Where slopes were taken last.
    """

    def __init__(self, misfit: Misfit, scale: float) -> None:
        wanted = misfit.parameters
        self.misfit, self.scale = misfit, scale
        self.low = np.array([each.lower for each in wanted])
        self.span = np.array([each.span for each in wanted])
        self.start = (np.array([each.start for each in wanted]) - self.low) / self.span
        priors = np.array([np.inf if each.prior is None else each.prior for each in wanted])
        self._known = np.flatnonzero(np.isfinite(priors))
        self._weights = (self.span / priors)[self._known]
        self.around: Around | None = None
        self._slopes: Array | None = None

    @property
    def priors(self) -> int:
        """How many of the residuals are priors."""
        return len(self._known)

    def values(self, part: Array) -> Array:
        """Parameters (p,) at a place in parts of their bounds."""
        return np.asarray(self.low + self.span * part)

    def residuals(self, part: Array) -> Array:
        """Of a replay, shape (n,)."""
        return self._joined(self.misfit(self.values(part)), part)

    def _joined(self, errors: Array, part: Array) -> Array:
        beside = self._weights * (part - self.start)[self._known]
        return np.concatenate([errors / self.scale, beside])

    def slopes(self, part: Array) -> Array:
        """Derivatives of the residuals by differences, shape (n, p)."""
        if self._slopes is not None and self.around is not None and np.array_equal(self.around.part, part):
            return self._slopes
        steps = np.where(part + STEP <= 1.0, STEP, -STEP)
        residuals = [self.residuals(part)]
        here, moved = self.misfit.latest, []
        for each in np.diag(steps):
            residuals.append(self.residuals(part + each))
            moved.append(self.misfit.latest)
        self.around = Around(part.copy(), steps, here, moved)
        self._slopes = (np.array(residuals[1:]) - residuals[0]).T / steps
        return self._slopes

    def again(self, around: Around, sessions: Sequence[Session]) -> tuple[Array, Array]:
        """Residuals (n,) and slopes (n, p) of replays that have been made, with other rows that fit."""

        def residuals(predictions: Sequence[Prediction], part: Array) -> Array:
            return self._joined(self.misfit.errors(predictions, self.values(part), sessions), part)

        here = residuals(around.here, around.part)
        places = around.part + np.diag(around.steps)
        moved = [residuals(each, place) for each, place in zip(around.moved, places, strict=True)]
        return here, np.asarray((np.array(moved) - here).T / around.steps)


@dataclass(frozen=True, slots=True)
class Ending:
    """Where a search ended: its parameters, and the mean error of the rows in [m]."""

    values: tuple[float, ...]
    mean: float


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What was found.

    Attributes:
        description: What was sought.
        names: Of the parameters; of one that each session has its own of, with the session's.
        units: Of these.
        values: Of the parameters, shape (p,).
        errors: Their standard errors, infinite where the rows tell nothing, shape (p,).
        correlation: Of these, shape (p, p).
        widening: How many times as large they are because neighbouring rows err alike, >= 1, shape (p,).
        before, after: Mean error of the rows in [m] with the start values and with those found, by session.
        rows: How many rows each session gave.
        evaluations: How often all rows were replayed.
        endings: Where searches from other starts ended, the best first.
        problem: What was minimised, for what judges the result.
        stopped: Whether it was interrupted; then the errors are those of the best that was tried, and
            `errors` infinite.
    """

    description: CalibrationDescription
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    errors: Array
    correlation: Array
    widening: Array
    before: dict[str, float]
    after: dict[str, float]
    rows: dict[str, int]
    evaluations: int
    endings: tuple[Ending, ...]
    problem: Problem
    stopped: bool = False

    @property
    def covariance(self) -> Array:
        """Of the parameters, shape (p, p); infinite variances where the rows tell nothing."""
        spread = np.multiply.outer(self.errors, self.errors)
        with np.errstate(invalid="ignore"):
            return np.asarray(
                np.where(np.eye(len(spread), dtype=np.bool_), spread, self.correlation * spread)
            )

    @property
    def found(self) -> BoolArray:
        """Which parameters the rows tell: whose 95 % interval is narrower than their bounds, shape (p,)."""
        return np.asarray(2.0 * QUANTILE * self.widening * self.errors < self.problem.span)

    @property
    def at_bounds(self) -> BoolArray:
        """Which of them ended at a bound, shape (p,)."""
        part = (self.values - self.problem.low) / self.problem.span
        return np.asarray((part < 1e-3) | (part > 1.0 - 1e-3))

    @property
    def other_endings(self) -> tuple[Ending, ...]:
        """Those that ended elsewhere than the best, by more than `ALIKE` of the bounds."""
        part = [(np.array(each.values) - self.values) / self.problem.span for each in self.endings]
        return tuple(
            each for each, away in zip(self.endings, part, strict=True) if np.abs(away).max() > ALIKE
        )

    @property
    def overlay(self) -> dict[str, Any]:
        """What lays the values over the robot; of what sessions differ in, the mean."""
        return overlay_of(self.description, self.names, self.values)


def overlay_of(description: CalibrationDescription, names: Sequence[str], values: Array) -> dict[str, Any]:
    """What lays values (p,) of parameters over the robot; of what sessions differ in, the mean."""
    each = {
        wanted.name: float(
            np.mean([value for name, value in zip(names, values, strict=True) if _of(name) == wanted.name])
        )
        for wanted in description.parameters
    }
    overlay = filled(description.overlay, each)
    assert isinstance(overlay, dict)
    return overlay


def _of(name: str) -> str:
    """The parameter that a name is of; see `Misfit.names`."""
    return name.partition(" ")[0]


Following: TypeAlias = Callable[[int, int], None]
"""Told how many rows of a session have been found once, of how many."""


def calibrate(
    description: CalibrationDescription,
    data: DataSet,
    every: int | None = None,
    progress: Progress | None = None,
    following: Following | None = None,
) -> Calibration:
    """Fit a model to measurements; an interrupt (Ctrl-C) keeps the best so far.

    Args:
        description: What to fit.
        data: The measurements.
        every: In the place of that of the description; None: as described.
        progress: Told what is done.
        following: Told, before that, how many rows of a session are found of how many.

    Raises:
        DataError: the data cannot be used, or the model loses their rows.
        SceneError: a scene cannot be built with values within the bounds.
    """
    whole = calibration_sessions(description, data)
    misfit = Misfit(description, description.robot or data.robot, whole, every or description.every, progress)
    problem = Problem(misfit, 1e-3 * description.scale_mm)
    start = problem.values(problem.start)
    misfit.follow(start, following)
    misfit(start)
    before = dict(misfit.means)
    endings: list[tuple[float, Array, Ending]] = []
    stopped = False
    try:
        for begin in _starts(problem, description):
            ending = _searched(problem, begin, description)
            if ending is not None:
                endings.append(ending)
        endings.sort(key=lambda each: each[0])
        best = endings[0][1]
        slopes, left = problem.slopes(best), problem.residuals(best)
        values, after = problem.values(best), dict(misfit.means)
        spread, correlation = _spread(slopes, left, problem)
        wider = widening(slopes, left, [_in_order(each) for each in misfit.sessions])
    except KeyboardInterrupt:
        stopped, values, after = True, misfit.best_values, misfit.best_means
        spread = np.full(len(values), np.inf)
        correlation, wider = np.full((len(values),) * 2, np.nan), np.ones(len(values))
    return Calibration(
        description,
        misfit.names,
        tuple(each.unit for each in misfit.parameters),
        values,
        problem.span * spread,
        correlation,
        wider,
        before,
        after,
        misfit.rows,
        misfit.count,
        tuple(each[2] for each in endings),
        problem,
        stopped,
    )


def _starts(problem: Problem, description: CalibrationDescription) -> list[Array]:
    """Where searches begin, in parts of the bounds: as described, then spread evenly (Sobol 1967)."""
    first = np.clip(problem.start, 1e-6, 1.0 - 1e-6)
    if description.starts == 1:
        return [first]
    even = qmc.Sobol(len(first), seed=description.seed).random(2 ** int(np.ceil(np.log2(description.starts))))
    return [first, *np.clip(even[: description.starts - 1], 1e-3, 1.0 - 1e-3)]


def _searched(
    problem: Problem, begin: Array, description: CalibrationDescription
) -> tuple[float, Array, Ending] | None:
    """Cost, place and ending of a search; None: the model loses the rows at a start that nobody described."""
    from scipy.optimize import least_squares  # late: the rest of the package starts without it

    bounds = np.zeros(len(begin)), np.ones(len(begin))
    try:
        found = least_squares(
            problem.residuals, begin, problem.slopes, bounds, loss=description.loss,
            xtol=ENOUGH, ftol=ENOUGH, x_scale=1.0,
        )  # fmt: skip
    except (DataError, SceneError):
        if np.abs(begin - problem.start).max() < 1e-3:
            raise
        return None
    problem.residuals(found.x)
    mean = float(np.mean(list(problem.misfit.means.values())))
    return float(found.cost), found.x, Ending(tuple(problem.values(found.x).tolist()), mean)


def _in_order(session: Session) -> tuple[IndexArray, int]:
    """Rows that fit in an order in which neighbours follow each other, and how many errors each has."""
    size, count = 3 * len(session.description.sensors), int(session.fitting.sum())
    if session.times is not None:
        return np.arange(count), size
    places = session.measured[session.fitting].reshape(count, size)
    return in_short_steps(places, places[0]), size


def freedom(problem: Problem, residuals: int) -> int:
    """Residuals of rows beyond what is fitted to them: parameters, frames, sensor points."""
    aligned = sum(
        6 * each.description.alignment.frame
        + 3 * each.description.alignment.point * len(each.description.sensors)
        for each in problem.misfit.sessions
    )
    return max(residuals - problem.priors - len(problem.span) - aligned, 1)


def _spread(slopes: Array, left: Array, problem: Problem) -> tuple[Array, Array]:
    """Standard errors (p,) and correlations (p, p) from the slopes at the end and the errors left there."""
    count = len(left) - problem.priors
    variance = float((left[:count] ** 2).sum()) / freedom(problem, len(left))
    weighted = slopes.copy()
    weighted[:count] /= np.sqrt(max(variance, 1e-30))
    _, sizes, vt = np.linalg.svd(weighted, full_matrices=False)
    with np.errstate(divide="ignore"):
        parts = vt.T / sizes
    spread = np.sqrt((parts**2).sum(axis=1))
    with np.errstate(invalid="ignore"):
        correlation = (parts @ parts.T) / np.multiply.outer(spread, spread)
    return spread, correlation
