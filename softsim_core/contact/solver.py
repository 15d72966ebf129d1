"""Forces of contacts with Coulomb friction and of bounded rows (cables): projected Gauss-Seidel."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.contact.compile import kernel


class ContactSolution(NamedTuple):
    """Forces, and how well they fulfil the contact law.

    Attributes:
        forces: In [N], shape (r,). Every contact lies in its cone, every bounded row within its bounds.
        residual: Largest violation of the law over all rows, expressed as a gap in [m]; see `residual_of`.
        sweeps: Sweeps over all rows that were needed.
    """

    forces: Array
    residual: float
    sweeps: int


def solve_contacts(
    compliance: Array,
    gap: Array,
    bounds: tuple[Array, Array],
    friction: float,
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
        friction: Coulomb coefficient.
        start: Forces to start from in [N], shape (r,).
        iterations: Most sweeps.
        tolerance: Residual in [m] that is good enough.

    Source: Jourdan, Alart, Jean 1998 (block Gauss-Seidel).
    """
    lower, upper = bounds
    compliance = np.ascontiguousarray(compliance)
    forces = np.array(start, dtype=np.float64)
    residual, sweeps = _solve(compliance, gap, lower, upper, friction, forces, iterations, tolerance)
    return ContactSolution(forces, residual, sweeps)


def residual_of(
    compliance: Array, gap: Array, bounds: tuple[Array, Array], friction: float, forces: Array
) -> float:
    """Largest violation of the contact law in [m], arguments as in `solve_contacts`.

    A force is moved by its gap over its own compliance and brought back into its bounds or cone; what then
    differs from the force, times that compliance, is the violation (natural map).
    """
    return float(_residual(compliance, gap + compliance @ forces, *bounds, friction, forces))


@kernel
def _solve(
    compliance: Array,
    gap: Array,
    lower: Array,
    upper: Array,
    friction: float,
    forces: Array,
    iterations: int,
    tolerance: float,
) -> tuple[float, int]:
    """Overwrites forces; returns the residual in [m] and the number of sweeps."""
    bounded, count = lower.shape[0], (gap.shape[0] - lower.shape[0]) // 3
    _into_bounds(lower, upper, friction, forces)
    state = gap + compliance @ forces
    residual, sweeps = _residual(compliance, state, lower, upper, friction, forces), 0
    while residual > tolerance and sweeps < iterations:
        sweeps += 1
        for i in range(bounded):
            if compliance[i, i] > 0.0:
                force = min(max(forces[i] - state[i] / compliance[i, i], lower[i]), upper[i])
                _change(i, force, compliance, forces, state)
        for k in range(count):
            _contact(bounded + 3 * k, friction, compliance, forces, state)
        residual = _residual(compliance, state, lower, upper, friction, forces)
        if residual <= tolerance or sweeps == iterations:  # sums of small changes gather round-off
            state = gap + compliance @ forces
            residual = _residual(compliance, state, lower, upper, friction, forces)
    return residual, sweeps


@kernel
def _change(i: int, force: float, compliance: Array, forces: Array, state: Array) -> None:
    """Set force i and bring the gaps up to date."""
    change = force - forces[i]
    if change != 0.0:
        forces[i] = force
        row = compliance[i]
        for j in range(state.shape[0]):
            state[j] += change * row[j]


@kernel
def _contact(i: int, friction: float, compliance: Array, forces: Array, state: Array) -> None:
    """Solve the contact whose normal row is i, all others held."""
    stiff = compliance[i, i]
    if stiff <= 0.0:
        return
    normal = max(0.0, forces[i] - state[i] / stiff)
    if normal == 0.0 and forces[i] == 0.0:
        return
    _change(i, normal, compliance, forces, state)
    a, b, c = compliance[i + 1, i + 1], compliance[i + 1, i + 2], compliance[i + 2, i + 2]
    limit = friction * normal
    determinant = a * c - b * b
    if limit > 0.0 and determinant > 1e-12 * a * c:  # sticks?
        u = forces[i + 1] - (c * state[i + 1] - b * state[i + 2]) / determinant
        v = forces[i + 2] - (a * state[i + 2] - b * state[i + 1]) / determinant
        if u * u + v * v <= limit * limit:
            _change(i + 1, u, compliance, forces, state)
            _change(i + 2, v, compliance, forces, state)
            return
    u, v = _friction(i, friction, compliance, forces, state)
    _change(i + 1, u, compliance, forces, state)
    _change(i + 2, v, compliance, forces, state)


@kernel
def _friction(i: int, friction: float, compliance: Array, forces: Array, state: Array) -> tuple[float, float]:
    """Tangential force of the contact at row i, moved against the slip and brought back into the cone."""
    stiff = _tangential(i, compliance)
    if stiff <= 0.0 or friction == 0.0:
        return 0.0, 0.0
    u, v = forces[i + 1] - state[i + 1] / stiff, forces[i + 2] - state[i + 2] / stiff
    size, limit = sqrt(u * u + v * v), friction * forces[i]
    if size > limit:
        return u * limit / size, v * limit / size
    return u, v


@kernel
def _tangential(i: int, compliance: Array) -> float:
    """Largest compliance in [m/N] of the contact at row i along a tangent."""
    a, b, c = compliance[i + 1, i + 1], compliance[i + 1, i + 2], compliance[i + 2, i + 2]
    return float(0.5 * (a + c) + sqrt(0.25 * (a - c) * (a - c) + b * b))


@kernel
def _residual(
    compliance: Array, state: Array, lower: Array, upper: Array, friction: float, forces: Array
) -> float:
    """Largest violation in [m] at gaps `state`."""
    worst, bounded = 0.0, lower.shape[0]
    for i in range(bounded):
        stiff = compliance[i, i]
        if stiff > 0.0:
            moved = min(max(forces[i] - state[i] / stiff, lower[i]), upper[i])
            worst = max(worst, abs(moved - forces[i]) * stiff)
    for k in range((forces.shape[0] - bounded) // 3):
        i = bounded + 3 * k
        worst = max(worst, abs(min(forces[i] * compliance[i, i], state[i])))
        if forces[i] > 0.0:
            u, v = _friction(i, friction, compliance, forces, state)
            du, dv = u - forces[i + 1], v - forces[i + 2]
            worst = max(worst, sqrt(du * du + dv * dv) * _tangential(i, compliance))
    return worst


@kernel
def _into_bounds(lower: Array, upper: Array, friction: float, forces: Array) -> None:
    """Bring forces into their bounds and cones."""
    bounded = lower.shape[0]
    for i in range(bounded):
        forces[i] = min(max(forces[i], lower[i]), upper[i])
    for k in range((forces.shape[0] - bounded) // 3):
        i = bounded + 3 * k
        forces[i] = max(0.0, forces[i])
        size = sqrt(forces[i + 1] * forces[i + 1] + forces[i + 2] * forces[i + 2])
        if size > friction * forces[i]:
            forces[i + 1] *= friction * forces[i] / size
            forces[i + 2] *= friction * forces[i] / size
