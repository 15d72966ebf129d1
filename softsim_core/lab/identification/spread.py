r"""Uncertainty of fitted parameters: standard errors, correlated rows, contradicted priors.

With the slopes J and the residuals r of row i, its score is :math:`s_i = J_i^T r_i`. The fitted parameters
have the covariance :math:`A \, \sum_k w_k \sum_i s_i s_{i+k}^T \, A` with :math:`A = (J^T J)^{-1}`. The sum
extends over twice as many neighbours k as have significantly correlated errors, with weights that decrease to
zero. Its ratio to the same sum without neighbours is the widening of the intervals.

Source: Newey, West 1987, A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent
covariance matrix.

With slopes J of the rows over their noise and the precision P of priors, the covariance is
:math:`(J^T J + P)^{-1}`. The part of a variance that comes from the rows has the uncertainty of the noise,
with :math:`\nu` degrees of freedom; the part of the priors is known.

Source: Satterthwaite 1946 (degrees of freedom of a sum of variances).

An estimate :math:`\hat p \pm s` from the rows and a prior :math:`p^0 \pm \sigma` agree if
:math:`z = (\hat p - p^0) / \sqrt{s^2 + \sigma^2}` lies within Student's distribution. Both follow from the
fit with the prior. With h, the part of the prior's variance that is left in the fit, and r, its residual,
:math:`\hat p - p^0 = \sigma r / (1 - h)` and :math:`s^2 = \sigma^2 h / (1 - h)`, to first order.

Source: Evans, Moshonov 2006, Checking for prior-data conflict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from softsim_core.base import Array, IndexArray
from softsim_core.lab.identification.model_replay import in_short_steps
from softsim_core.lab.identification.problem import Problem

CHANCE = 2.0
"""Significance of a correlation, in standard deviations of the correlation of independent rows."""


def widening(
    slopes: Array,
    residuals: Array,
    sessions: Sequence[tuple[IndexArray, int]],
    priors: Array | None = None,
) -> Array:
    """Return the factor by which the interval of each parameter is wider, shape (p,), >= 1.

    Args:
        slopes: Slopes of all residuals, session by session, shape (n, p).
        residuals: Residuals, shape (n,), in units of the priors' unit variance.
        sessions: For each session, the order of neighbouring rows (k,) and the number of residuals per row.
        priors: Slopes of independent residuals with unit variance, shape (m, p).
    """
    prior_information = np.zeros((slopes.shape[1],) * 2) if priors is None else priors.T @ priors
    inverse = np.linalg.pinv(slopes.T @ slopes + prior_information)
    apart, together = prior_information.copy(), prior_information.copy()
    first = 0
    for order, size in sessions:
        own = slice(first, first + len(order) * size)
        first = own.stop
        errors = residuals[own].reshape(len(order), size)[order]
        scores = (slopes[own] * residuals[own, None]).reshape(len(order), size, -1).sum(axis=1)[order]
        window = 2 * neighbours(errors)
        product = scores.T @ scores
        apart += product
        together += product
        for k in range(1, window + 1):
            product = (1.0 - k / (window + 1.0)) * scores[k:].T @ scores[:-k]
            together += product + product.T
    before, after = (np.diagonal(inverse @ each @ inverse) for each in (apart, together))
    return np.sqrt(np.maximum(after / np.maximum(before, 1e-300), 1.0))


def neighbours(errors: Array) -> int:
    """Return how many of the following rows have correlated errors; errors (k, e)."""
    count, total = len(errors), float((errors**2).sum())
    if total == 0.0:
        return 0
    for k in range(1, count // 4 + 1):
        if (errors[k:] * errors[:-k]).sum() / total < CHANCE / np.sqrt(count):
            return k - 1
    return count // 4


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Uncertainty of p parameters, in parts of their bounds.

    Attributes:
        errors: Standard errors, as if the errors of rows were independent, shape (p,).
        correlation: Correlation, shape (p, p).
        widening: Factor from `widening`, shape (p,).
        freedom: Degrees of freedom, shape (p,).
    """

    errors: Array
    correlation: Array
    widening: Array
    freedom: Array


def spread_of(problem: Problem, part: Array) -> Spread:
    """Return the uncertainty of the parameters found at a place."""
    slopes, scores = problem.information(part)
    priors = problem.prior_slopes
    _, sizes, vt = np.linalg.svd(np.concatenate([slopes, priors]), full_matrices=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = vt.T / sizes
        errors = np.sqrt((parts**2).sum(axis=1))
        covariance = parts @ parts.T
        correlation = covariance / np.multiply.outer(errors, errors)
        from_prior = np.nan_to_num(((covariance @ priors.T) ** 2).sum(axis=1) / errors**2)
        freedom = problem.freedom(len(slopes)) / (1.0 - from_prior) ** 2
    return Spread(errors, correlation, widening(slopes, scores, neighbours_of(problem), priors), freedom)


def neighbours_of(problem: Problem) -> list[tuple[IndexArray, int]]:
    """Return, for each session, the order of neighbouring rows and the number of errors per row."""
    found = []
    for session in problem.misfit.sessions:
        size, count = 3 * len(session.description.sensors), int(session.fitting.sum())
        places = session.measured[session.fitting].reshape(count, size)
        in_time = session.times is not None
        found.append((np.arange(count) if in_time else in_short_steps(places, places[0]), size))
    return found


SURPRISE = 0.01
"""Probability that any prior is rejected although all are right."""

UNTOLD = 1e-6
"""If the rows remove a smaller part of a prior's variance, they contain no information about it."""


@dataclass(frozen=True, slots=True)
class PriorConflict:
    """A prior that the rows contradict, in the unit of its parameter.

    Attributes:
        parameter: Index of the parameter.
        name: Name of the parameter.
        mean, deviation: Mean and standard deviation of the prior.
        from_rows, error: Estimate from the rows without the prior, and its standard error.
        chance: Probability that rows are so far from a prior that is right.
    """

    parameter: int
    name: str
    mean: float
    deviation: float
    from_rows: float
    error: float
    chance: float


def conflicting_prior(problem: Problem, part: Array) -> PriorConflict | None:
    """Return the prior that the rows at a place contradict most; None: they contradict none."""
    if not len(problem.with_prior):
        return None
    (slopes, scores), priors = problem.information(part), problem.prior_slopes
    left = np.diagonal(
        priors @ np.linalg.pinv(slopes.T @ slopes + priors.T @ priors, hermitian=True) @ priors.T
    )
    row_share = np.maximum(1.0 - left, UNTOLD)
    away = problem.prior_residuals(part) / row_share
    wider = widening(slopes, scores, neighbours_of(problem))[problem.with_prior]
    errors = wider * np.sqrt(np.maximum(left, 0.0) / row_share)
    chances = 2.0 * t.sf(np.abs(away) / np.sqrt(1.0 + errors**2), problem.freedom(len(slopes)))
    worst = int(np.argmin(chances))
    if chances[worst] > SURPRISE / len(chances):
        return None
    parameter = int(problem.with_prior[worst])
    mean = float(problem.values(problem.start)[parameter])
    deviation = float(problem.span[parameter] / np.abs(priors[worst]).max())
    return PriorConflict(
        parameter,
        problem.misfit.names[parameter],
        mean,
        deviation,
        mean + deviation * float(away[worst]),
        deviation * float(errors[worst]),
        float(chances[worst]),
    )
