"""The reduced coordinates: frames and joints, and the multipliers of actuators, which come last.

An actuator with row H stands like a reduced coordinate: its column is H^T, its own diagonal zero, and it
stands for minus the impulse h t. Elimination then leaves minus the actuators' compliance, which bounds decide
on.
"""

from __future__ import annotations

from math import sqrt

from softsim_core.arrays import Array, BoolArray
from softsim_core.dynamics.numba_backend.compile import kernel


@kernel
def eliminate_reduced(schur: Array, known: BoolArray, change: Array, matrix: Array) -> None:
    """Eliminate the solved frames and joints from the upper triangle of `schur` (last column: right side).

    Args:
        schur: Shape (b + c, b + c + 1), the actuators last.
        known: Frames and joints whose `change` is given, shape (b,).
        change: Shape (b + c,).
        matrix: Rows of the factor, and what is left for the actuators, shape of `schur`.
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
def solve_reduced(known: BoolArray, change: Array, matrix: Array) -> None:
    """Fill in what is not known in `change`, after `eliminate_reduced`; that of the actuators is given."""
    total, size = len(change), len(known)
    for i in range(size - 1, -1, -1):
        if known[i]:
            continue
        change[i] = matrix[i, total]
        for j in range(i + 1, total):
            if j >= size or not known[j]:
                change[i] -= matrix[i, j] * change[j]
        change[i] /= matrix[i, i]
