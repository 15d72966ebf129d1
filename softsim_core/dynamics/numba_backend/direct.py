"""The free nodes eliminated by a Cholesky factor: within one compiled call, or shared by threads."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from time import perf_counter
from typing import Any

import numpy as np

from softsim_core.actuation.actuators import Actuators
from softsim_core.dynamics.numba_backend.advance import advance, assemble, finish
from softsim_core.dynamics.numba_backend.elimination import assembling, finishing, without_actuators
from softsim_core.dynamics.numba_backend.inversion import count_inverted
from softsim_core.dynamics.numba_backend.prepare import Prepared, of_another_copy, shares_plan
from softsim_core.dynamics.numba_backend.responses import Responses
from softsim_core.kernels import OneSignature
from softsim_core.linalg.cholesky import factor
from softsim_core.linalg.crew import Teamwork
from softsim_core.linalg.divided_factor import lead_factor, room_for, support_factor
from softsim_core.linalg.division import Division
from softsim_core.mechanics.model import Model


class DirectElimination:
    """See Elimination."""

    stages = ("assemble", "factor", "solve")
    iterations = 0

    def __init__(self, model: Model, actuators: Actuators, prepared: Prepared) -> None:
        self._model, self._actuators = model, actuators
        self.prepared, self.responses = prepared, Responses(model, actuators, prepared)
        self._advance, self._factor = OneSignature(advance), OneSignature(factor)

    def of_another_copy(self, model: Model, actuators: Actuators) -> DirectElimination | None:
        """The same for another model, in the same room; None: it needs a plan of its own."""
        own, theirs = self._actuators.constraints, actuators.constraints
        if not shares_plan(self._model, model) or any(
            not np.array_equal(a, b) for a, b in zip(own, theirs, strict=True)
        ):
            return None
        other = copy(self)
        other._model, other._actuators = model, actuators
        other.prepared = of_another_copy(self.prepared, model, actuators)
        other.responses = Responses(model, actuators, other.prepared)
        return other

    def factor(self) -> None:
        """Factor the matrix that stands in the panels, and solve forward."""
        self._factor(self.prepared.tree, self.prepared.work.factor)

    def advance(self, *arguments: Any) -> tuple[float, int, float, float, float]:
        """See Elimination."""
        if not len(self._actuators):
            arguments = without_actuators(arguments)
        result: tuple[float, int, float, float, float] = self._advance(*arguments)
        return result

    def tuned(self, rest: Callable[[], tuple[Any, ...]]) -> None:
        """See Elimination: nothing is kept."""


class DividedElimination(DirectElimination):
    """The same for large meshes, whose factorisation several threads share.

    Args:
        model, actuators: What moves, and what moves it.
        prepared: The arrays of a step, with a stack for that division.
        division: What of the factorisation is done side by side.
        threads: How many threads do it.
    """

    def __init__(
        self, model: Model, actuators: Actuators, prepared: Prepared, division: Division, threads: int
    ) -> None:
        super().__init__(model, actuators, prepared)
        self._assemble, self._finish = OneSignature(assemble), OneSignature(finish)
        self._division, self._room = division, room_for(prepared.tree, division, np.float64)
        self._factor_together = Teamwork(threads, lead_factor, support_factor)

    def factor(self) -> None:
        """See DirectElimination."""
        store = self.prepared.work.factor
        self._factor_together(self.prepared.tree, store, self._division, self._room)

    def advance(self, *arguments: Any) -> tuple[float, int, float, float, float]:
        """See Elimination."""
        started = perf_counter()
        self._assemble(*assembling(arguments))
        assembled = perf_counter()
        self.factor()
        factored = perf_counter()
        speed = self._finish(*finishing(arguments, self.prepared.tree, self.prepared.work))
        inverted = count_inverted(arguments[0].positions, arguments[-1])
        return speed, inverted, assembled - started, factored - assembled, perf_counter() - factored
