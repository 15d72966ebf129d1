"""The free nodes eliminated by a Cholesky factor of their matrix, within one compiled call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from softsim_core.actuation.actuators import Actuators
from softsim_core.dynamics.numba_backend.advance import advance
from softsim_core.dynamics.numba_backend.prepare import Prepared
from softsim_core.dynamics.numba_backend.responses import Responses
from softsim_core.kernels import OneSignature
from softsim_core.mechanics.model import Model


class DirectElimination:
    """See Elimination."""

    stages = ("assemble", "factor", "solve")
    iterations = 0

    def __init__(self, model: Model, actuators: Actuators, prepared: Prepared) -> None:
        self.prepared, self.responses = prepared, Responses(model, actuators, prepared)
        self._advance = OneSignature(advance)

    def advance(self, *arguments: Any) -> tuple[float, int, float, float, float]:
        """See Elimination."""
        result: tuple[float, int, float, float, float] = self._advance(*arguments)
        return result

    def tuned(self, rest: Callable[[], tuple[Any, ...]]) -> None:
        """See Elimination: nothing is kept."""
