"""The linear solvers that scenes can choose, by name."""

from __future__ import annotations

from typing import Final

from softsim_core.base import Registry
from softsim_core.physics.linalg.solver_interface import LinearSolver, SuperLU
from softsim_core.physics.linalg.supernodal import Iterative, Supernodal

AUTO: Final = "auto"
"""The name that leaves the choice to the suite."""

COMPILED: Final = Supernodal.name
"""The solver that the compiled step is one with."""

ITERATIVE: Final = Iterative.name
"""Conjugate gradients in the compiled step."""

_DEFAULT: Final = SuperLU.name
_solvers: Registry[LinearSolver] = Registry("linear solver", Supernodal(), Iterative(), SuperLU())


def register_linear_solver(solver: LinearSolver) -> None:
    """Let scenes choose `solver` by its name, `solver: {linear_solver: NAME}`.

    Raises:
        SceneError: the name is one of the package's own.
    """
    _solvers.register(solver)


def linear_solver(name: str = AUTO) -> LinearSolver:
    """The solver of that name; "auto" is the one that runs everywhere and with every matrix.

    Raises:
        SceneError: there is none; the sentence lists those that are known.
    """
    return _solvers.get(_DEFAULT if name == AUTO else name)


def linear_solver_names() -> tuple[str, ...]:
    """All names that `linear_solver` knows besides "auto"."""
    return _solvers.names()
