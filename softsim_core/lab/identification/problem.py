r"""The function that a calibration minimises: the loss of all rows' errors, weighted by noise, and priors.

With the errors e of all points, the loss :math:`\rho` and its score :math:`\psi`, see measures,

.. math:: \min_p \; \kappa \sum_i \rho(e_i) + \sum_k (p_k - p_k^0)^2 / \sigma_k^2,
    \qquad \kappa = a / b, \quad a = \overline{\partial\psi/\partial e}, \quad b = \overline{\psi^2} .

With the slopes J of the errors, the information on the parameters is :math:`J^T J / \sigma^2` with
:math:`\sigma^2 = b / a^2`. Its inverse is the sandwich covariance of a robust fit. For least squares it is
the usual covariance: a = 1 and :math:`\sigma^2` is the variance of the errors. Search, standard errors,
profiles and folds use the same noise. It is estimated from the part of the errors that no change of the
parameters can remove, so that the bias caused by a prior does not count as noise.

Sources: Huber, Ronchetti 2009, Robust statistics, 7.6 (covariance); Seber, Wild 1989, Nonlinear regression.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from softsim_core.base import Array, DataError, IndexArray, in_processes
from softsim_core.lab.identification.calibration import CalibrationDescription, ParameterDescription
from softsim_core.lab.identification.error_measures import PointLoss
from softsim_core.lab.identification.expressions import replace_expressions
from softsim_core.lab.identification.model_replay import Near, Prediction, replay
from softsim_core.lab.identification.session import Session
from softsim_core.lab.identification.validation import compare_session, session_robot
from softsim_core.scene import RobotDescription

FAR = 10.0
"""Factor of the largest previous error, assigned to values at which too many rows have no equilibrium."""

LONG = 0.5
"""Time of a replay in [s] beyond which several are shared among processes."""

LOST = 0.1
"""Part of the rows that may have no equilibrium."""

Progress: TypeAlias = Callable[[int, float, Array], None]
"""Called with the number of replays of all rows, the mean error in [m], and the values (p,)."""


class Misfit:
    """Errors in [m] of all fitted rows; stores equilibria and the best values.

    Attributes:
        parameters: The parameters in order; one with a value per session appears once per session.
        names: Names of the parameters; `NAME of SESSION` for one with a value per session.
        sessions: The rows of each session.
        count: Number of replays of all rows.
        means: Mean error of each session in [m] at the last replay.
        best: The smallest mean over sessions so far; `best_values` and `best_means` belong to it.
        latest: The last replay of each session.
    """

    def __init__(
        self,
        description: CalibrationDescription,
        model: str,
        sessions: Sequence[Session],
        every: int = 1,
        progress: Progress | None = None,
    ) -> None:
        self._description, self._model, self._progress = description, model, progress
        self._whole = list(sessions)
        self.sessions = [  # in time, all rows are needed
            each if each.times is not None else each.part(np.arange(0, len(each.table), every))
            for each in sessions
        ]
        self._acting: list[tuple[ParameterDescription, int | None]] = []
        for each in description.parameters:
            own = range(len(sessions)) if each.per_session else (None,)
            self._acting += [(each, session) for session in own]
        self.parameters = [each for each, _ in self._acting]
        self.names = tuple(
            each.name if session is None else f"{each.name} of {sessions[session].name}"
            for each, session in self._acting
        )
        self.count, self.best, self.best_values = 0, np.inf, np.zeros(len(self.names))
        self.means: dict[str, float] = {}
        self.best_means: dict[str, float] = {}
        self.latest: list[Prediction] = []
        self._near: list[Near] = [Near() for _ in sessions]
        self._last: tuple[Array, Array, dict[str, float]] | None = None
        self._largest: float | None = None
        self._seconds = 0.0
        self._last_total = np.zeros(0)

    @property
    def rows(self) -> dict[str, int]:
        """Number of fitted rows by session."""
        return {each.name: int(each.fitting.sum()) for each in self.sessions}

    def __call__(self, values: Array) -> Array:
        """Return all errors (n,) of a replay with values (p,); lost rows get the errors of the best."""
        if self._last is not None and np.array_equal(self._last[0], values):
            self.means = self._last[2]
            return self._last[1]
        near = [Near(each) for each in self._near]
        begin = time.monotonic()
        self.latest = self.replay_sessions(values, near)
        self._seconds = time.monotonic() - begin
        total = self.errors(self.latest, values)
        self._last = values.copy(), total, self.means
        self.count += 1
        mean = float(np.mean(list(self.means.values())))
        if mean < self.best:
            self.best, self.best_values, self.best_means = mean, values.copy(), dict(self.means)
            self._near, self._last_total = near, total
        if self._progress is not None:
            self._progress(self.count, mean, values)
        return total

    def replay_sessions(self, values: Array, near: Sequence[Near] | None = None) -> list[Prediction]:
        """Replay each session with values (p,); equilibria by session are added to `near`.

        Rows start from the equilibria of the best values, so that the result does not depend on previous
        attempts.

        Raises:
            KeyboardInterrupt: the replay was interrupted.
        """
        done = []
        predictions = [Near(each) for each in self._near] if near is None else near
        for k, (session, equilibria) in enumerate(zip(self.sessions, predictions, strict=True)):
            done.append(replay(self.robot(k, values), session, near=equilibria))
            if done[-1].stopped:
                raise KeyboardInterrupt
        return done

    def replay_around(self, places: Sequence[Array]) -> Iterator[list[Prediction]]:
        """Yield the replays with each of several values (p,) close to the best, in order.

        If they take long, each core replays some of them in a process of its own.

        Raises:
            KeyboardInterrupt: the replays were interrupted.
        """
        share = in_processes if self._seconds > LONG else map
        for replays in share(self._replay_close, places):
            self.count += 1
            if self._progress is not None:
                self._progress(self.count, self.best, self.best_values)
            yield replays

    def _replay_close(self, values: Array) -> list[Prediction]:
        near = [Near(each) for each in self._near]
        for each in near:
            each.checked = False
        return self.replay_sessions(values, near)

    def errors(
        self, predictions: Sequence[Prediction], values: Array, sessions: Sequence[Session] | None = None
    ) -> Array:
        """Return the errors (n,) of the fitted rows in a replay with values (p,), aligned to these rows.

        The argument `sessions` replaces the attribute: the same sessions with other fitted rows.
        """
        chosen = self.sessions if sessions is None else sessions
        errors, means = [], {}
        for session, prediction in zip(chosen, predictions, strict=True):
            result = compare_session(session, prediction)
            rows = session.fitting
            solved = rows & result.predicted
            if solved.sum() < (1.0 - LOST) * rows.sum():
                return self._penalise_session(session, int(solved.sum()), values, chosen)
            fitted = result.fitted_errors()
            means[session.name] = mean_distance(fitted[solved])
            errors.append(np.where(solved[:, None, None], fitted, np.nan)[rows].ravel())
        self.means, total = means, np.concatenate(errors)
        lost = np.isnan(total)
        total[lost] = self._last_total[lost] if len(self._last_total) == len(total) else 0.0
        self._largest = float(np.abs(total).max())
        return total

    def _penalise_session(
        self, session: Session, solved: int, values: Array, chosen: Sequence[Session]
    ) -> Array:
        """Return errors so large that the search turns back; at the first values, raise an error instead."""
        if self._largest is None:
            parameters = ", ".join(
                f"{name} {value:.4g}" for name, value in zip(self.names, values, strict=True)
            )
            raise DataError(
                f"session {session.name}",
                "",
                f"only {solved} of {session.fitting.sum()} rows have an equilibrium with {parameters}; "
                "narrow the bounds",
            )
        self.means = {each.name: np.inf for each in chosen}
        count = sum(3 * len(each.description.sensors) * int(each.fitting.sum()) for each in chosen)
        return np.full(count, FAR * self._largest)

    def follow(self, values: Array, progress: Callable[[int, int], None] | None) -> None:
        """Find the equilibria of all rows once, from neighbour to neighbour.

        A bent robot may have several equilibria for one command. Distant start points can lead to equilibria
        that the real robot did not pass through.
        """
        for k, (session, near) in enumerate(zip(self._whole, self._near, strict=True)):
            if session.times is None:
                replay(self.robot(k, values), session, progress=progress, near=near)

    def robot(self, session: int, values: Array) -> RobotDescription:
        """Return the model of a session by its index, with values (p,)."""
        acting = {
            each.name: float(value)
            for (each, of), value in zip(self._acting, values, strict=True)
            if of is None or of == session
        }
        overlay = replace_expressions(self._description.overlay, acting)
        return session_robot(self._model, self._whole[session].description, overlay)


def mean_distance(errors: Array) -> float:
    """Return the mean distance between model and measurement in [m], from errors (k, s, 3) in [m]."""
    return float(np.linalg.norm(errors, axis=-1).mean())


STEP = 0.004
"""Step of a parameter for difference quotients, as a part of its bounds."""

LEAST_NOISE = 1e-9
"""Smaller noise counts as round-off, in [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class NearbyPredictions:
    """Predictions of all sessions at a place, and with each parameter changed by a step.

    Attributes:
        part: The place in parts of the bounds, shape (p,).
        steps: Step of each parameter in parts of its bounds, shape (p,).
        here: Predictions at the place, by session.
        moved: Predictions by session, for each changed parameter.
        errors: Errors of the rows at the place in [m], shape (n,).
        slopes: Derivatives of the errors, shape (n, p).
    """

    part: Array
    steps: Array
    here: list[Prediction]
    moved: list[list[Prediction]]
    errors: Array
    slopes: Array


class Problem:
    """The minimised problem in parts of the bounds: losses of the rows over their noise, then priors.

    Attributes:
        misfit: Errors of the rows.
        loss: Loss of the errors.
        low: Lower bounds, shape (p,).
        span: Widths of the bounds, shape (p,).
        start: Start of the search in parts of the bounds, shape (p,).
        noise: Standard deviation in [m] of a least-squares error with the same information as one row.
        with_prior: Indices of the parameters with an active prior.
        around: Predictions at the last place with slopes.
    """

    def __init__(self, misfit: Misfit, loss: PointLoss) -> None:
        parameters = misfit.parameters
        self.misfit, self.loss = misfit, loss
        self.low = np.array([each.lower for each in parameters])
        self.span = np.array([each.span for each in parameters])
        self.start = (np.array([each.start for each in parameters]) - self.low) / self.span
        self._priors = (
            np.array([np.inf if each.prior is None else each.prior for each in parameters]) / self.span
        )
        self.with_prior: IndexArray = np.flatnonzero(np.isfinite(self._priors))
        self.noise, self._root = loss.scale, 1.0 / loss.scale
        self.around: NearbyPredictions | None = None

    def values(self, part: Array) -> Array:
        """Return the parameters (p,) at a place in parts of their bounds."""
        return np.asarray(self.low + self.span * part)

    def prior_residuals(self, part: Array) -> Array:
        """Return the deviations from the priors' means over their standard deviations."""
        return np.asarray(((part - self.start) / self._priors)[self.with_prior])

    @property
    def prior_slopes(self) -> Array:
        """Derivatives of `prior_residuals`, one row each."""
        return np.asarray((np.eye(len(self.span)) / self._priors[:, None])[self.with_prior])

    def leave_out_prior(self, parameter: int) -> None:
        """Deactivate the prior of a parameter by its index."""
        self.with_prior = self.with_prior[self.with_prior != parameter]

    def residuals(self, part: Array) -> Array:
        """Return the residuals of a replay, shape (n,); the sum of their squares is minimised."""
        return self._join_residuals(self.misfit(self.values(part)), part)

    def _join_residuals(self, errors: Array, part: Array) -> Array:
        return np.concatenate([self._root * self.loss.residuals(errors), self.prior_residuals(part)])

    def slopes(self, part: Array) -> Array:
        """Return the derivatives of the residuals by difference quotients, shape (n, p)."""
        around = self.look_around(part)
        return self._joined_slopes(around.errors, around.slopes)

    def _joined_slopes(self, errors: Array, slopes: Array) -> Array:
        return np.concatenate([self._root * self.loss.slopes(errors, slopes), self.prior_slopes])

    def look_around(self, part: Array) -> NearbyPredictions:
        """Replay at a place and with each parameter changed; the last result is stored."""
        if self.around is None or not np.array_equal(self.around.part, part):
            steps = np.where(part + STEP <= 1.0, STEP, -STEP)
            errors = self.misfit(self.values(part))
            here, moved, changes = self.misfit.latest, [], []
            places = [self.values(part + each) for each in np.diag(steps)]
            for values, replays in zip(places, self.misfit.replay_around(places), strict=True):
                changes.append(self.misfit.errors(replays, values) - errors)
                moved.append(replays)
            slopes = np.asarray(np.array(changes).T / steps)
            self.around = NearbyPredictions(part.copy(), steps, here, moved, errors, slopes)
        return self.around

    def again(self, around: NearbyPredictions, sessions: Sequence[Session]) -> tuple[Array, Array]:
        """Return residuals (n,) and slopes (n, p) of existing replays with other fitted rows."""
        errors = self.misfit.errors(around.here, self.values(around.part), sessions)
        places = around.part + np.diag(around.steps)
        moved = [
            self.misfit.errors(each, self.values(place), sessions)
            for each, place in zip(around.moved, places, strict=True)
        ]
        slopes = np.asarray((np.array(moved) - errors).T / around.steps)
        return self._join_residuals(errors, around.part), self._joined_slopes(errors, slopes)

    def estimate_noise(self, part: Array) -> None:
        """Set the noise from the errors at a place."""
        left = self._compute_unexplained_errors(self.look_around(part))
        flat = self.loss.curvature(left)
        variance = float((self.loss.scores(left) ** 2).sum()) / self.freedom(len(left))
        self.noise = max(float(np.sqrt(variance)) / flat, LEAST_NOISE)
        self._root = 1.0 / (self.noise * np.sqrt(flat))

    def _compute_unexplained_errors(self, around: NearbyPredictions) -> Array:
        """Return the errors (n,) in [m] at a place without the part that other parameters would remove."""
        residuals, slopes = self.loss.residuals(around.errors), self.loss.slopes(around.errors, around.slopes)
        return np.asarray(around.errors - around.slopes @ np.linalg.lstsq(slopes, residuals, rcond=None)[0])

    def information(self, part: Array) -> tuple[Array, Array]:
        """Return slopes (n, p) and scores (n,) of the rows at a place, both over their noise."""
        around = self.look_around(part)
        scores = self.loss.scores(self._compute_unexplained_errors(around)) * (self._root**2 * self.noise)
        return around.slopes / self.noise, np.asarray(scores)

    def freedom(self, count: int) -> int:
        """Return the degrees of freedom of `count` errors, at least 1.

        The fitted numbers to subtract are parameters, frames, sensor points and delays.
        """
        aligned = sum(each.description.fitted_numbers for each in self.misfit.sessions)
        return max(count - len(self.span) - aligned, 1)
