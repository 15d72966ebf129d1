"""Choice of the step's implementation."""

from __future__ import annotations

import warnings
from functools import cache

from softsim_core.base import Backend, SceneError
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.dynamics.scipy_backend import ScipyStepper
from softsim_core.physics.dynamics.stepper import Stepper
from softsim_core.physics.kernels import why_plain
from softsim_core.physics.linalg import AUTO, COMPILED, ITERATIVE, choose_linear_solver
from softsim_core.physics.mechanics import Model


def has_compiled_step(solver: str) -> bool:
    """Return whether a step with that linear solver can be compiled."""
    return solver in (AUTO, COMPILED, ITERATIVE)


def make_stepper(
    model: Model,
    backend: Backend,
    actuators: Actuators | None = None,
    solver: str = AUTO,
    touching: bool = False,
    like: Stepper | None = None,
    threads: int | None = None,
) -> Stepper:
    """Return the step implementation: "scipy", "numba", or "auto" (numba, or else scipy with one warning).

    Args:
        model: The model.
        actuators: Actuators of its joints; None: there are none.
        backend: "auto" selects scipy where kernels are not compiled. The compiled step includes its linear
            solver; any other solver runs with plain assembly.
        solver: Name of the linear solver, see linalg.solvers.
        touching: Whether steps have contacts, which need many solutions each.
        like: Stepper of another copy of the scene that never runs at the same time; the compiled step reuses
            its plan and its buffers.
        threads: Threads of the compiled step of a large mesh; None: as many as the process may use.

    Raises:
        SceneError: the solver is unknown or does not fit the backend, or kernels are not compiled here.
    """
    actuators = actuators if actuators is not None else Actuators()
    chosen, compiled = choose_linear_solver(solver), has_compiled_step(solver)
    if backend == "numba" and not compiled:
        raise SceneError(
            f"backend numba is one with the linear solver {COMPILED}: for {solver} set backend: scipy"
        )
    if backend != "scipy" and compiled:
        plain = why_plain()
        if plain is None:
            from softsim_core.physics.dynamics.numba_backend import NumbaStepper

            earlier = like if isinstance(like, NumbaStepper) else None
            iterative = None if solver == AUTO else solver == ITERATIVE
            return NumbaStepper(model, actuators, iterative, touching, earlier, threads)
        if backend == "numba":
            raise SceneError(f"backend numba needs compiled kernels, but {plain}, or use scipy")
        _say_that_the_slower_step_runs(plain)
    return ScipyStepper(model, actuators, chosen)


@cache  # once per process; Python's own filter starts again whenever warnings are caught
def _say_that_the_slower_step_runs(reason: str) -> None:
    warnings.warn(f"the slower NumPy + SciPy step runs: {reason}", stacklevel=4)
