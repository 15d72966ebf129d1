r"""Fit of a model's parameters to measurements, with the uncertainty of each parameter.

The minimised function and its bounds are defined in `problem`. The noise is estimated where a search ends.
With priors, the noise decides their weight beside the rows, and the search is repeated until both agree. A
prior that the rows contradict is left out and reported; see spread.

Standard errors and correlations follow from the slopes J of the errors at the end, as if errors were
independent. Where neighbouring rows have correlated errors, the intervals are wider; see spread. Intervals
use Student's quantiles, because few rows determine the noise poorly. A parameter with a 95 % interval wider
than its bounds counts as not found, whatever its value.

Source: Seber, Wild 1989, Nonlinear regression (intervals from linearisation).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc, t

from softsim_core.base import Array, BoolArray, DataError, SceneError
from softsim_core.lab.identification.calibration import CalibrationDescription, calibration_sessions
from softsim_core.lab.identification.description import DataSet
from softsim_core.lab.identification.error_measures import PointLoss
from softsim_core.lab.identification.expressions import replace_expressions
from softsim_core.lab.identification.problem import Misfit, Problem, Progress
from softsim_core.lab.identification.spread import PriorConflict, Spread, conflicting_prior, spread_of

QUANTILE = 1.96
"""Standard errors in half of a 95 % interval, if the noise is known from many rows."""

ENOUGH = 1e-4
"""Convergence: largest change of the last round, as a part of the bounds and of the sum of squares."""

CONSISTENT = 0.01
"""Convergence: largest relative change of the noise in the last search with priors."""

SEARCHES = 10
"""Searches after which the noise is accepted as it is."""

ALIKE = 0.02
"""Ends of searches that differ by less than this part of the bounds count as the same."""


@dataclass(frozen=True, slots=True)
class Ending:
    """End of a search: its parameters, and the mean error of the rows in [m]."""

    values: tuple[float, ...]
    mean: float


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Result of a calibration.

    Attributes:
        description: The calibration's description.
        names: Names of the parameters; a parameter per session also names the session.
        units: Their units.
        values: Values of the parameters, shape (p,).
        errors: Their standard errors, infinite where the rows contain no information, shape (p,).
        correlation: Correlation of the parameters, shape (p, p).
        widening: Factor by which correlated errors of neighbouring rows widen `errors`, >= 1, shape (p,).
        freedom: Degrees of freedom of each parameter's Student distribution, shape (p,).
        conflicts: Priors that the rows contradict; the fit does not use them.
        before, after: Mean error of the rows in [m] at the start values and at the result, by session.
        rows: Number of rows by session.
        evaluations: Number of replays of all rows.
        endings: Ends of the searches from all starts, the best first.
        problem: The minimised problem, for the assessment of the result.
        stopped: Whether the fit was interrupted; then the values are the best ones tried, and `errors` are
            infinite.
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
        """Covariance of the parameters, shape (p, p); infinite where the rows contain no information."""
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
        """Whether each parameter's 95 % interval is narrower than its bounds, shape (p,)."""
        return np.asarray(2.0 * self.half_widths < self.problem.span)

    @property
    def at_bounds(self) -> BoolArray:
        """Whether each parameter ended at a bound, shape (p,)."""
        part = (self.values - self.problem.low) / self.problem.span
        return np.asarray((part < 1e-3) | (part > 1.0 - 1e-3))

    @property
    def other_endings(self) -> tuple[Ending, ...]:
        """Ends that differ from the best one by more than `ALIKE` of the bounds."""
        part = [(np.array(each.values) - self.values) / self.problem.span for each in self.endings]
        return tuple(
            each for each, away in zip(self.endings, part, strict=True) if np.abs(away).max() > ALIKE
        )

    @property
    def overlay(self) -> dict[str, Any]:
        """Overlay of the robot with the fitted values; for parameters per session, the mean."""
        of = np.array([name.partition(" ")[0] for name in self.names])  # see `Misfit.names`
        means = {
            each.name: float(self.values[of == each.name].mean()) for each in self.description.parameters
        }
        overlay: dict[str, Any] = replace_expressions(self.description.overlay, means)
        return overlay


Following: TypeAlias = Callable[[int, int], None]
"""Called with the number of rows of a session whose equilibrium was found once, and the total."""


def calibrate(
    description: CalibrationDescription,
    data: DataSet,
    every: int | None = None,
    progress: Progress | None = None,
    following: Following | None = None,
) -> Calibration:
    """Fit a model to measurements; an interrupt (Ctrl-C) returns the best result so far.

    Args:
        description: The calibration.
        data: The measurements.
        every: Replaces `every` of the description; None: as described.
        progress: Called with the progress of the fit.
        following: Called before that with the number of rows of a session that were found, and the total.

    Raises:
        DataError: the data cannot be used, or the model finds no equilibria for their rows.
        SceneError: a scene cannot be built with values within the bounds.
    """
    whole = calibration_sessions(description, data)
    misfit = Misfit(description, description.robot or data.robot, whole, every or description.every, progress)
    return fit(description, misfit, following)


def fit(
    description: CalibrationDescription, misfit: Misfit, following: Following | None = None
) -> Calibration:
    """Find the parameters with the least misfit; `calibrate` creates the misfit from measurements."""
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
            best = _refine_fit(problem, best)
        endings[0] = _ending(problem, best)
        values, after = problem.values(best), dict(misfit.means)
        spread = spread_of(problem, best)
    except KeyboardInterrupt:
        stopped, values, after = True, misfit.best_values, misfit.best_means
        unlimited = np.full(len(values), np.inf)
        unknown = np.full((len(values), len(values)), np.nan)
        spread = Spread(unlimited, unknown, np.ones(len(values)), unlimited)
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
    """Return the best end of all searches, and all ends, the best first.

    The noise of the first search is used to compare all of them.
    """
    first, others = np.clip(problem.start, 1e-6, 1.0 - 1e-6), np.empty((0, len(problem.start)))
    if description.starts > 1:  # evenly spread ones (Sobol 1967) beside the described one
        exponent = int(np.ceil(np.log2(description.starts)))
        even = qmc.Sobol(len(first), seed=description.seed).random(2**exponent)
        others = np.clip(even[: description.starts - 1], 1e-3, 1.0 - 1e-3)
    problem.estimate_noise(first)
    found = [_refine_fit(problem, first)]
    for begin in others:
        try:
            found.append(_search_minimum(problem, begin))
        except (DataError, SceneError):  # equilibria may not exist at sampled starts
            continue
    costs = [float((problem.residuals(each) ** 2).sum()) for each in found]
    order = np.argsort(costs, kind="stable")
    endings = [_ending(problem, found[k]) for k in order]
    best = found[order[0]]
    return (best if best is found[0] else _refine_fit(problem, best)), endings


def _refine_fit(problem: Problem, begin: Array) -> Array:
    """Repeat searches from a place until priors and noise agree; return the end."""
    for _ in range(SEARCHES):
        before = problem.noise
        begin = _search_minimum(problem, begin)
        problem.estimate_noise(begin)
        if not len(problem.with_prior) or abs(problem.noise / before - 1.0) < CONSISTENT:
            break
    return begin


def _search_minimum(problem: Problem, begin: Array) -> Array:
    """Search from a place with the present noise; return the end."""
    bounds = np.zeros(len(begin)), np.ones(len(begin))
    found = least_squares(
        problem.residuals, begin, problem.slopes, bounds, xtol=ENOUGH, ftol=ENOUGH, x_scale=1.0
    )
    return np.asarray(found.x)


def _ending(problem: Problem, place: Array) -> Ending:
    """Return the ending of a search at a place."""
    problem.residuals(place)
    mean = float(np.mean(list(problem.misfit.means.values())))
    return Ending(tuple(problem.values(place).tolist()), mean)
