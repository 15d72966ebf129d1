"""Registry of the linear solvers that scenes can choose, by name."""

from __future__ import annotations

from typing import Final

from softsim_core.base import Registry
from softsim_core.physics.linalg.solver_interface import LinearSolver, SuperLU
from softsim_core.physics.linalg.supernodal import Iterative, Supernodal

AUTO: Final = "auto"
"""Name that leaves the choice to the suite."""

COMPILED: Final = Supernodal.name
"""Solver that the compiled step includes."""

ITERATIVE: Final = Iterative.name
"""Conjugate gradients in the compiled step."""

_DEFAULT: Final = SuperLU.name
_solvers: Registry[LinearSolver] = Registry("linear solver", Supernodal(), Iterative(), SuperLU())


def register_linear_solver(solver: LinearSolver) -> None:
    """Register `solver`, so that scenes can choose it by its name, `solver: {linear_solver: NAME}`.

    Raises:
        SceneError: the name is one of the package's own.
    """
    _solvers.register(solver)


def choose_linear_solver(name: str = AUTO) -> LinearSolver:
    """Return the solver of that name; "auto" is the one that runs everywhere and with every matrix.

    Raises:
        SceneError: there is none; the message lists the known ones.
    """
    return _solvers.get(_DEFAULT if name == AUTO else name)


def linear_solver_names() -> tuple[str, ...]:
    """Return all names that `choose_linear_solver` knows besides "auto"."""
    return _solvers.names()
