"""Errors of all rows that fit, as a function of the parameters that are sought."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import DataError
from softsim_core.identification.calibration import CalibrationDescription, ParameterDescription
from softsim_core.identification.expressions import filled
from softsim_core.identification.replay import Near, Prediction, replay
from softsim_core.identification.session import Session
from softsim_core.identification.validation import compared, session_robot
from softsim_core.scene.robot import RobotDescription

FAR = 10.0
"""Errors of values with which too many rows are lost, over the largest of those before."""

LOST = 0.1
"""Part of the rows that may have no equilibrium."""

Progress: TypeAlias = Callable[[int, float, Array], None]
"""Told how often all rows were replayed, the mean error in [m], and the values (p,)."""


class Misfit:
    """Errors of all rows that fit in [m]; remembers equilibria, and the best.

    Attributes:
        parameters: What is sought, in order; one that each session has its own of stands once for each.
        names: Of these; of one that each session has its own of: `NAME of SESSION`.
        sessions: The rows, each session's.
        count: How often all rows were replayed.
        means: Mean error of each session in [m] at the last replay.
        best: The smallest mean of these that there was; `best_values` and `best_means` belong to it.
        latest: The last replay, of each session.
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
        self.sessions = [_each(session, every) for session in sessions]
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
        self._near: list[Near] = [{} for _ in sessions]
        self._last: tuple[Array, Array, dict[str, float]] | None = None
        self._largest: float | None = None
        self._kept = np.zeros(0)

    @property
    def rows(self) -> dict[str, int]:
        """How many rows fit, by session."""
        return {each.name: int(each.fitting.sum()) for each in self.sessions}

    def __call__(self, values: Array) -> Array:
        """All errors of a replay with values (p,), shape (n,); of rows that it loses those of the best."""
        if self._last is not None and np.array_equal(self._last[0], values):
            self.means = self._last[2]
            return self._last[1]
        near = [dict(each) for each in self._near]
        self.latest = self.replayed(values, near)
        total = self.errors(self.latest, values)
        self._last = values.copy(), total, self.means
        self.count += 1
        mean = float(np.mean(list(self.means.values())))
        if mean < self.best:
            self.best, self.best_values, self.best_means = mean, values.copy(), dict(self.means)
            self._near, self._kept = near, total
        if self._progress is not None:
            self._progress(self.count, mean, values)
        return total

    def replayed(self, values: Array, near: Sequence[Near] | None = None) -> list[Prediction]:
        """What the model does in each session with values (p,).

        Rows begin where those of the best values are, so that what is found does not depend on what was
        tried before.

        Args:
            values: Of the parameters.
            near: Of each session, takes over the equilibria; None: they are forgotten.

        Raises:
            KeyboardInterrupt: it was interrupted.
        """
        done = []
        known = [dict(each) for each in self._near] if near is None else near
        for k, (session, equilibria) in enumerate(zip(self.sessions, known, strict=True)):
            done.append(replay(self.robot(k, values), session, near=equilibria))
            if done[-1].stopped:
                raise KeyboardInterrupt
        return done

    def errors(
        self, predictions: Sequence[Prediction], values: Array, sessions: Sequence[Session] | None = None
    ) -> Array:
        """Errors of a replay with values (p,) in the rows that fit, aligned to these, shape (n,).

        Args:
            predictions: The replay, of each session.
            values: With which it was made, for messages.
            sessions: In the place of `sessions`: the same with other rows that fit.
        """
        chosen = self.sessions if sessions is None else sessions
        errors, means = [], {}
        for session, prediction in zip(chosen, predictions, strict=True):
            result = compared(session, prediction)
            rows = session.fitting
            known = rows & result.known
            if known.sum() < (1.0 - LOST) * rows.sum():
                return self._lost(session, int(known.sum()), values, chosen)
            fitted = result.fitted_errors()
            means[session.name] = mean_distance(fitted[known])
            errors.append(np.where(known[:, None, None], fitted, np.nan)[rows].ravel())
        self.means, total = means, np.concatenate(errors)
        lost = np.isnan(total)
        total[lost] = self._kept[lost] if len(self._kept) == len(total) else 0.0
        self._largest = float(np.abs(total).max())
        return total

    def _lost(self, session: Session, known: int, values: Array, chosen: Sequence[Session]) -> Array:
        """Errors so large that a search comes back; at the first values of all there is no way back."""
        if self._largest is None:
            told = ", ".join(f"{name} {value:.4g}" for name, value in zip(self.names, values, strict=True))
            raise DataError(
                f"session {session.name}",
                "",
                f"only {known} of {session.fitting.sum()} rows have an equilibrium with {told}; "
                "narrow the bounds",
            )
        self.means = {each.name: np.inf for each in chosen}
        count = sum(3 * len(each.description.sensors) * int(each.fitting.sum()) for each in chosen)
        return np.full(count, FAR * self._largest)

    def follow(self, values: Array, told: Callable[[int, int], None] | None) -> None:
        """Find the equilibria of all rows of sessions once, from neighbour to neighbour.

        A bent robot may have several for one command, and rows far apart lead to others than it went through.
        """
        for k, (session, near) in enumerate(zip(self._whole, self._near, strict=True)):
            if session.times is None:
                replay(self.robot(k, values), session, progress=told, near=near)

    def robot(self, session: int, values: Array) -> RobotDescription:
        """The model of a session by its number, with values (p,)."""
        acting = {
            each.name: float(value)
            for (each, of), value in zip(self._acting, values, strict=True)
            if of is None or of == session
        }
        overlay = filled(self._description.overlay, acting)
        return session_robot(self._model, self._whole[session].description, overlay)


def mean_distance(errors: Array) -> float:
    """Mean distance between model and measurement in [m], of errors (k, s, 3) in [m]."""
    return float(np.linalg.norm(errors, axis=-1).mean())


def _each(session: Session, count: int) -> Session:
    """Each so many-th row, of sessions in time all."""
    return session if session.times is not None else session.part(np.arange(0, len(session.table), count))
