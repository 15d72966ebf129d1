"""The implementations of a step: which one runs here."""

from __future__ import annotations

import warnings
from functools import cache

from softsim_core.actuation.cable import Cables, no_cables
from softsim_core.dynamics.scipy_step import ScipyStepper
from softsim_core.dynamics.stepper import Stepper
from softsim_core.errors import SceneError
from softsim_core.mechanics.model import Model
from softsim_core.scene.description import Backend


def make_stepper(model: Model, backend: Backend, cables: Cables | None = None) -> Stepper:
    """The step implementation: "scipy", "numba", or "auto" (numba; without it scipy, and a warning once)."""
    cables = cables if cables is not None else no_cables()
    if backend != "scipy":
        try:
            from softsim_core.dynamics.fast.stepper import NumbaStepper

            return NumbaStepper(model, cables)
        except ModuleNotFoundError as error:
            if error.name is None or error.name.split(".")[0] not in ("numba", "llvmlite"):
                raise
            if backend == "numba":
                raise SceneError(
                    "backend numba needs the package numba: pip install numba, or use scipy"
                ) from error
            _say_that_numba_is_missing()
    return ScipyStepper(model, cables)


@cache  # once a process; Python's own once-a-place filter starts anew whenever a reader catches warnings
def _say_that_numba_is_missing() -> None:
    warnings.warn(
        "numba is not installed: the slower NumPy + SciPy step runs; pip install numba", stacklevel=4
    )
