"""Forces of contacts with Coulomb friction and of bounded rows, by Gauss-Seidel and Newton."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.contact import kernel
from softsim_core.physics.contact.solver.law import (
    ContactProblem,
    eliminate,
    friction_of,
    gaps_under,
    into_bounds,
    largest_tangential,
    moved_friction,
    violation,
)
from softsim_core.physics.contact.solver.smoothing import solve_by_sharpening
from softsim_core.physics.kernels import OneSignature

_STEPS = 16
"""Largest number of consecutive Newton steps, as long as each reduces the residual."""
_SOFTENINGS = (1.0e-6, 1.0e-3)
"""Softenings of Newton's matrix; the second is used where the first does not reduce the residual."""


class _System(NamedTuple):
    """Linear system of a Newton step over the active rows: matrix (n, n), right-hand side (n,)."""

    matrix: Array
    right: Array


@kernel
def solve_by_newton(problem: ContactProblem, forces: Array, tolerance: float) -> float:
    """Improve `forces`, which are within bounds and cones, by Newton steps as long as they help.

    Returns:
        The residual in [m], see law.violation(); converged if below `tolerance`.
    """
    state = gaps_under(problem, forces)
    residual, squares = violation(problem, state, forces)
    soft = 0
    for _ in range(_STEPS):
        if residual <= tolerance or soft == len(_SOFTENINGS):
            break
        aim = newton_step(problem, forces, state, _SOFTENINGS[soft])
        soft += 1
        for share in (1.0, 0.5, 0.25, _until_one_opens(problem.lower.shape[0], forces, aim)):
            trial = forces + share * (aim - forces)
            into_bounds(problem, trial)
            trial_state = gaps_under(problem, trial)
            largest, total = violation(problem, trial_state, trial)
            if total < squares * (1.0 - 0.2 * share):
                forces[:], state, residual, squares = trial, trial_state, largest, total
                soft -= 1
                break
    return residual


@kernel
def _until_one_opens(bounded: int, forces: Array, aim: Array) -> float:
    """Return the share of the step to `aim` at which the first contact loses its force, at most 1."""
    share = 1.0
    for i in range(bounded, forces.shape[0], 3):
        if aim[i] < 0.0 < forces[i]:
            share = min(share, forces[i] / (forces[i] - aim[i]))
    return share


@kernel
def newton_step(problem: ContactProblem, start: Array, state: Array, softening: float) -> Array:
    """Return the forces that solve the law linearised about the forces `start` with gaps `state`.

    Rows that one step of projection moves to a bound, or whose contact it opens, are fixed there. The gaps of
    the other rows must vanish; the friction of a sliding contact must be on the cone, opposite to the slip.
    The result may violate cones and bounds.

    The diagonal compliance of each row is increased by the share `softening`, because redundant contacts make
    the matrix singular, and nearly equal ones would push against each other.

    Source: Alart and Curnier 1991 (generalised Newton for friction).
    """
    compliance, lower, upper = problem.compliance, problem.lower, problem.upper
    bounded, rows = lower.shape[0], problem.gap.shape[0]
    forces = np.zeros(rows)
    active = np.zeros(rows, dtype=np.int64)
    size = 0
    for i in range(bounded):
        moved = start[i] - state[i] / max(compliance[i, i], 1e-300)
        forces[i] = min(max(moved, lower[i]), upper[i])
        if forces[i] == moved:
            forces[i] = start[i]
            active[size] = i
            size += 1
    first_contact = size
    for i in range(bounded, rows, 3):
        if compliance[i, i] > 0.0 and start[i] * compliance[i, i] > state[i]:
            for d in range(3 if friction_of(i, problem) > 0.0 else 1):
                forces[i + d] = start[i + d]
                active[size] = i + d
                size += 1
    if size == 0:
        return forces
    gaps = gaps_under(problem, forces)
    matrix = np.empty((size, size))
    right = np.empty(size)
    for a in range(size):
        i = active[a]
        right[a] = -gaps[i]
        for b in range(size):
            matrix[a, b] = compliance[i, active[b]]
        matrix[a, a] *= 1.0 + softening
    a = first_contact
    while a < size:
        if friction_of(active[a], problem) > 0.0:
            _let_slide(a, active[a], problem, forces, gaps, _System(matrix, right))
            a += 3
        else:
            a += 1
    eliminate(matrix, right)
    for a in range(size):
        forces[active[a]] += right[a]
    return forces


@kernel
def _let_slide(a: int, i: int, problem: ContactProblem, forces: Array, gaps: Array, system: _System) -> None:
    """If the contact of rows i slides, replace rows a + 1 and a + 2 by force = limit * slip direction."""
    matrix, right, friction = system.matrix, system.right, friction_of(i, problem)
    compliant = largest_tangential(i, problem.compliance)
    u, v = forces[i + 1] - gaps[i + 1] / compliant, forces[i + 2] - gaps[i + 2] / compliant
    length, limit = sqrt(u * u + v * v), friction * max(forces[i], 0.0)
    if length <= limit:
        return
    e, f, share = u / length, v / length, limit / length
    ee, ef, ff = share * (1.0 - e * e), -share * e * f, share * (1.0 - f * f)
    for b in range(right.shape[0]):
        first, second = matrix[a + 1, b] / compliant, matrix[a + 2, b] / compliant
        matrix[a + 1, b] = ee * first + ef * second
        matrix[a + 2, b] = ef * first + ff * second
    matrix[a + 1, a] -= friction * e
    matrix[a + 2, a] -= friction * f
    matrix[a + 1, a + 1] += 1.0 - ee
    matrix[a + 1, a + 2] -= ef
    matrix[a + 2, a + 1] -= ef
    matrix[a + 2, a + 2] += 1.0 - ff
    right[a + 1] = limit * e - forces[i + 1]
    right[a + 2] = limit * f - forces[i + 2]


_SWEEPS = 8
"""Number of sweeps before the first Newton attempt; it doubles before each further attempt."""
_ROUNDNESS = (1.0, 1.0e4)
"""Initial smoothness of the corners of the smoothed law, used in turn."""


class ContactSolution(NamedTuple):
    """Contact forces and their residual.

    Attributes:
        forces: Forces in [N], shape (r,). Each contact is in its cone, each bounded row within its bounds.
        residual: Largest violation of the law over all rows as a gap in [m]: the change of a force that is
            moved by its gap over its own compliance and projected into bounds or cone, times that compliance.
        sweeps: Number of Gauss-Seidel sweeps over all rows.
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
    r"""Return forces :math:`f` for which the gaps :math:`g = g_0 + C f` satisfy the law of each row.

    Bounded rows come first: the gap is 0 unless the force is at a bound. Contacts follow with three rows each
    (normal, two tangents): :math:`0 \le f_n \perp g_n \ge 0` and :math:`|f_t| \le \mu f_n`, where sliding
    friction is opposite to the slip :math:`g_t`.

    Args:
        compliance: C in [m/N], symmetric positive semidefinite, shape (r, r).
        gap: Gaps and slips without contact forces in [m], shape (r,).
        bounds: Smallest and largest force of each bounded row in [N], b each; may be infinite.
        friction: Coulomb coefficient of each contact, shape (k,), or one for all.
        start: Initial forces in [N], shape (r,).
        iterations: Largest number of sweeps; a few dozen Newton steps are made between them.
        tolerance: Residual in [m] at which the solver stops.

    Source: Jourdan, Alart, Jean 1998 (block Gauss-Seidel); Silcowitz, Niebe, Erleben 2010 (alternating it
    with a Newton step on the rows that touch).
    """
    lower, upper = bounds
    forces = np.array(start, dtype=np.float64)
    contacts = (len(forces) - len(lower)) // 3
    each = np.ones(contacts) * friction
    arrays = (np.ascontiguousarray(array, np.float64) for array in (compliance, gap, lower, upper, each))
    residual, sweeps = _solve_problem(ContactProblem(*arrays), forces, int(iterations), float(tolerance))
    return ContactSolution(forces, residual, sweeps)


@kernel
def _solve(problem: ContactProblem, forces: Array, iterations: int, tolerance: float) -> tuple[float, int]:
    """Overwrite `forces` by the solution; return the residual in [m] and the number of sweeps."""
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


_solve_problem = OneSignature(_solve)


@kernel
def _sweep(problem: ContactProblem, forces: Array, state: Array) -> None:
    """Solve every row or contact once, with all others fixed."""
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
    """Solve the contact of rows i; an open contact is skipped at no cost."""
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
    if u * u + v * v > limit * limit:  # the contact slides
        u, v = moved_friction(i, problem, forces, state)
    _change(i + 1, u, compliance, forces, state)
    _change(i + 2, v, compliance, forces, state)


@kernel
def _change(i: int, force: float, compliance: Array, forces: Array, state: Array) -> None:
    """Set force i and update the gaps."""
    change = force - forces[i]
    if change != 0.0:
        forces[i] = force
        row = compliance[i]
        for j in range(state.shape[0]):
            state[j] += change * row[j]
