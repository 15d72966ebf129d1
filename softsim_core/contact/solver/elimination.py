"""Gauss elimination of small dense systems, for the contact kernels."""

from __future__ import annotations

from softsim_core.arrays import Array
from softsim_core.contact.solver.compile import kernel

_PANEL = 4
"""Columns that are eliminated together: the rest of the matrix is passed over once for all of them."""


@kernel
def eliminate(matrix: Array, right: Array) -> None:
    """Solve a system in place, with row pivots; the solution replaces the right-hand side.

    An unknown whose pivot is zero becomes zero. LAPACK would start threads for matrices of this size, which
    costs more than it saves.

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
    """Bring the row with the largest entry of column k, from row k on, to row k."""
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
    """Take the four rows from `start` on, times their factors, off all rows below."""
    end = start + 4
    first, second = matrix[start, end:], matrix[start + 1, end:]
    third, fourth = matrix[start + 2, end:], matrix[start + 3, end:]
    for i in range(end, matrix.shape[0]):
        a, b, c, d = matrix[i, start], matrix[i, start + 1], matrix[i, start + 2], matrix[i, start + 3]
        row = matrix[i, end:]
        for j in range(row.shape[0]):
            row[j] -= a * first[j] + b * second[j] + c * third[j] + d * fourth[j]
