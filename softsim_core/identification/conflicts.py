r"""Priors that measurements contradict.

Rows that tell of a parameter :math:`\hat p \pm s` and a prior :math:`p^0 \pm \sigma` agree where
:math:`z = (\hat p - p^0) / \sqrt{s^2 + \sigma^2}` is one of Student's distribution. Both are got from the fit
with the prior: with h, the part of the prior's variance that is left in the fit, and r, its residual,
:math:`\hat p - p^0 = \sigma r / (1 - h)` and :math:`s^2 = \sigma^2 h / (1 - h)`, to first order.

Source: Evans, Moshonov 2006, Checking for prior-data conflict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from softsim_core.arrays import Array
from softsim_core.identification.alike import widening
from softsim_core.identification.problem import Problem
from softsim_core.identification.spread import neighbours_of

CHANCE = 0.01
"""How often one of the priors is taken for wrong though all are right."""

UNTOLD = 1e-6
"""Rows that take away a smaller part of a prior's variance tell nothing beside it."""


@dataclass(frozen=True, slots=True)
class PriorConflict:
    """A prior that the rows contradict, in the unit of its parameter.

    Attributes:
        parameter: Number of the parameter.
        name: Of this.
        mean, deviation: What the prior says.
        told, error: What the rows tell without it, and its standard error.
        chance: How often rows would be so far from a prior that is right.
    """

    parameter: int
    name: str
    mean: float
    deviation: float
    told: float
    error: float
    chance: float


def conflicting_prior(problem: Problem, part: Array) -> PriorConflict | None:
    """The prior that the rows at the place found contradict most; None: they contradict none."""
    if not len(problem.known):
        return None
    (slopes, scores), priors = problem.information(part), problem.prior_slopes
    left = np.diagonal(
        priors @ np.linalg.pinv(slopes.T @ slopes + priors.T @ priors, hermitian=True) @ priors.T
    )
    told = np.maximum(1.0 - left, UNTOLD)
    away = problem.prior_residuals(part) / told
    wider = widening(slopes, scores, neighbours_of(problem))[problem.known]
    errors = wider * np.sqrt(np.maximum(left, 0.0) / told)
    chances = 2.0 * t.sf(np.abs(away) / np.sqrt(1.0 + errors**2), problem.freedom(len(slopes)))
    worst = int(np.argmin(chances))
    if chances[worst] > CHANCE / len(chances):
        return None
    parameter = int(problem.known[worst])
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
