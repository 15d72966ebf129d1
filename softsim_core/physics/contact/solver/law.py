"""Law of contacts and bounded rows: projection of forces onto it, and their violation of it."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from softsim_core.base import Array
from softsim_core.physics.contact import kernel

_PANEL = 4
"""Number of columns eliminated together; the rest of the matrix is updated once for all of them."""


@kernel
def eliminate(matrix: Array, right: Array) -> None:
    """Solve a linear system in place, with row pivoting; the solution replaces the right-hand side.

    An unknown whose pivot is zero becomes zero. LAPACK is not used, because it would start threads for
    matrices of this size, which costs more than it saves.

    Args:
        matrix: Shape (n, n); overwritten.
        right: Shape (n,); overwritten by the solution.
    """
    size = right.shape[0]
    for start in range(0, size, _PANEL):
        end = min(start + _PANEL, size)
        for k in range(start, end):
            _pivot(k, matrix, right)
            inverse = 1.0 / matrix[k, k] if matrix[k, k] != 0.0 else 0.0
            for i in range(k + 1, size):
                factor = matrix[i, k] * inverse
                matrix[i, k] = factor
                right[i] -= factor * right[k]
                for j in range(k + 1, end):
                    matrix[i, j] -= factor * matrix[k, j]
        for k in range(start + 1, end):
            for i in range(start, k):
                for j in range(end, size):
                    matrix[k, j] -= matrix[k, i] * matrix[i, j]
        if end < size:
            _update(start, matrix)
    for back in range(size):
        k = size - 1 - back
        for j in range(k + 1, size):
            right[k] -= matrix[k, j] * right[j]
        right[k] *= 1.0 / matrix[k, k] if matrix[k, k] != 0.0 else 0.0


@kernel
def _pivot(k: int, matrix: Array, right: Array) -> None:
    """Swap the row with the largest entry of column k, among rows k and below, with row k."""
    pivot, largest = k, abs(matrix[k, k])
    for i in range(k + 1, right.shape[0]):
        if abs(matrix[i, k]) > largest:
            pivot, largest = i, abs(matrix[i, k])
    if pivot != k:
        for j in range(right.shape[0]):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        right[k], right[pivot] = right[pivot], right[k]


@kernel
def _update(start: int, matrix: Array) -> None:
    """Subtract the four rows from `start` on, times their factors, from all rows below."""
    end = start + 4
    first, second = matrix[start, end:], matrix[start + 1, end:]
    third, fourth = matrix[start + 2, end:], matrix[start + 3, end:]
    for i in range(end, matrix.shape[0]):
        a, b, c, d = matrix[i, start], matrix[i, start + 1], matrix[i, start + 2], matrix[i, start + 3]
        row = matrix[i, end:]
        for j in range(row.shape[0]):
            row[j] -= a * first[j] + b * second[j] + c * third[j] + d * fourth[j]


class ContactProblem(NamedTuple):
    """Contact problem of r = b + 3 k rows: bounded rows, then contacts with a normal and two tangents.

    Attributes:
        compliance: C in [m/N], symmetric positive semidefinite, shape (r, r).
        gap: Gaps and slips without contact forces in [m], shape (r,).
        lower, upper: Smallest and largest force of each bounded row in [N], shape (b,) each; may be infinite.
        friction: Coulomb coefficient of each contact, shape (k,).
    """

    compliance: Array
    gap: Array
    lower: Array
    upper: Array
    friction: Array


@kernel
def friction_of(i: int, problem: ContactProblem) -> float:
    """Return the Coulomb coefficient of the contact of rows i."""
    return float(problem.friction[(i - problem.lower.shape[0]) // 3])


@kernel
def into_bounds(problem: ContactProblem, forces: Array) -> None:
    """Project forces into their bounds and cones, in place."""
    bounded = problem.lower.shape[0]
    for i in range(bounded):
        forces[i] = min(max(forces[i], problem.lower[i]), problem.upper[i])
    for i in range(bounded, forces.shape[0], 3):
        forces[i] = max(0.0, forces[i])
        size, limit = sqrt(forces[i + 1] ** 2 + forces[i + 2] ** 2), friction_of(i, problem) * forces[i]
        if size > limit:
            forces[i + 1] *= limit / size
            forces[i + 2] *= limit / size


@kernel
def gaps_under(problem: ContactProblem, forces: Array) -> Array:
    """Return gaps and slips g + C f in [m], shape (r,); zero forces are skipped.

    BLAS is not used: it would start threads, and its last digits depend on the memory alignment of the
    arrays.
    """
    gaps = problem.gap.copy()
    for i in range(forces.shape[0]):
        if forces[i] != 0.0:
            row = problem.compliance[i]
            for j in range(gaps.shape[0]):
                gaps[j] += forces[i] * row[j]
    return gaps


@kernel
def moved_friction(i: int, problem: ContactProblem, forces: Array, state: Array) -> tuple[float, float]:
    """Return the tangential force of the contact of rows i, moved against the slip, within the cone."""
    compliant, friction = largest_tangential(i, problem.compliance), friction_of(i, problem)
    if compliant <= 0.0 or friction == 0.0:
        return 0.0, 0.0
    u, v = forces[i + 1] - state[i + 1] / compliant, forces[i + 2] - state[i + 2] / compliant
    size, limit = sqrt(u * u + v * v), friction * forces[i]
    if size > limit:
        return u * limit / size, v * limit / size
    return u, v


@kernel
def largest_tangential(i: int, compliance: Array) -> float:
    """Return the largest compliance in [m/N] of the contact of rows i along a tangent."""
    a, b, c = compliance[i + 1, i + 1], compliance[i + 1, i + 2], compliance[i + 2, i + 2]
    return float(0.5 * (a + c) + sqrt(0.25 * (a - c) * (a - c) + b * b))


@kernel
def violation(problem: ContactProblem, state: Array, forces: Array) -> tuple[float, float]:
    """Return the violation of the law by admissible forces at gaps `state`: largest in [m], sum of squares.

    A force is moved by its gap over its own compliance and brought back into its bounds or cone; what then
    differs from the force, times that compliance, is the violation (natural map).
    """
    compliance = problem.compliance
    largest, squares, bounded = 0.0, 0.0, problem.lower.shape[0]
    for i in range(bounded):
        compliant = compliance[i, i]
        if compliant > 0.0:
            moved = min(max(forces[i] - state[i] / compliant, problem.lower[i]), problem.upper[i])
            off = abs(moved - forces[i]) * compliant
            largest, squares = max(largest, off), squares + off * off
    for i in range(bounded, forces.shape[0], 3):
        if compliance[i, i] <= 0.0:  # both sides are fixed: no force has an effect
            continue
        off = abs(min(forces[i] * compliance[i, i], state[i]))
        largest, squares = max(largest, off), squares + off * off
        if forces[i] > 0.0:
            u, v = moved_friction(i, problem, forces, state)
            du, dv = u - forces[i + 1], v - forces[i + 2]
            off = sqrt(du * du + dv * dv) * largest_tangential(i, compliance)
            largest, squares = max(largest, off), squares + off * off
    return largest, squares
