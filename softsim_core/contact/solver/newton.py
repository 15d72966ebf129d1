"""One Newton step on the contact law, where Gauss-Seidel is slow: a stiff body held from several sides."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.contact.solver.compile import kernel
from softsim_core.contact.solver.elimination import eliminate
from softsim_core.contact.solver.law import (
    ContactProblem,
    friction_of,
    gaps_under,
    into_bounds,
    largest_tangential,
    violation,
)

_STEPS = 16
"""Newton steps in a row, as long as each brings the residual down."""
_SOFTENINGS = (1.0e-6, 1.0e-3)
"""Softenings of Newton's matrix; the second where the first leads nowhere."""


class _System(NamedTuple):
    """Newton's system over the rows that are solved for.

    Attributes:
        matrix: Shape (n, n).
        right: Right-hand side, shape (n,).
    """

    matrix: Array
    right: Array


@kernel
def solve_by_newton(problem: ContactProblem, forces: Array, tolerance: float) -> float:
    """Improve `forces`, which lie within bounds and cones, as long as Newton steps do.

    Returns:
        The residual in [m], see law.violation(); below `tolerance` it is good enough.
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
    """Share of the way to `aim` at which the first contact loses its force, at most 1."""
    share = 1.0
    for i in range(bounded, forces.shape[0], 3):
        if aim[i] < 0.0 < forces[i]:
            share = min(share, forces[i] / (forces[i] - aim[i]))
    return share


@kernel
def newton_step(problem: ContactProblem, start: Array, state: Array, softening: float) -> Array:
    """Forces that solve the law linearised about the forces `start` with gaps `state`.

    Rows that one step of projection puts at a bound, or whose contact it opens, are fixed there. The gaps of
    the others must vanish; friction of a sliding contact must lie on the cone, against the slip. The result
    may leave cones and bounds.

    Each row's own compliance is raised by the share `softening`: redundant contacts make the matrix singular,
    and nearly equal ones would push against each other.

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
    """If the contact of rows i slides, put force = limit * direction of the slip into rows a + 1, a + 2."""
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
