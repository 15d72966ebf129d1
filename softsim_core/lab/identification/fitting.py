r"""Parameters of a model found from measurements, and what the measurements do not tell.

What is minimised, within bounds, is in `problem`. Its noise is estimated where a search ends; with priors,
whose weight beside the rows it decides, the search goes on until both agree. A prior that the rows contradict
is left out and reported, see spread.

From the slopes J of the errors at the end follow standard errors and correlations, as if errors were
independent of each other; where those of neighbouring rows are alike, intervals are wider, see spread.
Intervals have Student's quantiles: the noise of few rows is hardly known. A parameter whose 95 % interval is
wider than its bounds has not been found, whatever number stands there.

Source: Seber, Wild 1989, Nonlinear regression (intervals from linearisation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy.stats import qmc, t

from softsim_core.base import Array, BoolArray, DataError, SceneError
from softsim_core.lab.identification.calibration import CalibrationDescription, calibration_sessions
from softsim_core.lab.identification.error_measures import PointLoss
from softsim_core.lab.identification.expressions import filled
from softsim_core.lab.identification.files import DataSet
from softsim_core.lab.identification.problem import Misfit, Problem, Progress
from softsim_core.lab.identification.spread import PriorConflict, Spread, conflicting_prior, spread_of

QUANTILE = 1.96
"""Standard errors in half of a 95 % interval, where the noise is known from many rows."""

ENOUGH = 1e-4
"""Part of their bounds, and of the sum of squares, by which the last round changes the parameters at most."""

CONSISTENT = 0.01
"""Part of itself by which the noise changes at most in the last search with priors."""

SEARCHES = 10
"""Searches after which the noise is taken as it is."""

ALIKE = 0.02
"""Ends of searches that differ by less of the bounds, from each other, are one."""


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
        freedom: Degrees of freedom of Student's distribution of each, shape (p,).
        conflicts: Priors that the rows contradict; they are left out.
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
    freedom: Array
    conflicts: tuple[PriorConflict, ...]
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
    def quantiles(self) -> Array:
        """Standard errors in half of a 95 % interval, shape (p,)."""
        return np.asarray(t.ppf(0.975, self.freedom))

    @property
    def half_widths(self) -> Array:
        """Half of the 95 % interval of each parameter, shape (p,)."""
        return np.asarray(self.quantiles * self.widening * self.errors)

    @property
    def found(self) -> BoolArray:
        """Which parameters the rows tell: whose 95 % interval is narrower than their bounds, shape (p,)."""
        return np.asarray(2.0 * self.half_widths < self.problem.span)

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
    return fit(description, misfit, following)


def fit(
    description: CalibrationDescription, misfit: Misfit, following: Following | None = None
) -> Calibration:
    """Find the parameters with the least misfit; as `calibrate`, which makes the misfit from measurements."""
    problem = Problem(misfit, PointLoss(description.loss, 1e-3 * description.scale_mm))
    start = problem.values(problem.start)
    misfit.follow(start, following)
    misfit(start)
    before = dict(misfit.means)
    endings: list[Ending] = []
    conflicts: list[PriorConflict] = []
    stopped = False
    try:
        best, endings = _best(problem, description)
        while (conflict := conflicting_prior(problem, best)) is not None:
            conflicts.append(conflict)
            problem.leave_out_prior(conflict.parameter)
            best = _refined(problem, best)
        endings[0] = _ending(problem, best)
        values, after = problem.values(best), dict(misfit.means)
        spread = spread_of(problem, best)
    except KeyboardInterrupt:
        stopped, values, after = True, misfit.best_values, misfit.best_means
        spread = Spread.unknown(len(values))
    return Calibration(
        description,
        misfit.names,
        tuple(each.unit for each in misfit.parameters),
        values,
        problem.span * spread.errors,
        spread.correlation,
        spread.widening,
        spread.freedom,
        tuple(conflicts),
        before,
        after,
        misfit.rows,
        misfit.count,
        tuple(endings),
        problem,
        stopped,
    )


def _best(problem: Problem, description: CalibrationDescription) -> tuple[Array, list[Ending]]:
    """Where the best search ended, and the endings of all, the best first.

    The first search finds the noise with which all are compared.
    """
    first, *others = _starts(problem, description)
    problem.estimate_noise(first)
    found = [_refined(problem, first)]
    for begin in others:
        try:
            found.append(_searched(problem, begin))
        except (DataError, SceneError):  # the model loses the rows at a start that nobody described
            continue
    costs = [float((problem.residuals(each) ** 2).sum()) for each in found]
    order = np.argsort(costs, kind="stable")
    endings = [_ending(problem, found[k]) for k in order]
    best = found[order[0]]
    return (best if best is found[0] else _refined(problem, best)), endings


def _starts(problem: Problem, description: CalibrationDescription) -> list[Array]:
    """Where searches begin, in parts of the bounds: as described, then spread evenly (Sobol 1967)."""
    first = np.clip(problem.start, 1e-6, 1.0 - 1e-6)
    if description.starts == 1:
        return [first]
    even = qmc.Sobol(len(first), seed=description.seed).random(2 ** int(np.ceil(np.log2(description.starts))))
    return [first, *np.clip(even[: description.starts - 1], 1e-3, 1.0 - 1e-3)]


def _refined(problem: Problem, begin: Array) -> Array:
    """Where searches from a place end that go on until their priors and the noise agree."""
    for _ in range(SEARCHES):
        before = problem.noise
        begin = _searched(problem, begin)
        problem.estimate_noise(begin)
        if not len(problem.known) or abs(problem.noise / before - 1.0) < CONSISTENT:
            break
    return begin


def _searched(problem: Problem, begin: Array) -> Array:
    """Where a search from a place ends, with the noise as it is."""
    from scipy.optimize import least_squares  # late: the rest of the package starts without it

    bounds = np.zeros(len(begin)), np.ones(len(begin))
    found = least_squares(
        problem.residuals, begin, problem.slopes, bounds, xtol=ENOUGH, ftol=ENOUGH, x_scale=1.0
    )
    return np.asarray(found.x)


def _ending(problem: Problem, place: Array) -> Ending:
    """The ending of a search at a place."""
    problem.residuals(place)
    mean = float(np.mean(list(problem.misfit.means.values())))
    return Ending(tuple(problem.values(place).tolist()), mean)
