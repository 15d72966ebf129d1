"""Numerics of a scene; typed, SI."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

from softsim_core.dynamics import Backend
from softsim_core.errors import listing
from softsim_core.linalg.solvers import AUTO, linear_solver_names
from softsim_core.values import FieldError
from softsim_core.wrong_names import one_of

RotationLaw: TypeAlias = Literal["polar", "qr"]
TimeIntegration: TypeAlias = Literal["implicit_euler", "bossak"]
Threads: TypeAlias = Literal["auto"] | int
SUBSTEPS: Final = (1, 2, 4, 8, 16, 32, 64)
MOST_THREADS: Final = 64
MOST_ITERATIONS: Final = 1000
_TOLERANCE, _LARGE = 1.0e-7, 0.1
"""Default of `iteration_tolerance` in [m], and size in [m] of what deforms below which it shrinks with it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverSettings:
    """Numerics: law of bodies that name none, implementation of the step, Rayleigh damping.

    Attributes:
        rotation: Law of bodies whose material names none: "polar" is corotational (survives inversion), "qr"
            is corotational_qr (parity with the reference simulator).
        backend: "numba" (fast), "scipy" (readable reference) or "auto" (numba where it imports).
        linear_solver: Name of what solves the linear systems of step and statics, see linalg.solvers; "auto"
            leaves it to the suite. One that the compiled step is not one with runs with plain assembly.
        threads: Of the compiled step of a large mesh, some 3000 nodes and more: 1 to 64, or "auto": as many
            as OMP_NUM_THREADS says, else as the process has cores. States are the same bit by bit.
        rayleigh_stiffness: Damping per stiffness in [s], >= 0.
        rayleigh_mass: Damping per mass in [1/s], >= 0.
        time_integration: "implicit_euler", or "bossak", of second order, for what shall ring as
            the real thing does; see dynamics.bossak.
        spectral_radius: Of "bossak": what each step leaves of the highest frequencies, 0 to 1.
        substeps: Parts in which a step is done at most where rubber or a quadratic cell strains too much for
            one: 1 (always whole), 2, 4 and so on up to 64.
        iterations: Newton iterations of a step at most, 1 to 1000; with 1 it is linearised once. "bossak"
            takes 2 at least where a body hangs on nothing: linearised once, it would gain energy as it turns.
        iteration_tolerance: A step has enough of them once one has moved no node farther than this, in [m],
            >= 0. None: 1e-7, or less in proportion to what deforms where that is smaller than 0.1 m.
    """

    rotation: RotationLaw = "polar"
    backend: Backend = "auto"
    linear_solver: str = AUTO
    threads: Threads = "auto"
    rayleigh_stiffness: float = 0.0
    rayleigh_mass: float = 0.0
    time_integration: TimeIntegration = "implicit_euler"
    spectral_radius: float = 0.8
    substeps: int = 8
    iterations: int = 1
    iteration_tolerance: float | None = None

    def __post_init__(self) -> None:
        for name, value, unit in (
            ("rayleigh_stiffness", self.rayleigh_stiffness, "s"),
            ("rayleigh_mass", self.rayleigh_mass, "1/s"),
        ):
            if not 0.0 <= value < math.inf:
                raise FieldError("solver", name, value, f">= 0 {unit}")
        if self.time_integration not in get_args(TimeIntegration):
            allowed = one_of(self.time_integration, get_args(TimeIntegration))
            raise FieldError("solver", "time_integration", self.time_integration, allowed)
        if not 0.0 <= self.spectral_radius <= 1.0:
            raise FieldError("solver", "spectral_radius", self.spectral_radius, "between 0 and 1")
        if self.substeps not in SUBSTEPS:
            raise FieldError("solver", "substeps", self.substeps, f"one of {listing(SUBSTEPS)}")
        if not 1 <= self.iterations <= MOST_ITERATIONS:
            raise FieldError("solver", "iterations", self.iterations, f"1 to {MOST_ITERATIONS}")
        if self.iteration_tolerance is not None and not 0.0 <= self.iteration_tolerance < math.inf:
            raise FieldError("solver", "iteration_tolerance", self.iteration_tolerance, ">= 0 m")
        known = (AUTO, *linear_solver_names())
        if self.linear_solver not in known:
            raise FieldError("solver", "linear_solver", self.linear_solver, one_of(self.linear_solver, known))
        if self.threads != "auto" and not 1 <= self.threads <= MOST_THREADS:
            raise FieldError("solver", "threads", self.threads, f"auto, or 1 to {MOST_THREADS}")

    def last_move(self, size: float) -> float:
        """Return how far in [m] an iteration may move a node and still be the last one.

        Args:
            size: Of what deforms in [m].
        """
        if self.iteration_tolerance is not None:
            return self.iteration_tolerance
        return _TOLERANCE * min(1.0, size / _LARGE)
