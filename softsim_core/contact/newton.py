"""One Newton step on the contact law, where Gauss-Seidel is slow: a stiff body held from several sides."""

from __future__ import annotations

from math import sqrt

import numpy as np

from softsim_core.arrays import Array
from softsim_core.contact.compile import kernel
from softsim_core.contact.law import largest_tangential


@kernel
def newton_step(
    compliance: Array,
    gap: Array,
    lower: Array,
    upper: Array,
    friction: float,
    start: Array,
    state: Array,
    softening: float,
) -> Array:
    """Forces that solve the law linearised about the forces `start` with gaps `state`.

    Rows that one step of projection puts at a bound, or whose contact it opens, are fixed there. The gaps of
    the others must vanish; friction of a sliding contact must lie on the cone, against the slip. The result
    may leave cones and bounds.

    Each row's own compliance is raised by the share `softening`: redundant contacts make the matrix singular,
    and nearly equal ones would push against each other.

    Source: Alart and Curnier 1991 (generalised Newton for friction).
    """
    bounded, rows = lower.shape[0], gap.shape[0]
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
    width = 3 if friction > 0.0 else 1
    for i in range(bounded, rows, 3):
        if compliance[i, i] > 0.0 and start[i] * compliance[i, i] > state[i]:
            for d in range(width):
                forces[i + d] = start[i + d]
                active[size] = i + d
                size += 1
    if size == 0:
        return forces
    gaps = gap + compliance @ forces
    matrix = np.empty((size, size))
    right = np.empty(size)
    for a in range(size):
        i = active[a]
        right[a] = -gaps[i]
        for b in range(size):
            matrix[a, b] = compliance[i, active[b]]
        matrix[a, a] *= 1.0 + softening
    if friction > 0.0:
        for a in range(first_contact, size, 3):
            _let_slide(a, active[a], friction, compliance, forces, gaps, matrix, right)
    _eliminate(matrix, right)
    for a in range(size):
        forces[active[a]] += right[a]
    return forces


@kernel
def _let_slide(
    a: int,
    i: int,
    friction: float,
    compliance: Array,
    forces: Array,
    gaps: Array,
    matrix: Array,
    right: Array,
) -> None:
    """If the contact of rows i slides, put force = limit * direction of the slip into rows a + 1, a + 2."""
    stiff = largest_tangential(i, compliance)
    u, v = forces[i + 1] - gaps[i + 1] / stiff, forces[i + 2] - gaps[i + 2] / stiff
    length, limit = sqrt(u * u + v * v), friction * max(forces[i], 0.0)
    if length <= limit:
        return
    e, f, share = u / length, v / length, limit / length
    ee, ef, ff = share * (1.0 - e * e), -share * e * f, share * (1.0 - f * f)
    for b in range(right.shape[0]):
        first, second = matrix[a + 1, b] / stiff, matrix[a + 2, b] / stiff
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


@kernel
def _eliminate(matrix: Array, right: Array) -> None:
    """Gauss elimination with row pivots, in place; the solution replaces the right-hand side.

    LAPACK would start threads for matrices of this size, which costs more than it saves.
    """
    size = right.shape[0]
    for k in range(size):
        pivot = k + np.argmax(np.abs(matrix[k:, k]))
        if pivot != k:
            for j in range(k, size):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            right[k], right[pivot] = right[pivot], right[k]
        head = matrix[k]
        inverse = 1.0 / head[k] if head[k] != 0.0 else 0.0
        for i in range(k + 1, size):
            factor = matrix[i, k] * inverse
            if factor != 0.0:
                row = matrix[i]
                for j in range(k + 1, size):
                    row[j] -= factor * head[j]
                right[i] -= factor * right[k]
    for back in range(size):
        k = size - 1 - back
        for j in range(k + 1, size):
            right[k] -= matrix[k, j] * right[j]
        right[k] *= 1.0 / matrix[k, k] if matrix[k, k] != 0.0 else 0.0
