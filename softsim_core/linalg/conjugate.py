"""Conjugate gradients with a factor in single precision as preconditioner, compiled.

Source: Hestenes and Stiefel 1952; Saad 2003, Iterative Methods for Sparse Linear Systems, chapter 9.
"""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.linalg.compile import kernel
from softsim_core.linalg.divided_solve import Sharing, multiply, precondition, support_products
from softsim_core.linalg.layout import Tree
from softsim_core.linalg.products import Matrix, Preconditioner


@kernel
def largest(x: Array) -> float:
    """The largest magnitude; NaN if there is one."""
    result = 0.0
    for i in range(len(x)):
        value: float = abs(x[i])
        if not value <= result:
            result = value
            if value != value:
                return value
    return result


@kernel
def conjugate_gradients(
    matrix: Matrix, by: Preconditioner, sharing: Sharing, b: Array, x: Array, tolerance: float, share: float,
    most: int, agenda: IndexArray,
) -> int:  # fmt: skip
    """Solve A x = b by conjugate gradients from zero on.

    It ends where the preconditioner takes what is left for a change of x of at most `tolerance`, or of at
    most this `share` of the first guess, in the largest component.

    Args:
        matrix: A.
        by: What stands for its inverse.
        sharing: See divided_solve.
        b: Shape (3 f,).
        x: Shape (3 f,), written.
        tolerance: In the unit of x.
        share: Relative tolerance.
        most: Largest number of iterations.
        agenda: Where others read what there is to do.

    Returns:
        The number of iterations; -1: not reached in `most`; -2: A or its preconditioner is not positive.
    """
    room = sharing.room
    r, z, p, q = room[0], room[1], room[2], room[3]
    size = len(b)
    x[:] = 0.0
    scale = largest(b)
    if scale == 0.0:
        return 0
    if not scale < np.inf:
        return -2
    r[:] = b
    precondition(matrix, by, sharing, scale, agenda)
    p[:] = z
    left = 0.0
    for i in range(size):
        left += r[i] * z[i]
    limit = max(tolerance, share * largest(z))
    for count in range(most):
        reached = largest(z)
        if reached <= limit:
            for i in range(size):  # what the preconditioner knows of the rest costs nothing
                x[i] += z[i]
            return count
        if not left > 0.0:
            return -2
        multiply(matrix, by, sharing, agenda)
        curvature = 0.0
        for i in range(size):
            curvature += p[i] * q[i]
        if not curvature > 0.0:
            return -2
        step = left / curvature
        for i in range(size):
            x[i] += step * p[i]
            r[i] -= step * q[i]
        scale = largest(r)
        if scale == 0.0:
            return count + 1
        precondition(matrix, by, sharing, scale, agenda)
        before, left = left, 0.0
        for i in range(size):
            left += r[i] * z[i]
        ratio = left / before
        for i in range(size):
            p[i] = z[i] + ratio * p[i]
    return -1


@kernel
def support_gradients(
    matrix: Matrix, by: Preconditioner, sharing: Sharing, b: Array, x: Array, tolerance: float, share: float,
    most: int, agenda: IndexArray,
) -> None:  # fmt: skip
    """What a thread does that helps with `conjugate_gradients`."""
    support_products(matrix, by, sharing, agenda)


@kernel
def copy_matrix(matrix: Matrix, tree: Tree, supernode: IndexArray, panels: Array) -> None:
    """The matrix into the panels of its factor; `supernode` (f,): of each node, by unknown."""
    for i in range(len(matrix.row)):
        s = supernode[i]
        width, first, end = tree.width[s], tree.first_column[s], tree.first_column[s] + tree.columns[s]
        goal = tree.panel[s] + (3 * i - first) * width
        low = tree.first_row[s]
        for e in range(matrix.start[i] - 1, matrix.start[i + 1]):
            own = e < matrix.start[i]
            j = i if own else matrix.node[e]
            column = 0 if own else matrix.later[i] + 3 * (e - matrix.start[i])
            place = 3 * j - first
            if 3 * j >= end:
                rows = tree.row_index[low : tree.first_row[s + 1]]
                place = tree.later[s] + np.searchsorted(rows, 3 * j)
            for k in range(3):
                for c in range(3):
                    value = matrix.panels[matrix.row[i] + k * matrix.width[i] + column + c]
                    panels[goal + k * width + place + c] = value


@kernel
def reach(tree: Tree, supernodes: IndexArray, width: int, spans: IndexArray) -> None:
    """Columns 0 .. width for all supernodes above those given, none for others, shape (s, 2)."""
    spans[:] = 0
    for s in supernodes:
        while s >= 0 and spans[s, 1] == 0:
            spans[s, 1] = width
            s = tree.parent[s]
