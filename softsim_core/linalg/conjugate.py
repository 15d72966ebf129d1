"""Conjugate gradients with a factor in single precision as preconditioner, compiled.

The factor is that of the matrix of another shape of the same body. What has turned since is turned back
around its solution, node by node: R L^-T L^-1 R^T.

Source: Hestenes and Stiefel 1952; Saad 2003, Iterative Methods for Sparse Linear Systems, chapter 9.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softsim_core.arrays import Array, IndexArray
from softsim_core.linalg.compile import kernel
from softsim_core.linalg.layout import Tree
from softsim_core.linalg.simd import ROWS
from softsim_core.linalg.symbolic import Plan

SingleArray = NDArray[np.float32]
"""float32 array."""


class Matrix(NamedTuple):
    """A symmetric matrix of f nodes in the panels of a `matrix_layout`.

    Attributes:
        panels: Of the layout.
        row: Place of each node's first panel row, by unknown, shape (f,).
        width: Length of its rows, shape (f,).
        later: Panel column of its first later node, shape (f,).
        start: Where the later nodes of each begin in `node`; the last one ends them, shape (f + 1,).
        node: Later nodes that each is coupled to, by unknown, in the order of its panel.
    """

    panels: Array
    row: IndexArray
    width: IndexArray
    later: IndexArray
    start: IndexArray
    node: IndexArray


class Preconditioner(NamedTuple):
    """See the module.

    Attributes:
        tree: Of the factor.
        panels: Of the factor, no right-hand side in them.
        rotations: How each node has turned since, by unknown, shape (f, 3, 3).
        column: Room for all unknowns.
        line: Room for the widest panel row.
    """

    tree: Tree
    panels: SingleArray
    rotations: Array
    column: SingleArray
    line: SingleArray


@kernel
def multiply(matrix: Matrix, x: Array, y: Array) -> None:
    """Write A x to y, both (3 f,)."""
    panels, row, width, later, start, nodes = matrix
    y[:] = 0.0
    for i in range(len(row)):
        pitch, own = width[i], row[i]
        x0, x1, x2 = x[3 * i], x[3 * i + 1], x[3 * i + 2]
        one, two = own + pitch, own + 2 * pitch
        y0 = y[3 * i] + panels[own] * x0 + panels[own + 1] * x1 + panels[own + 2] * x2
        y1 = y[3 * i + 1] + panels[one] * x0 + panels[one + 1] * x1 + panels[one + 2] * x2
        y2 = y[3 * i + 2] + panels[two] * x0 + panels[two + 1] * x1 + panels[two + 2] * x2
        at = later[i]
        for e in range(start[i], start[i + 1]):
            j = 3 * nodes[e]
            z0, z1, z2 = x[j], x[j + 1], x[j + 2]
            a00, a01, a02 = panels[own + at], panels[own + at + 1], panels[own + at + 2]
            a10, a11, a12 = panels[one + at], panels[one + at + 1], panels[one + at + 2]
            a20, a21, a22 = panels[two + at], panels[two + at + 1], panels[two + at + 2]
            y0 += a00 * z0 + a01 * z1 + a02 * z2
            y1 += a10 * z0 + a11 * z1 + a12 * z2
            y2 += a20 * z0 + a21 * z1 + a22 * z2
            y[j] += a00 * x0 + a10 * x1 + a20 * x2
            y[j + 1] += a01 * x0 + a11 * x1 + a21 * x2
            y[j + 2] += a02 * x0 + a12 * x1 + a22 * x2
            at += 3
        y[3 * i], y[3 * i + 1], y[3 * i + 2] = y0, y1, y2


@kernel
def solve_forward(tree: Tree, panels: SingleArray, x: SingleArray, line: SingleArray) -> None:
    """Replace x by L^-1 x: each panel is read once, ROWS rows at a time."""
    for s in range(len(tree.columns)):
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        first, low, coupled = tree.first_column[s], tree.first_row[s], tree.side[s] - 1
        end = later + coupled
        for k in range(own):
            line[k] = x[first + k]
        for k in range(own, end):
            line[k] = np.float32(0.0)
        for k in range(0, own, ROWS):
            a = begin + k * width
            b, c, d = a + width, a + 2 * width, a + 3 * width
            y0 = line[k] / panels[a + k]
            y1 = (line[k + 1] - panels[a + k + 1] * y0) / panels[b + k + 1]
            y2 = (line[k + 2] - panels[a + k + 2] * y0 - panels[b + k + 2] * y1) / panels[c + k + 2]
            y3 = line[k + 3] - panels[a + k + 3] * y0 - panels[b + k + 3] * y1 - panels[c + k + 3] * y2
            y3 = y3 / panels[d + k + 3]
            line[k], line[k + 1], line[k + 2], line[k + 3] = y0, y1, y2, y3
            for j in range(k + ROWS, end):
                line[j] -= panels[a + j] * y0 + panels[b + j] * y1 + panels[c + j] * y2 + panels[d + j] * y3
        for k in range(own):
            x[first + k] = line[k]
        for j in range(coupled):
            x[tree.row_index[low + j]] += line[later + j]


@kernel
def solve_back(tree: Tree, panels: SingleArray, x: SingleArray, line: SingleArray) -> None:
    """Replace x by L^-T x: each panel is read once, ROWS rows at a time."""
    for s in range(len(tree.columns) - 1, -1, -1):
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        first, low, coupled = tree.first_column[s], tree.first_row[s], tree.side[s] - 1
        end = later + coupled
        for k in range(own):
            line[k] = x[first + k]
        for k in range(own, later):
            line[k] = np.float32(0.0)
        for j in range(coupled):
            line[later + j] = x[tree.row_index[low + j]]
        for k in range(own - 1 - (own - 1) % ROWS, -1, -ROWS):
            a = begin + k * width
            b, c, d = a + width, a + 2 * width, a + 3 * width
            t0, t1, t2, t3 = line[k], line[k + 1], line[k + 2], line[k + 3]
            for j in range(k + ROWS, end):
                value = line[j]
                t0 -= panels[a + j] * value
                t1 -= panels[b + j] * value
                t2 -= panels[c + j] * value
                t3 -= panels[d + j] * value
            t3 = t3 / panels[d + k + 3]
            t2 = (t2 - panels[c + k + 3] * t3) / panels[c + k + 2]
            t1 = (t1 - panels[b + k + 2] * t2 - panels[b + k + 3] * t3) / panels[b + k + 1]
            t0 = t0 - panels[a + k + 1] * t1 - panels[a + k + 2] * t2 - panels[a + k + 3] * t3
            t0 = t0 / panels[a + k]
            line[k], line[k + 1], line[k + 2], line[k + 3] = t0, t1, t2, t3
        for k in range(own):
            x[first + k] = line[k]


@kernel
def precondition(by: Preconditioner, scale: float, r: Array, z: Array) -> None:
    """Write R L^-T L^-1 R^T r to z, both (3 f,); r / `scale` fits into single precision."""
    rotations, column = by.rotations, by.column
    for n in range(len(rotations)):
        for i in range(3):
            total = 0.0
            for j in range(3):
                total += rotations[n, j, i] * r[3 * n + j]
            column[3 * n + i] = total / scale
    solve_forward(by.tree, by.panels, column, by.line)
    solve_back(by.tree, by.panels, column, by.line)
    for n in range(len(rotations)):
        for i in range(3):
            total = 0.0
            for j in range(3):
                total += rotations[n, i, j] * column[3 * n + j]
            z[3 * n + i] = total * scale


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
    matrix: Matrix, by: Preconditioner, b: Array, x: Array, tolerance: float, share: float, most: int,
    room: Array,
) -> int:  # fmt: skip
    """Solve A x = b by conjugate gradients from zero on.

    It ends where the preconditioner takes what is left for a change of x of at most `tolerance`, or of at
    most this `share` of the first guess, in the largest component.

    Args:
        matrix: A.
        by: What stands for its inverse.
        b: Shape (3 f,).
        x: Shape (3 f,), written.
        tolerance: In the unit of x.
        share: Relative tolerance.
        most: Largest number of iterations.
        room: Shape (4, 3 f).

    Returns:
        The number of iterations; -1: not reached in `most`; -2: A or its preconditioner is not positive.
    """
    r, z, p, q = room[0], room[1], room[2], room[3]
    size = len(b)
    x[:] = 0.0
    scale = largest(b)
    if scale == 0.0:
        return 0
    if not scale < np.inf:
        return -2
    r[:] = b
    precondition(by, scale, r, z)
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
        multiply(matrix, p, q)
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
        precondition(by, scale, r, z)
        before, left = left, 0.0
        for i in range(size):
            left += r[i] * z[i]
        ratio = left / before
        for i in range(size):
            p[i] = z[i] + ratio * p[i]
    return -1


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


def matrix_of(panels: Array, layout: Plan) -> Matrix:
    """The matrix in the panels of a `matrix_layout`."""
    count = len(layout.position)
    owner = np.repeat(np.arange(count), np.diff(layout.first_row))
    inside = layout.row_index < 3 * count
    start = np.concatenate([[0], np.cumsum(np.bincount(owner[inside], minlength=count) // 3)])
    node = layout.row_index[inside][::3] // 3
    return Matrix(panels, layout.panel[:-1], layout.width, layout.later, start, node)
