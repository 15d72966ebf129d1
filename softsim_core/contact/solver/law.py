"""The law of contacts and bounded rows: bringing forces into it, and how far they are from it."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from softsim_core.arrays import Array
from softsim_core.contact.solver.compile import kernel


class ContactProblem(NamedTuple):
    """Bounded rows first, then contacts of three rows each: normal and two tangents; r = b + 3 k rows.

    Attributes:
        compliance: C in [m/N], symmetric positive semidefinite, shape (r, r).
        gap: Gaps and slips without any force in [m], shape (r,).
        lower, upper: Least and largest force of each bounded row in [N], shape (b,) each; may be infinite.
        friction: Coulomb coefficient of each contact, shape (k,).
    """

    compliance: Array
    gap: Array
    lower: Array
    upper: Array
    friction: Array


@kernel
def friction_of(i: int, problem: ContactProblem) -> float:
    """Coulomb coefficient of the contact of rows i."""
    return float(problem.friction[(i - problem.lower.shape[0]) // 3])


@kernel
def into_bounds(problem: ContactProblem, forces: Array) -> None:
    """Bring forces into their bounds and cones."""
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
    """Gaps and slips g + C f in [m], shape (r,); forces that are zero cost nothing.

    Not by BLAS: it would start threads, and its last digits depend on where the arrays lie in memory.
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
    """Tangential force of the contact of rows i, moved against the slip and brought back into the cone."""
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
    """Largest compliance in [m/N] of the contact of rows i along a tangent."""
    a, b, c = compliance[i + 1, i + 1], compliance[i + 1, i + 2], compliance[i + 2, i + 2]
    return float(0.5 * (a + c) + sqrt(0.25 * (a - c) * (a - c) + b * b))


@kernel
def violation(problem: ContactProblem, state: Array, forces: Array) -> tuple[float, float]:
    """How far admissible forces are from the law at gaps `state`: largest [m], sum of squares [m^2].

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
        if compliance[i, i] <= 0.0:  # both sides are held: no force changes anything
            continue
        off = abs(min(forces[i] * compliance[i, i], state[i]))
        largest, squares = max(largest, off), squares + off * off
        if forces[i] > 0.0:
            u, v = moved_friction(i, problem, forces, state)
            du, dv = u - forces[i + 1], v - forces[i + 2]
            off = sqrt(du * du + dv * dv) * largest_tangential(i, compliance)
            largest, squares = max(largest, off), squares + off * off
    return largest, squares
