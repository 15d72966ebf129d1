"""Confidence in a calibration: cross-validation, profile likelihood and parameter distributions.

Rows are divided into folds. The parameters are fitted to all but one fold, by one Gauss-Newton step from the
parameters of all rows with the slopes there, and the errors of the omitted fold are evaluated. The profile of
a parameter is the least sum of squares with this parameter fixed at a value, with the noise of the whole fit.
Its 95 % interval ends where the sum has grown by the square of the interval's half width in standard errors.

Sources: Stone 1974, Cross-validatory choice; Venzon, Moolgavkar 1988, Profile-likelihood-based intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.base import Array, ConfigError, DataError, FieldError
from softsim_core.lab.identification.expressions import replace_expressions
from softsim_core.lab.identification.fitting import Calibration
from softsim_core.lab.identification.model_replay import Progress
from softsim_core.lab.identification.problem import mean_distance
from softsim_core.lab.identification.session import Session
from softsim_core.lab.identification.validation import compare_session
from softsim_core.scene.io import read_extended, structure_description


@dataclass(frozen=True, slots=True, kw_only=True)
class DistributionDescription:
    """A normal distribution of parameters, truncated at their bounds.

    Attributes:
        name: Name in messages.
        robot: The model it belongs to: a name, or a file relative to this one.
        names: Names of the parameters.
        units: Their units, for display.
        mean: Their means.
        covariance: Their covariance, row by row.
        lower, upper: Their bounds.
        overlay: Overrides of the robot's file, with expressions of the parameters.
    """

    name: str
    robot: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    overlay: dict[str, Any]

    def __post_init__(self) -> None:
        count, owner = len(self.names), f"distribution {self.name}"
        for field in ("mean", "lower", "upper", "covariance", "units"):
            if len(getattr(self, field)) != count:
                raise FieldError(owner, field, f"{len(getattr(self, field))} values", f"{count}, as names")
        matrix = np.array(self.covariance)
        if matrix.shape != (count, count) or not np.isfinite(matrix).all():
            raise FieldError(owner, "covariance", f"shape {matrix.shape}", f"{count} rows of {count} numbers")
        scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
        if np.linalg.eigvalsh(matrix / np.multiply.outer(scale, scale)).min() < -1e-8:
            raise FieldError(owner, "covariance", "of some direction is negative", "that of real numbers")
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise FieldError(owner, "lower", str(self.lower), "less than upper")

    def draw(self, count: int, seed: int = 0) -> Array:
        """Draw parameters within the bounds, shape (count, p)."""
        generator, size = np.random.default_rng(seed), len(self.names)
        low, high = np.array(self.lower), np.array(self.upper)
        values = np.zeros((0, size))
        sizes, axes = np.linalg.eigh(np.array(self.covariance))
        root = axes * np.sqrt(np.maximum(sizes, 0.0))  # also of a singular covariance
        for _ in range(1000):
            drawn = np.array(self.mean) + generator.standard_normal((count, size)) @ root.T
            inside = ((drawn >= low) & (drawn <= high)).all(axis=1)
            values = np.concatenate([values, drawn[inside]])
            if len(values) >= count:
                return values[:count]
        raise FieldError(
            f"distribution {self.name}", "mean", str(self.mean), "one from which the bounds are reached"
        )

    def fill_overlay(self, values: Sequence[float]) -> dict[str, Any]:
        """Return the overlay of the robot for drawn values (p,)."""
        by_name = dict(zip(self.names, (float(each) for each in values), strict=True))
        overlay = replace_expressions(self.overlay, by_name)
        assert isinstance(overlay, dict)
        return overlay


def distribution_of(result: Calibration, robot: str) -> DistributionDescription:
    """Return the normal distribution of a calibration; undetermined directions are as wide as the bounds.

    For a parameter with a value per session, the distribution describes a new session: about the mean of the
    n sessions with their variance :math:`s^2`, which has n - 1 degrees of freedom, times :math:`1 + 1/n`. The
    errors of the sessions' own values are included in :math:`s^2`; if these values happen to agree, their
    errors are used instead. The calibration must not have been interrupted; its overlay modifies `robot`.
    """
    problem, parameters = result.problem, result.description.parameters
    errors = np.minimum(result.widening * result.errors, problem.span / np.sqrt(12.0))
    correlation = np.where(np.isfinite(result.correlation), result.correlation, 0.0)
    np.fill_diagonal(correlation, 1.0)
    covariance = correlation * np.multiply.outer(errors, errors)
    of = [name.partition(" ")[0] for name in result.names]
    chosen = np.array([[name == each.name for name in of] for each in parameters], dtype=float)
    counts = chosen.sum(axis=1)
    chosen /= counts[:, None]
    mean = chosen @ result.values
    between = (chosen @ result.values**2 - mean**2) * counts / np.maximum(counts - 1.0, 1.0)
    shared = chosen @ covariance @ chosen.T
    within = chosen @ np.diagonal(covariance)
    new = np.maximum(between, within) * (1.0 + 1.0 / counts)
    np.fill_diagonal(shared, np.where(counts > 1.0, new, np.diagonal(shared)))
    sizes, axes = np.linalg.eigh(shared)
    shared = (axes * np.maximum(sizes, 0.0)) @ axes.T
    return DistributionDescription(
        name=result.description.name,
        robot=robot,
        names=tuple(each.name for each in parameters),
        units=tuple(each.unit for each in parameters),
        mean=tuple(mean.tolist()),
        covariance=tuple(tuple(row) for row in shared.tolist()),
        lower=tuple(each.lower for each in parameters),
        upper=tuple(each.upper for each in parameters),
        overlay=result.description.overlay,
    )


def load_distribution(file: str | Path) -> DistributionDescription:
    """Load a distribution from its file.

    Raises:
        ConfigError: the file does not exist, or any problem in it, as one message.
    """
    path = Path(file).expanduser().absolute()
    if not path.is_file():
        raise ConfigError(str(file), "", "no such file")
    return structure_description(read_extended(path), DistributionDescription, path, find_files=False)


ROUNDS: Final = 4
"""Number of values that are tried for one end of an interval."""

CLOSE: Final = 0.05
"""Tolerance of an interval's end, as a part of the required growth."""


@dataclass(frozen=True, slots=True)
class Folds:
    """Mean errors in [m] by session, of fitted rows and of rows that were left out."""

    count: int
    fitted: dict[str, float]
    left_out: dict[str, float]

    @property
    def ratio(self) -> float:
        """Ratio of the errors of left-out rows to those of fitted rows, over all sessions."""
        return float(np.mean(list(self.left_out.values())) / np.mean(list(self.fitted.values())))


def cross_validated(result: Calibration, count: int = 5, done: Progress | None = None) -> Folds:
    """Cross-validate a calibration: return the errors of rows that were not fitted.

    Args:
        result: The calibration, not interrupted.
        count: Number of folds; sessions in time are divided into as many spans.
        done: Called with the number of finished folds.

    Raises:
        DataError: a session has too few rows.
    """
    problem = result.problem
    best = (result.values - problem.low) / problem.span
    around = problem.look_around(best)
    generator, sessions = np.random.default_rng(0), problem.misfit.sessions
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
        predictions = problem.misfit.replay_sessions(problem.values(part))
        for session, whole, of, prediction in zip(training, sessions, fold_of, predictions, strict=True):
            compare = compare_session(session, prediction)
            errors, solved = compare.fitted_errors(), compare.predicted
            fitted[session.name].append(mean_distance(errors[session.fitting & solved]))
            left_out[session.name].append(mean_distance(errors[whole.fitting & (of == fold) & solved]))
        if done is not None:
            done(fold + 1, count)
    means = [{name: float(np.mean(each)) for name, each in parts.items()} for parts in (fitted, left_out)]
    return Folds(count, *means)


def _dealt(session: Session, count: int, generator: np.random.Generator) -> Array:
    """Return the fold of each fitted row, shape (k,); -1 for the other rows."""
    rows = np.flatnonzero(session.fitting)
    if len(rows) < 2 * count:
        raise DataError(f"session {session.name}", "", f"{len(rows)} rows are too few for {count} folds")
    folds = np.full(len(session.table), -1)
    even = np.arange(len(rows)) * count // len(rows)
    folds[rows] = even if session.times is not None else generator.permutation(even)
    return folds


def profiled(result: Calibration, parameter: int) -> tuple[float, float]:
    """Return the 95 % interval of a parameter by profile likelihood; an end at or beyond a bound is infinite.

    The parameter is an index. The calibration must not have been interrupted.
    """
    problem = result.problem
    best = (result.values - problem.low) / problem.span
    slopes, left = problem.slopes(best), problem.residuals(best)
    least = float(left @ left)
    allowed = float(result.quantiles[parameter] * result.widening[parameter]) ** 2
    others = np.arange(len(best)) != parameter
    along = np.zeros_like(best)  # first-order change of the other parameters
    along[parameter] = 1.0
    inverse = np.linalg.pinv(slopes[:, others])
    along[others] = -inverse @ slopes[:, parameter]
    first = float(np.sqrt(allowed)) / max(float(np.linalg.norm(slopes @ along)), 1e-12)

    def find_end(sign: float) -> float:
        """Return the change at which the least sum of squares has grown as allowed; infinite if none is."""
        away = first
        most = (1.0 - best[parameter]) if sign > 0.0 else best[parameter]
        for _ in range(ROUNDS):
            if away >= most:
                return np.inf
            part = np.clip(best + away * sign * along, 0.0, 1.0)
            residuals = problem.residuals(part)
            part[others] = np.clip(part[others] - inverse @ residuals, 0.0, 1.0)
            better = problem.residuals(part)
            growth = max(min(float(better @ better), float(residuals @ residuals)) - least, 1e-12 * allowed)
            if abs(growth - allowed) < CLOSE * allowed:
                break
            away *= float(np.clip(np.sqrt(allowed / growth), 0.3, 3.0))
        return away

    value, span = float(result.values[parameter]), float(problem.span[parameter])
    return value - span * find_end(-1.0), value + span * find_end(1.0)
