r"""What a calibration minimises: the loss of the rows, weighted by their noise, and what is known beforehand.

With the errors e of all points, the loss :math:`\rho` and its score :math:`\psi`, see `loss`,

.. math:: \min_p \; \kappa \sum_i \rho(e_i) + \sum_k (p_k - p_k^0)^2 / \sigma_k^2,
    \qquad \kappa = a / b, \quad a = \overline{\partial\psi/\partial e}, \quad b = \overline{\psi^2} .

The slopes J of the errors tell :math:`J^T J / \sigma^2` of the parameters, with :math:`\sigma^2 = b / a^2`:
the inverse is the sandwich covariance of a robust fit, and of least squares the usual one, where a = 1 and
:math:`\sigma^2` is the variance of the errors. One noise serves the search, the standard errors, profiles
and folds. It is estimated from the part of the errors that no change of the parameters takes away, so that a
prior that pulls them aside does not count as noise.

Sources: Huber, Ronchetti 2009, Robust statistics, 7.6 (covariance); Seber, Wild 1989, Nonlinear regression.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.identification.loss import PointLoss
from softsim_core.identification.misfit import Misfit
from softsim_core.identification.replay import Prediction
from softsim_core.identification.session import Session

STEP = 0.004
"""Part of its bounds by which a parameter is moved to see what changes."""

LEAST_NOISE = 1e-9
"""Smaller noise is taken for round-off, in [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Around:
    """Predictions of all sessions at a place, and with each parameter moved by a step.

    Attributes:
        part: The place, in parts of the bounds, shape (p,).
        steps: Of each parameter, in parts of its bounds, shape (p,).
        here: Of the sessions.
        moved: Of the sessions, for each parameter.
        errors: Of the rows at the place in [m], shape (n,).
        slopes: Derivatives of these, shape (n, p).
    """

    part: Array
    steps: Array
    here: list[Prediction]
    moved: list[list[Prediction]]
    errors: Array
    slopes: Array


class Problem:
    """What is minimised, in parts of the bounds: losses of the rows over their noise, then priors.

    Attributes:
        misfit: Errors of the rows.
        loss: Of these.
        low: Lower bounds, shape (p,).
        span: Between the bounds, shape (p,).
        start: Where the search begins, in parts of the bounds, shape (p,).
        noise: Standard deviation of an error of least squares that tells as much as one of the rows, in [m].
        known: Parameters with a prior that counts.
        around: Where slopes were taken last.
    """

    def __init__(self, misfit: Misfit, loss: PointLoss) -> None:
        wanted = misfit.parameters
        self.misfit, self.loss = misfit, loss
        self.low = np.array([each.lower for each in wanted])
        self.span = np.array([each.span for each in wanted])
        self.start = (np.array([each.start for each in wanted]) - self.low) / self.span
        self._priors = np.array([np.inf if each.prior is None else each.prior for each in wanted]) / self.span
        self.known: IndexArray = np.flatnonzero(np.isfinite(self._priors))
        self.noise, self._root = loss.scale, 1.0 / loss.scale
        self.around: Around | None = None

    def values(self, part: Array) -> Array:
        """Parameters (p,) at a place in parts of their bounds."""
        return np.asarray(self.low + self.span * part)

    def prior_residuals(self, part: Array) -> Array:
        """Distances from what is known beforehand, over its standard deviation."""
        return np.asarray(((part - self.start) / self._priors)[self.known])

    @property
    def prior_slopes(self) -> Array:
        """Derivatives of `prior_residuals`, a row for each."""
        return np.asarray((np.eye(len(self.span)) / self._priors[:, None])[self.known])

    def leave_out_prior(self, parameter: int) -> None:
        """Take no notice of what is known beforehand of a parameter by its number."""
        self.known = self.known[self.known != parameter]

    def residuals(self, part: Array) -> Array:
        """Of a replay, shape (n,); the sum of their squares is what is minimised."""
        return self._joined(self.misfit(self.values(part)), part)

    def _joined(self, errors: Array, part: Array) -> Array:
        return np.concatenate([self._root * self.loss.residuals(errors), self.prior_residuals(part)])

    def slopes(self, part: Array) -> Array:
        """Derivatives of the residuals by differences, shape (n, p)."""
        around = self.look_around(part)
        return self._joined_slopes(around.errors, around.slopes)

    def _joined_slopes(self, errors: Array, slopes: Array) -> Array:
        return np.concatenate([self._root * self.loss.slopes(errors, slopes), self.prior_slopes])

    def look_around(self, part: Array) -> Around:
        """Replays at a place, and with each parameter moved; remembers the last."""
        if self.around is None or not np.array_equal(self.around.part, part):
            steps = np.where(part + STEP <= 1.0, STEP, -STEP)
            errors = self.misfit(self.values(part))
            here, moved, changes = self.misfit.latest, [], []
            for each in np.diag(steps):
                changes.append(self.misfit(self.values(part + each)) - errors)
                moved.append(self.misfit.latest)
            slopes = np.asarray(np.array(changes).T / steps)
            self.around = Around(part.copy(), steps, here, moved, errors, slopes)
        return self.around

    def again(self, around: Around, sessions: Sequence[Session]) -> tuple[Array, Array]:
        """Residuals (n,) and slopes (n, p) of replays that have been made, with other rows that fit."""
        errors = self.misfit.errors(around.here, self.values(around.part), sessions)
        places = around.part + np.diag(around.steps)
        moved = [
            self.misfit.errors(each, self.values(place), sessions)
            for each, place in zip(around.moved, places, strict=True)
        ]
        slopes = np.asarray((np.array(moved) - errors).T / around.steps)
        return self._joined(errors, around.part), self._joined_slopes(errors, slopes)

    def estimate_noise(self, part: Array) -> None:
        """Set the noise from the errors at a place."""
        left = self._unexplained(self.look_around(part))
        flat = self.loss.curvature(left)
        variance = float((self.loss.scores(left) ** 2).sum()) / self.freedom(len(left))
        self.noise = max(float(np.sqrt(variance)) / flat, LEAST_NOISE)
        self._root = 1.0 / (self.noise * np.sqrt(flat))

    def _unexplained(self, around: Around) -> Array:
        """The errors at a place (n,) in [m], without what other parameters would take away."""
        residuals, slopes = self.loss.residuals(around.errors), self.loss.slopes(around.errors, around.slopes)
        return np.asarray(around.errors - around.slopes @ np.linalg.lstsq(slopes, residuals, rcond=None)[0])

    def information(self, part: Array) -> tuple[Array, Array]:
        """What the rows at a place tell: slopes (n, p), and the scores of their noise (n,), both over it."""
        around = self.look_around(part)
        scores = self.loss.scores(self._unexplained(around)) * (self._root**2 * self.noise)
        return around.slopes / self.noise, np.asarray(scores)

    def freedom(self, count: int) -> int:
        """Errors of rows, of which there are so many, beyond what is fitted to them, at least 1.

        These are the parameters, frames, sensor points and delays.
        """
        aligned = sum(each.description.fitted_numbers for each in self.misfit.sessions)
        return max(count - len(self.span) - aligned, 1)
