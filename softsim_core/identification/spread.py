r"""How well the parameters found are known: standard errors, correlations, degrees of freedom.

With slopes J of the rows over their noise and the precision P of priors, the covariance is
:math:`(J^T J + P)^{-1}`. The part of a variance that comes from the rows has the uncertainty of the noise,
with :math:`\nu` degrees of freedom; the part of priors is known.

Source: Satterthwaite 1946 (degrees of freedom of a sum of variances).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.identification.alike import widening
from softsim_core.identification.problem import Problem
from softsim_core.identification.replay import in_short_steps
from softsim_core.identification.session import Session


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """How well p parameters are known, in parts of their bounds.

    Attributes:
        errors: Standard errors, as if the errors of rows were independent, shape (p,).
        correlation: Shape (p, p).
        widening: See `alike`, shape (p,).
        freedom: Degrees of freedom, shape (p,).
    """

    errors: Array
    correlation: Array
    widening: Array
    freedom: Array

    @classmethod
    def unknown(cls, count: int) -> Spread:
        """That of a search which was interrupted."""
        unlimited = np.full(count, np.inf)
        return cls(unlimited, np.full((count, count), np.nan), np.ones(count), unlimited)


def spread_of(problem: Problem, part: Array) -> Spread:
    """How well the parameters found at a place are known."""
    slopes, scores = problem.information(part)
    priors = problem.prior_slopes
    _, sizes, vt = np.linalg.svd(np.concatenate([slopes, priors]), full_matrices=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = vt.T / sizes
        errors = np.sqrt((parts**2).sum(axis=1))
        covariance = parts @ parts.T
        correlation = covariance / np.multiply.outer(errors, errors)
        known = np.nan_to_num(((covariance @ priors.T) ** 2).sum(axis=1) / errors**2)
        freedom = problem.freedom(len(slopes)) / (1.0 - known) ** 2
    return Spread(errors, correlation, widening(slopes, scores, neighbours_of(problem), priors), freedom)


def neighbours_of(problem: Problem) -> list[tuple[IndexArray, int]]:
    """Of each session, the order in which neighbouring rows follow each other, and the errors of a row."""
    return [_in_order(each) for each in problem.misfit.sessions]


def _in_order(session: Session) -> tuple[IndexArray, int]:
    size, count = 3 * len(session.description.sensors), int(session.fitting.sum())
    if session.times is not None:
        return np.arange(count), size
    places = session.measured[session.fitting].reshape(count, size)
    return in_short_steps(places, places[0]), size
