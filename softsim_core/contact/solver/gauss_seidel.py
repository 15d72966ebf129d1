"""Forces of contacts with Coulomb friction and of bounded rows (actuators): Gauss-Seidel and Newton."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.contact.solver.compile import kernel
from softsim_core.contact.solver.law import (
    ContactProblem,
    friction_of,
    gaps_under,
    into_bounds,
    moved_friction,
    violation,
)
from softsim_core.contact.solver.newton import solve_by_newton
from softsim_core.contact.solver.smoothing import solve_by_sharpening

_SWEEPS = 8
"""Sweeps before the first attempt of Newton's method; twice as many before each further one."""
_ROUNDNESS = (1.0, 1.0e4)
"""How smooth the corners of the smoothed law are at first, in turn."""


class ContactSolution(NamedTuple):
    """Forces, and how well they fulfil the contact law.

    Attributes:
        forces: In [N], shape (r,). Every contact lies in its cone, every bounded row within its bounds.
        residual: Largest violation of the law over all rows, expressed as a gap in [m]: each force moved by
            its gap over its own compliance and brought back into bounds or cone, times that compliance.
        sweeps: Gauss-Seidel sweeps over all rows that were needed.
    """

    forces: Array
    residual: float
    sweeps: int


def solve_contacts(
    compliance: Array,
    gap: Array,
    bounds: tuple[Array, Array],
    friction: Array | float,
    start: Array,
    iterations: int,
    tolerance: float,
) -> ContactSolution:
    r"""Forces :math:`f` so that the gaps :math:`g = g_0 + C f` obey the law of each row.

    Bounded rows come first: the gap is 0 unless the force is at a bound. Then contacts, three rows each
    (normal, two tangents): :math:`0 \le f_n \perp g_n \ge 0`, and :math:`|f_t| \le \mu f_n` where sliding
    friction points against the slip :math:`g_t`.

    Args:
        compliance: C in [m/N], symmetric positive semidefinite, shape (r, r).
        gap: Gaps and slips without any force in [m], shape (r,).
        bounds: Least and largest force of each bounded row in [N], b each; may be infinite.
        friction: Coulomb coefficient of each contact, shape (k,), or one for all.
        start: Forces to start from in [N], shape (r,).
        iterations: Most sweeps; a few dozen Newton steps come between them.
        tolerance: Residual in [m] that is good enough.

    Source: Jourdan, Alart, Jean 1998 (block Gauss-Seidel); Silcowitz, Niebe, Erleben 2010 (alternating it
    with a Newton step on the rows that touch).
    """
    lower, upper = bounds
    forces = np.array(start, dtype=np.float64)
    contacts = (len(forces) - len(lower)) // 3
    problem = ContactProblem(
        np.ascontiguousarray(compliance), gap, lower, upper, np.ones(contacts) * friction
    )
    residual, sweeps = _solve(problem, forces, iterations, tolerance)
    return ContactSolution(forces, residual, sweeps)


@kernel
def _solve(problem: ContactProblem, forces: Array, iterations: int, tolerance: float) -> tuple[float, int]:
    """Overwrites forces; returns the residual in [m] and the number of sweeps."""
    into_bounds(problem, forces)
    state = gaps_under(problem, forces)
    residual, _ = violation(problem, state, forces)
    sweeps, planned, attempt = 0, _SWEEPS, 0
    while residual > tolerance and sweeps < iterations:
        for _ in range(min(planned, iterations - sweeps)):
            sweeps += 1
            _sweep(problem, forces, state)
            residual, _ = violation(problem, state, forces)
            if residual <= tolerance:
                break
        if attempt == 0:
            residual = solve_by_newton(problem, forces, tolerance)
        else:
            roundness = _ROUNDNESS[(attempt - 1) % len(_ROUNDNESS)]
            residual = solve_by_sharpening(problem, forces, roundness, tolerance)
        state[:] = gaps_under(problem, forces)
        planned, attempt = 2 * planned, attempt + 1
    return residual, sweeps


@kernel
def _sweep(problem: ContactProblem, forces: Array, state: Array) -> None:
    """Solve every row or contact once, all others held."""
    compliance, lower, upper = problem.compliance, problem.lower, problem.upper
    bounded = lower.shape[0]
    for i in range(bounded):
        if compliance[i, i] > 0.0:
            force = min(max(forces[i] - state[i] / compliance[i, i], lower[i]), upper[i])
            _change(i, force, compliance, forces, state)
    for i in range(bounded, forces.shape[0], 3):
        _contact(i, problem, forces, state)


@kernel
def _contact(i: int, problem: ContactProblem, forces: Array, state: Array) -> None:
    """Solve the contact of rows i; one that stays open costs nothing."""
    compliance = problem.compliance
    compliant = compliance[i, i]
    normal = max(0.0, forces[i] - state[i] / compliant) if compliant > 0.0 else 0.0
    if normal == 0.0 and forces[i] == 0.0:
        return
    _change(i, normal, compliance, forces, state)
    a, b, c = compliance[i + 1, i + 1], compliance[i + 1, i + 2], compliance[i + 2, i + 2]
    determinant = a * c - b * b
    limit = friction_of(i, problem) * normal
    u = v = np.inf
    if limit > 0.0 and determinant > 1e-12 * a * c:
        u = forces[i + 1] - (c * state[i + 1] - b * state[i + 2]) / determinant
        v = forces[i + 2] - (a * state[i + 2] - b * state[i + 1]) / determinant
    if u * u + v * v > limit * limit:  # does not stick
        u, v = moved_friction(i, problem, forces, state)
    _change(i + 1, u, compliance, forces, state)
    _change(i + 2, v, compliance, forces, state)


@kernel
def _change(i: int, force: float, compliance: Array, forces: Array, state: Array) -> None:
    """Set force i and bring the gaps up to date."""
    change = force - forces[i]
    if change != 0.0:
        forces[i] = force
        row = compliance[i]
        for j in range(state.shape[0]):
            state[j] += change * row[j]
