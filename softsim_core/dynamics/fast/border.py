"""The border's own unknowns: frames and joints, and the tensions of cables, which come last.

A cable with row H is a border unknown like any other: its column is H^T, its own diagonal zero, and it stands
for minus the impulse h t. Elimination then leaves minus the cables' compliance, which bounds decide on.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from softsim_core.arrays import Array, BoolArray
from softsim_core.dynamics.fast.compile import kernel


@kernel
def eliminate_border(schur: Array, known: BoolArray, change: Array, matrix: Array) -> None:
    """Eliminate the solved frames and joints from the upper triangle of `schur` (last column: right side).

    Args:
        schur: Shape (b + c, b + c + 1), the cables last.
        known: Frames and joints whose `change` is given, shape (b,).
        change: Shape (b + c,).
        matrix: Rows of the factor, and what is left for the cables, shape of `schur`.
    """
    total, size = len(schur), len(known)
    for i in range(total):
        if i < size and known[i]:
            continue
        for j in range(i, total + 1):
            matrix[i, j] = schur[i, j]
        for j in range(size):
            if known[j]:
                matrix[i, total] -= (schur[i, j] if i < j else schur[j, i]) * change[j]
    for i in range(size):
        if known[i]:
            continue
        scale = 1.0 / sqrt(matrix[i, i])
        for j in range(i, total + 1):
            matrix[i, j] *= scale
        for k in range(i + 1, total):
            if k >= size or not known[k]:
                for j in range(k, total + 1):
                    matrix[k, j] -= matrix[i, k] * matrix[i, j]


@kernel
def solve_border(known: BoolArray, change: Array, matrix: Array) -> None:
    """Fill in what is not known in `change`, after `eliminate_border`; that of the cables is given."""
    total, size = len(change), len(known)
    for i in range(size - 1, -1, -1):
        if known[i]:
            continue
        change[i] = matrix[i, total]
        for j in range(i + 1, total):
            if j >= size or not known[j]:
                change[i] -= matrix[i, j] * change[j]
        change[i] /= matrix[i, i]


@kernel
def solve_held(matrix: Array, gap: Array, held: BoolArray, forces: Array, factor: Array) -> None:
    """Forces of the held rows so that gap + matrix . forces = 0 there; the others are given."""
    size = len(gap)
    for i in range(size):
        if not held[i]:
            continue
        forces[i] = -gap[i]
        for j in range(size):
            factor[i, j] = matrix[i, j]
            if not held[j]:
                forces[i] -= matrix[i, j] * forces[j]
    for i in range(size):
        if not held[i]:
            continue
        scale = 1.0 / sqrt(factor[i, i])
        forces[i] *= scale
        for j in range(i, size):
            factor[i, j] *= scale
        for k in range(i + 1, size):
            if held[k]:
                forces[k] -= factor[i, k] * forces[i]
                for j in range(k, size):
                    factor[k, j] -= factor[i, k] * factor[i, j]
    for i in range(size - 1, -1, -1):
        if held[i]:
            for j in range(i + 1, size):
                if held[j]:
                    forces[i] -= factor[i, j] * forces[j]
            forces[i] /= factor[i, i]


@kernel
def bounded_forces(matrix: Array, gap: Array, lower: Array, upper: Array, forces: Array) -> None:
    """The compiled twin of dynamics.bounded.solve_bounded: forces (c,) in [N]."""
    size, tiny = len(gap), 0.0
    factor, held, hold = np.empty((size, size)), np.empty(size, np.bool_), np.empty(size, np.bool_)
    for c in range(size):
        tiny = max(tiny, 1e-12 * abs(gap[c]))
        held[c] = lower[c] < upper[c]
        forces[c] = 0.0 if held[c] else lower[c]
    for _ in range(2 * size + 1):
        solve_held(matrix, gap, held, forces, factor)
        settled = True
        for c in range(size):
            if held[c]:
                hold[c] = lower[c] <= forces[c] <= upper[c]
            else:
                rest = gap[c]
                for d in range(size):
                    rest += matrix[c, d] * forces[d]
                back = rest < -tiny if forces[c] <= lower[c] else rest > tiny
                hold[c] = back and lower[c] < upper[c]
            settled = settled and hold[c] == held[c]
        if settled:
            return
        for c in range(size):
            held[c] = hold[c]
            forces[c] = min(max(forces[c], lower[c]), upper[c])
