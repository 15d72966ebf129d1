"""Products with a symmetric matrix and with the inverse of another one's factor, a range of rows at a time.

The layout is a `symbolic.Plan` in which each node is a supernode of its own, so that all kernels that write
into the panels of a factor can write into these as well.

The matrix is in the panels of a `matrix_layout`. The factor, in single precision, is that of the matrix of
another shape of the same body. The rotation since then is undone around its solution, node by node:
R L^-T L^-1 R^T.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softsim_core.base import Array, IndexArray, unique_pairs
from softsim_core.physics.linalg.compile import kernel
from softsim_core.physics.linalg.instructions import ROWS
from softsim_core.physics.linalg.symbolic import Plan, Tree, round_up

BLOCK = 3
"""Number of unknowns of a node."""


def matrix_layout(
    position: IndexArray, edges: IndexArray, border_edges: IndexArray, border_size: int, lanes: int
) -> Plan:
    """Return the layout of a matrix: panel rows [own block | coupled later nodes | border | right-hand side].

    Args:
        position: Place of each free node in the order of unknowns, shape (f,).
        edges: Pairs of coupled free nodes, shape (e, 2), any order, repetitions allowed.
        border_edges: Pairs (free node, border unknown), shape (g, 2).
        border_size: Number of border unknowns.
        lanes: Rows are padded to a multiple of it.
    """
    count = len(position)
    placed = position[edges]
    upper = unique_pairs(np.sort(placed[placed[:, 0] != placed[:, 1]], axis=1))
    beside = unique_pairs(border_edges)
    owner = np.concatenate([np.repeat(upper[:, 0], BLOCK), position[beside[:, 0]]])
    blocks = BLOCK * upper[:, 1, None] + np.arange(BLOCK)
    unknown = np.concatenate([blocks.ravel(), BLOCK * count + beside[:, 1]])
    order = np.lexsort((unknown, owner))
    coupled = np.bincount(owner, minlength=count)
    columns, later, side = np.full(count, BLOCK), np.full(count, round_up(BLOCK, lanes)), coupled + 1
    width = later + round_up(side, lanes)
    panel = np.concatenate([[0], np.cumsum(BLOCK * width)])
    none = np.zeros(0, dtype=np.int64)
    return Plan(
        position=position,
        columns=columns,
        first_column=BLOCK * np.arange(count),
        parent=np.full(count, -1),
        later=later,
        side=side,
        width=width,
        panel=panel,
        update=np.zeros(count, dtype=np.int64),
        stack_size=0,
        first_child=np.zeros(count + 2, dtype=np.int64),
        children=none,
        first_run=np.zeros(count + 1, dtype=np.int64),
        runs=np.zeros((0, 3), dtype=np.int64),
        first_row=np.concatenate([[0], np.cumsum(coupled)]),
        row_index=unknown[order],
        supernode=position,
        row_offset=panel[position],
    )


SingleArray = NDArray[np.float32]
"""float32 array."""


class Matrix(NamedTuple):
    """A symmetric matrix of f nodes in the panels of a `matrix_layout`.

    Attributes:
        panels: Panels of the layout.
        row: Place of each node's first panel row, by unknown, shape (f,).
        width: Length of its rows, shape (f,).
        later: Panel column of its first later node, shape (f,).
        start: First later node of each node in `node`, and the end of the last, shape (f + 1,).
        node: Later nodes that each is coupled to, by unknown, in the order of its panel.
    """

    panels: Array
    row: IndexArray
    width: IndexArray
    later: IndexArray
    start: IndexArray
    node: IndexArray


class Preconditioner(NamedTuple):
    """Preconditioner R L^-T L^-1 R^T from the factor of another shape's matrix and the nodes' rotations R.

    Attributes:
        tree: Tree of the factor.
        panels: Panels of the factor, without right-hand side.
        rotations: Rotation of each node since the factor was computed, by unknown, shape (f, 3, 3).
        column: Buffer for all unknowns.
        line: Buffer for the widest panel row; each solving thread has its own.
    """

    tree: Tree
    panels: SingleArray
    rotations: Array
    column: SingleArray
    line: SingleArray


@kernel
def multiply_rows(matrix: Matrix, x: Array, y: Array, first: int, end: int, beyond: Array) -> None:
    """Add to y the product of x and the rows of nodes first .. end.

    What these rows add to later nodes goes to `beyond`.
    """
    panels, row, width, later, start, nodes = matrix
    for i in range(first, end):
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
            if j < 3 * end:
                y[j] += a00 * x0 + a10 * x1 + a20 * x2
                y[j + 1] += a01 * x0 + a11 * x1 + a21 * x2
                y[j + 2] += a02 * x0 + a12 * x1 + a22 * x2
            else:
                beyond[j] += a00 * x0 + a10 * x1 + a20 * x2
                beyond[j + 1] += a01 * x0 + a11 * x1 + a21 * x2
                beyond[j + 2] += a02 * x0 + a12 * x1 + a22 * x2
            at += 3
        y[3 * i], y[3 * i + 1], y[3 * i + 2] = y0, y1, y2


@kernel
def turn_back(by: Preconditioner, scale: float, r: Array, first: int, end: int) -> None:
    """Write R^T r of nodes first .. end to by.column; r / `scale` must fit into single precision."""
    rotations, column = by.rotations, by.column
    for n in range(first, end):
        for i in range(3):
            total = 0.0
            for j in range(3):
                total += rotations[n, j, i] * r[3 * n + j]
            column[3 * n + i] = total / scale


@kernel
def turn_on(by: Preconditioner, scale: float, z: Array, first: int, end: int) -> None:
    """Write R times by.column of nodes first .. end to z."""
    rotations, column = by.rotations, by.column
    for n in range(first, end):
        for i in range(3):
            total = 0.0
            for j in range(3):
                total += rotations[n, i, j] * column[3 * n + j]
            z[3 * n + i] = total * scale


@kernel
def solve_forward(
    tree: Tree, panels: SingleArray, x: SingleArray, line: SingleArray, first_supernode: int, end_supernode:
        int,
    beyond: SingleArray,
) -> None:  # fmt: skip
    """Replace x by L^-1 x in some supernodes, reading each panel once, ROWS rows at a time.

    Contributions to unknowns after the last of them are added to `beyond`.
    """
    limit = tree.first_column[end_supernode - 1] + tree.columns[end_supernode - 1]
    for s in range(first_supernode, end_supernode):
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
            unknown = tree.row_index[low + j]
            if unknown < limit:
                x[unknown] += line[later + j]
            else:
                beyond[unknown] += line[later + j]


@kernel
def solve_back(
    tree: Tree, panels: SingleArray, x: SingleArray, line: SingleArray, first_supernode: int, end_supernode:
        int,
) -> None:  # fmt: skip
    """Replace x by L^-T x in some supernodes, after those above, reading each panel once by ROWS rows."""
    for s in range(end_supernode - 1, first_supernode - 1, -1):
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


def matrix_of(panels: Array, layout: Plan) -> Matrix:
    """Return the matrix in the panels of a `matrix_layout`."""
    count = len(layout.position)
    owner = np.repeat(np.arange(count), np.diff(layout.first_row))
    inside = layout.row_index < 3 * count
    start = np.concatenate([[0], np.cumsum(np.bincount(owner[inside], minlength=count) // 3)])
    node = layout.row_index[inside][::3] // 3
    return Matrix(panels, layout.panel[:-1], layout.width, layout.later, start, node)
