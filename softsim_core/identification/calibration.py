r"""Parameters of a model found from measurements, and what the measurements do not tell.

With the errors e(p) of all training rows, each session aligned as it is described for each p anew,

.. math:: \min_p \sum_i \rho(|e_i|^2 / s^2) + \sum_k (p_k - p_k^0)^2 / \sigma_k^2

within bounds; priors only where they are given. From the slopes J of the errors at the end follow standard
errors and correlations, as if errors were independent of each other. A parameter whose 95 % interval is wider
than its bounds has not been found, whatever number stands there.

Source: Seber, Wild 1989, Nonlinear regression (intervals from linearisation).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from softsim_core.arrays import Array, BoolArray
from softsim_core.errors import ConfigError, DataError, SceneError, listing
from softsim_core.identification.expressions import filled, names_in
from softsim_core.identification.files import DataSet, known_data_sets, load_data_set
from softsim_core.identification.replay import Near, replay
from softsim_core.identification.session import Session, load_session
from softsim_core.identification.validation import compared, session_robot
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.structure import structured
from softsim_core.scene.yaml_source import read_extended
from softsim_core.values import FieldError, need_finite, need_positive

Loss: TypeAlias = Literal["linear", "soft_l1"]

QUANTILE = 1.96
"""Standard errors in half of a 95 % interval."""

STEP = 0.004
"""Part of its bounds by which a parameter is moved to see what changes."""

ENOUGH = 1e-3
"""Part of their bounds, and of the sum of squares, by which the last round changes the parameters at most."""

FILE = "calibration.yaml"

FAR = 10.0
"""Errors of values with which too many rows are lost, over the largest of those before."""

LOST = 0.1
"""Part of the rows that may have no equilibrium."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterDescription:
    """A number that is sought.

    Attributes:
        name: By which expressions name it.
        start: Where the search begins.
        lower, upper: Its bounds.
        unit: Of all these, for people.
        prior: Standard deviation of what is known of it beforehand, around `start`; None: nothing is.
    """

    name: str
    start: float
    lower: float
    upper: float
    unit: str = ""
    prior: float | None = None

    def __post_init__(self) -> None:
        owner = f"parameter {self.name}"
        if not self.name.isidentifier():
            raise FieldError(owner, "name", repr(self.name), "a word of letters, digits and _")
        need_finite(owner, "bounds and start", (self.lower, self.start, self.upper))
        if not self.lower < self.upper:
            raise FieldError(owner, "lower", self.lower, f"less than upper, {self.upper:g}")
        if not self.lower <= self.start <= self.upper:
            raise FieldError(owner, "start", self.start, f"between {self.lower:g} and {self.upper:g}")
        if self.prior is not None:
            need_positive(owner, "prior", self.prior, self.unit)

    @property
    def span(self) -> float:
        """Between its bounds."""
        return self.upper - self.lower


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationDescription:
    """What is fitted to which measurements.

    Attributes:
        name: What messages call it.
        data_set: The measurements: a name, or a folder relative to the description.
        parameters: What is sought.
        overlay: Laid over the robot; where a parameter acts stands an expression, see expressions.
        robot: The model: a name or a file; None: that of the data set.
        sessions: Names of the sessions that are used; none: all that can be replayed.
        every: Of the training rows of each session only each N-th is used.
        loss: "linear" is least squares; "soft_l1" takes less notice of outliers.
        scale_mm: s, from which error on one is an outlier, in [mm].
    """

    name: str
    data_set: str
    parameters: tuple[ParameterDescription, ...]
    overlay: dict[str, Any]
    robot: str | None = None
    sessions: tuple[str, ...] = ()
    every: int = 1
    loss: Loss = "linear"
    scale_mm: float = 1.0

    def __post_init__(self) -> None:
        owner, names = f"calibration {self.name}", [each.name for each in self.parameters]
        if not names or len(set(names)) != len(names):
            raise SceneError(f"{owner}: give one parameter or more, each with its own name")
        used = names_in(self.overlay)
        for name in used - set(names):
            raise SceneError(f"{owner}: the overlay names {name!r}; the parameters are {listing(names)}")
        for name in names:
            if name not in used:
                raise SceneError(f"{owner}: parameter {name} stands nowhere in the overlay; use or remove it")
        if self.loss not in get_args(Loss):
            raise FieldError(owner, "loss", repr(self.loss), f"one of {', '.join(get_args(Loss))}")
        need_positive(owner, "scale_mm", self.scale_mm, "mm")
        if self.every < 1:
            raise FieldError(owner, "every", self.every, ">= 1")


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What was found.

    Attributes:
        description: What was sought.
        values: Of the parameters, shape (p,).
        errors: Their standard errors, infinite where the rows tell nothing, shape (p,).
        correlation: Of these, shape (p, p).
        before, after: Mean error of the rows in [m] with the start values and with those found, by session.
        rows: How many rows each session gave.
        evaluations: How often all rows were replayed.
        stopped: Whether it was interrupted; then the errors are those of the best that was tried, and
            `errors` infinite.
    """

    description: CalibrationDescription
    values: Array
    errors: Array
    correlation: Array
    before: dict[str, float]
    after: dict[str, float]
    rows: dict[str, int]
    evaluations: int
    stopped: bool = False

    @property
    def found(self) -> BoolArray:
        """Which parameters the rows tell: whose 95 % interval is narrower than their bounds, shape (p,)."""
        spans = np.array([each.span for each in self.description.parameters])
        return np.asarray(2.0 * QUANTILE * self.errors < spans)

    @property
    def at_bounds(self) -> BoolArray:
        """Which of them ended at a bound, shape (p,)."""
        low = np.array([each.lower for each in self.description.parameters])
        spans = np.array([each.span for each in self.description.parameters])
        part = (self.values - low) / spans
        return np.asarray((part < 1e-3) | (part > 1.0 - 1e-3))

    @property
    def overlay(self) -> dict[str, Any]:
        """What lays the values over the robot."""
        names = [each.name for each in self.description.parameters]
        overlay = filled(self.description.overlay, dict(zip(names, self.values.tolist(), strict=True)))
        assert isinstance(overlay, dict)
        return overlay


Progress: TypeAlias = Callable[[int, float, Array], None]
"""Told how often all rows were replayed, the mean error in [m], and the values (p,)."""


class _Errors:
    """Errors of all training rows in [m] as a function of the parameters; remembers the best."""

    def __init__(
        self,
        description: CalibrationDescription,
        model: str,
        sessions: Sequence[Session],
        progress: Progress | None,
    ) -> None:
        self._description, self._model, self._sessions = description, model, sessions
        self._names = [each.name for each in description.parameters]
        self._progress = progress
        self.count, self.best, self.best_values = 0, np.inf, np.zeros(len(self._names))
        self._near: list[Near] = [{} for _ in sessions]
        self._last: tuple[Array, Array, dict[str, float]] | None = None
        self.means: dict[str, float] = {}
        self.best_means: dict[str, float] = {}

    def __call__(self, values: Array) -> Array:
        """All errors, shape (n,); zero in rows that have no equilibrium."""
        if self._last is not None and np.array_equal(self._last[0], values):
            self.means = self._last[2]
            return self._last[1]
        errors, self.means = [], {}
        for session, near in zip(self._sessions, self._near, strict=True):
            result = compared(session, replay(self._robot(session, values), session, near=near))
            if result.stopped:
                raise KeyboardInterrupt
            rows = session.fitting
            known = rows & result.known
            if known.sum() < (1.0 - LOST) * rows.sum():
                if self._last is not None:  # too far: the search comes back
                    return np.full_like(self._last[1], FAR * np.abs(self._last[1]).max())
                raise DataError(
                    f"session {session.name}",
                    "",
                    f"only {known.sum()} of {rows.sum()} rows have an equilibrium with {self._told(values)}; "
                    "narrow the bounds",
                )
            of_rows = np.where(known[:, None, None], result.aligned, 0.0)[rows]
            self.means[session.name] = float(np.linalg.norm(result.aligned[known], axis=-1).mean())
            errors.append(of_rows.ravel())
        total = np.concatenate(errors)
        self._last = values.copy(), total, self.means
        self.count += 1
        mean = float(np.mean(list(self.means.values())))
        if mean < self.best:
            self.best, self.best_values, self.best_means = mean, values.copy(), dict(self.means)
        if self._progress is not None:
            self._progress(self.count, mean, values)
        return total

    def follow(
        self, sessions: Sequence[Session], values: Array, told: Callable[[int, int], None] | None
    ) -> None:
        """Find the equilibria of all rows of sessions once, from neighbour to neighbour.

        A bent robot may have several for one command, and rows far apart lead to others than it went through.
        """
        for session, near in zip(sessions, self._near, strict=True):
            if session.times is None:
                replay(self._robot(session, values), session, progress=told, near=near)

    def _robot(self, session: Session, values: Array) -> RobotDescription:
        pairs = dict(zip(self._names, values.tolist(), strict=True))
        return session_robot(self._model, session.description, filled(self._description.overlay, pairs))

    def _told(self, values: Array) -> str:
        return ", ".join(
            f"{name} {value:.4g}" for name, value in zip(self._names, values.tolist(), strict=True)
        )


def calibrate(
    description: CalibrationDescription,
    data: DataSet,
    every: int | None = None,
    progress: Progress | None = None,
    following: Callable[[int, int], None] | None = None,
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
    from scipy.optimize import least_squares  # late: the rest of the package starts without it

    whole = _sessions(description, data)
    sessions = [_each(session, every or description.every) for session in whole]
    errors = _Errors(description, description.robot or data.robot, sessions, progress)
    wanted = description.parameters
    low, span = np.array([each.lower for each in wanted]), np.array([each.span for each in wanted])
    start = np.array([each.start for each in wanted])
    priors = np.array([np.inf if each.prior is None else each.prior for each in wanted])
    scale = 1e-3 * description.scale_mm
    known = np.isfinite(priors)

    def residuals(part: Array) -> Array:
        values = low + span * part
        beside = (values - start)[known] / priors[known]
        return np.concatenate([errors(values) / scale, beside])

    latest: list[tuple[Array, Array]] = []

    def slopes(part: Array) -> Array:
        if latest and np.array_equal(latest[0][0], part):
            return latest[0][1]
        here = residuals(part)
        steps = np.where(part + STEP <= 1.0, STEP, -STEP)
        ways = zip(steps, np.eye(len(part)), strict=True)
        result = np.stack([(residuals(part + step * unit) - here) / step for step, unit in ways], axis=1)
        latest[:] = [(part.copy(), result)]
        return result

    begin = np.clip((start - low) / span, 1e-6, 1.0 - 1e-6)
    errors.follow(whole, start, following)
    errors(start)
    before, rows = dict(errors.means), {each.name: int(each.fitting.sum()) for each in sessions}
    stopped, unknown = False, np.full((len(wanted),) * 2, np.nan)
    try:
        found = least_squares(
            residuals, begin, slopes, (np.zeros(len(wanted)), np.ones(len(wanted))), loss=description.loss,
            xtol=ENOUGH, ftol=ENOUGH, x_scale=1.0,
        )  # fmt: skip
        values, slope = low + span * found.x, slopes(found.x)
    except KeyboardInterrupt:
        stopped, values, slope = True, errors.best_values, unknown
    if stopped:
        infinite = np.full(len(wanted), np.inf)
        return Calibration(
            description, values, infinite, unknown, before, errors.best_means, rows, errors.count, True
        )
    left = residuals(found.x)
    after = dict(errors.means)
    spread, correlation = _spread(slope, left, known.sum(), sessions)
    return Calibration(
        description, values, span * spread, correlation, before, after, rows, errors.count, False
    )


def _spread(slopes: Array, left: Array, priors: int, sessions: Sequence[Session]) -> tuple[Array, Array]:
    """Standard errors (p,) and correlations (p, p) from the slopes at the end and the errors left there."""
    aligned = sum(
        6 * each.description.alignment.frame
        + 3 * each.description.alignment.point * len(each.description.sensors)
        for each in sessions
    )
    count, numbers = len(left) - priors, slopes.shape[1]
    variance = float((left[:count] ** 2).sum()) / max(count - numbers - aligned, 1)
    weighted = slopes.copy()
    weighted[:count] /= np.sqrt(max(variance, 1e-30))
    _, sizes, vt = np.linalg.svd(weighted, full_matrices=False)
    with np.errstate(divide="ignore"):
        parts = vt.T / sizes
    spread = np.sqrt((parts**2).sum(axis=1))
    with np.errstate(invalid="ignore"):
        correlation = (parts @ parts.T) / np.multiply.outer(spread, spread)
    return spread, correlation


def _sessions(description: CalibrationDescription, data: DataSet) -> list[Session]:
    """The training rows of the sessions that are asked for."""
    there = [each for each in data.description.sessions if each.replayed]
    known = tuple(each.name for each in there)
    for name in description.sessions:
        if name not in known:
            raise DataError(
                f"calibration {description.name}",
                "",
                f"no session {name!r} to replay; there are {listing(known)}",
            )
    chosen = [each for each in there if not description.sessions or each.name in description.sessions]
    return [_training_rows(load_session(data, each)) for each in chosen]


def _each(session: Session, count: int) -> Session:
    """Each so many-th row, of sessions in time all."""
    return session if session.times is not None else session.part(np.arange(0, len(session.table), count))


def _training_rows(session: Session) -> Session:
    """The session without rows that are not used: nobody needs their equilibria."""
    if session.times is not None:
        return session
    return session.part(np.flatnonzero(session.fitting))


def load_calibration(name_or_path: str | Path) -> tuple[CalibrationDescription, Path]:
    """A calibration by the name of its data set, or by the path of its file; and where it is.

    Raises:
        ConfigError: nothing found, or any problem in the description, in one sentence.
    """
    file = find_calibration(str(name_or_path))
    return structured(read_extended(file), CalibrationDescription, file, find_files=False), file


def find_calibration(text: str) -> Path:
    """The file of a calibration: that path, or calibration.yaml beside a data set of that name."""
    path = Path(text).expanduser()
    if path.is_file():
        return path.absolute()
    if (path / FILE).is_file():
        return (path / FILE).absolute()
    known = known_calibrations()
    if text not in known:
        raise ConfigError(
            text, "", f"no such file, and no calibration of that name; known: {listing(tuple(known))}"
        )
    return known[text]


def known_calibrations() -> dict[str, Path]:
    """Files of the calibrations beside the data sets that are known by name."""
    beside = {name: file.parent / FILE for name, file in known_data_sets().items()}
    return {name: file.absolute() for name, file in beside.items() if file.is_file()}


def data_of(description: CalibrationDescription, file: Path, data: Path | None) -> DataSet:
    """The data set of a calibration in `file`; `data`: see load_data_set."""
    beside = file.parent / description.data_set
    return load_data_set(str(beside) if beside.is_dir() else description.data_set, data)
