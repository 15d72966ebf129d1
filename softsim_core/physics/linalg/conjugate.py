"""Conjugate gradients with a factor in single precision as preconditioner, on several threads.

The contributions of each part's rows to unknowns above all parts are stored separately, and added part by
part once all are done, so that sums have the same order for any number of threads. Large panels above the
parts are read in pieces: blocks of rows, and for each block the further columns (forward) or the rows (back)
in strips.

Source: Hestenes and Stiefel 1952; Saad 2003, Iterative Methods for Sparse Linear Systems, chapter 9.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.linalg.cholesky import ZERO
from softsim_core.physics.linalg.compile import kernel
from softsim_core.physics.linalg.divided_factor import Division
from softsim_core.physics.linalg.instructions import ROWS
from softsim_core.physics.linalg.products import (
    Matrix,
    Preconditioner,
    SingleArray,
    multiply_rows,
    solve_back,
    solve_forward,
    turn_back,
    turn_on,
)
from softsim_core.physics.linalg.symbolic import Tree
from softsim_core.physics.linalg.threads import (
    CLOSED,
    await_others,
    claim,
    claim_or_leave,
    order,
    publish,
    report,
)

MULTIPLY, FORWARD, COLUMNS, LINES, BACK = (cast(int, np.int64(kind)) for kind in range(5))
"""Kinds of phases."""

BLOCK = 128
"""Rows of a large panel that are solved before other threads take part; a multiple of ROWS."""

WIDE = 512
"""Number of columns per task."""

DEEP = 16
"""Number of rows per task."""

LARGE = 1 << 16
"""Size of a panel, in numbers, above which it is read in pieces: 256 kB, some 20 us."""


class Sharing(NamedTuple):
    """Data that threads share.

    Attributes:
        division: Division of the preconditioner's tree.
        beyond, single_beyond: Contribution of each part to unknowns above, by unknown, shape (p, 3 f); zero
            between two products. Without unknowns above, the shape is (p, 0).
        room: r, z, p and q of conjugate gradients, shape (4, 3 f).
        scale: See products.turn_back, shape (1,).
    """

    division: Division
    beyond: Array
    single_beyond: SingleArray
    work: Array
    scale: Array


def sharing_of(division: Division, unknowns: int) -> Sharing:
    """Return the shared data for a divided tree with a number of unknowns."""
    shape = (len(division.first), unknowns if len(division.above) else 0)
    beyond, work = np.zeros(shape), np.zeros((4, unknowns))
    return Sharing(division, beyond, np.zeros(shape, np.float32), work, np.ones(1))


@kernel
def nodes_of(tree: Tree, first: int, end: int) -> tuple[int, int]:
    """Return the first node of supernodes first .. end, and the end of their nodes."""
    return tree.first_column[first] // 3, (tree.first_column[end - 1] + tree.columns[end - 1]) // 3


@kernel
def product_task(
    matrix: Matrix, by: Preconditioner, sharing: Sharing, line: SingleArray, kind: int, s: int, low: int,
    task: int,
) -> None:  # fmt: skip
    """Run one task of a phase for supernode `s` with the block that starts at row `low`.

    `line` is a buffer as that of Preconditioner.
    """
    tree, parts, above = by.tree, sharing.division, sharing.division.above
    r, z, p, q = sharing.work[0], sharing.work[1], sharing.work[2], sharing.work[3]
    scale = sharing.scale[0]
    if kind == COLUMNS:
        first = block_end(tree, s, low) + task * WIDE
        subtract_columns(tree, by.panels, s, low, first, min(first + WIDE, panel_end(tree, s)), by.line)
    elif kind == LINES:
        first = low + task * DEEP
        subtract_lines(tree, by.panels, s, first, min(first + DEEP, block_end(tree, s, low)), low, by.line)
    elif task < len(parts.first):
        start, stop = parts.first[task], parts.end[task]
        first, end = nodes_of(tree, start, stop)
        if kind == MULTIPLY:
            q[3 * first : 3 * end] = 0.0
            multiply_rows(matrix, p, q, first, end, sharing.beyond[task])
        elif kind == FORWARD:
            turn_back(by, scale, r, first, end)
            solve_forward(tree, by.panels, by.column, line, start, stop, sharing.single_beyond[task])
        else:
            solve_back(tree, by.panels, by.column, line, start, stop)
            turn_on(by, scale, z, first, end)
    else:  # the nodes above all parts
        for a in range(len(above)):
            first, end = nodes_of(tree, above[a], above[a] + 1)
            if kind == MULTIPLY:
                q[3 * first : 3 * end] = 0.0
            elif kind == FORWARD:
                turn_back(by, scale, r, first, end)
            else:
                turn_on(by, scale, z, first, end)
        if kind == MULTIPLY:
            for a in range(len(above)):
                first, end = nodes_of(tree, above[a], above[a] + 1)
                multiply_rows(matrix, p, q, first, end, q)


@kernel
def panel_end(tree: Tree, s: int) -> int:
    """Return the end of the numbers of a panel row, without the right-hand side."""
    end: int = tree.later[s] + tree.side[s] - 1
    return end


@kernel
def block_end(tree: Tree, s: int, low: int) -> int:
    """Return the end of the block of a panel that begins at row `low`; rows are padded to ROWS."""
    own: int = tree.columns[s]
    return min(low + BLOCK, own + (-own) % ROWS)


@kernel
def subtract_columns(
    tree: Tree, panels: SingleArray, s: int, low: int, first: int, end: int, line: SingleArray
) -> None:
    """Subtract the contribution of a block's solved rows from columns first .. end of the line."""
    width = tree.width[s]
    for k in range(low, block_end(tree, s, low), ROWS):
        a = tree.panel[s] + k * width
        b, c, d = a + width, a + 2 * width, a + 3 * width
        y0, y1, y2, y3 = line[k], line[k + 1], line[k + 2], line[k + 3]
        for j in range(first, end):
            line[j] -= panels[a + j] * y0 + panels[b + j] * y1 + panels[c + j] * y2 + panels[d + j] * y3


@kernel
def subtract_lines(
    tree: Tree, panels: SingleArray, s: int, first: int, last: int, low: int, line: SingleArray
) -> None:
    """Subtract the contribution of the columns after a block from its rows first .. last.

    The block begins at row `low`.
    """
    width, beyond, end = tree.width[s], block_end(tree, s, low), panel_end(tree, s)
    for k in range(first, last, ROWS):
        a = tree.panel[s] + k * width
        b, c, d = a + width, a + 2 * width, a + 3 * width
        t0, t1, t2, t3 = line[k], line[k + 1], line[k + 2], line[k + 3]
        for j in range(beyond, end):
            value = line[j]
            t0 -= panels[a + j] * value
            t1 -= panels[b + j] * value
            t2 -= panels[c + j] * value
            t3 -= panels[d + j] * value
        line[k], line[k + 1], line[k + 2], line[k + 3] = t0, t1, t2, t3


@kernel
def solve_block_forward(
    panels: SingleArray, begin: int, width: int, low: int, high: int, line: SingleArray
) -> None:
    """Replace rows low .. high of the line by L^-1 times them, in their own columns."""
    for k in range(low, high):
        row = begin + k * width
        value = line[k] / panels[row + k]
        line[k] = value
        for j in range(k + 1, high):
            line[j] -= panels[row + j] * value


@kernel
def solve_block_back(
    panels: SingleArray, begin: int, width: int, low: int, high: int, line: SingleArray
) -> None:
    """Replace rows low .. high of the line by L^-T times them, in their own columns."""
    for k in range(high - 1, low - 1, -1):
        row = begin + k * width
        total = line[k]
        for j in range(k + 1, high):
            total -= panels[row + j] * line[j]
        line[k] = total / panels[row + k]


@kernel
def product_phase(
    matrix: Matrix, by: Preconditioner, sharing: Sharing, agenda: IndexArray, kind: int, s: int, low: int,
    count: int,
) -> None:  # fmt: skip
    """Publish a phase, take part in it, and wait until it is done."""
    publish(agenda, kind, s, low, count)
    task = claim(agenda)
    while task >= 0:
        product_task(matrix, by, sharing, by.line, kind, s, low, task)
        report(agenda)
        task = claim(agenda)
    await_others(agenda)


@kernel
def support_products(matrix: Matrix, by: Preconditioner, sharing: Sharing, agenda: IndexArray) -> None:
    """Take tasks of conjugate gradients from the agenda until it closes, as a supporting thread."""
    line = np.zeros(len(by.line), np.float32)
    task = claim_or_leave(agenda)
    while task != CLOSED:
        kind, s, low = order(agenda)
        product_task(matrix, by, sharing, line, kind, s, low, task)
        report(agenda)
        task = claim_or_leave(agenda)


@kernel
def multiply(matrix: Matrix, by: Preconditioner, sharing: Sharing, agenda: IndexArray) -> None:
    """Write A p to q."""
    parts = sharing.division
    product_phase(matrix, by, sharing, agenda, MULTIPLY, ZERO, ZERO, len(parts.first) + 1)
    q, beyond = sharing.work[3], sharing.beyond
    for t in range(len(parts.first)):
        for e in range(parts.first_row[t], parts.first_row[t + 1]):
            unknown = parts.row[e]
            q[unknown] += beyond[t, unknown]
            beyond[t, unknown] = 0.0


@kernel
def precondition(
    matrix: Matrix, by: Preconditioner, sharing: Sharing, scale: float, agenda: IndexArray
) -> None:
    """Write R L^-T L^-1 R^T r to z; r / `scale` must fit into single precision."""
    tree, panels, column, line, parts = by.tree, by.panels, by.column, by.line, sharing.division
    sharing.scale[0] = scale
    product_phase(matrix, by, sharing, agenda, FORWARD, ZERO, ZERO, len(parts.first) + 1)
    beyond = sharing.single_beyond
    for t in range(len(parts.first)):
        for e in range(parts.first_row[t], parts.first_row[t + 1]):
            unknown = parts.row[e]
            column[unknown] += beyond[t, unknown]
            beyond[t, unknown] = np.float32(0.0)
    for a in range(len(parts.above)):
        s = parts.above[a]
        if tree.panel[s + 1] - tree.panel[s] <= LARGE:
            solve_forward(tree, panels, column, line, s, s + 1, column)
            continue
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        first, row, end = tree.first_column[s], tree.first_row[s], panel_end(tree, s)
        line[:end] = np.float32(0.0)
        line[:own] = column[first : first + own]
        for low in range(0, own, BLOCK):
            high = block_end(tree, s, low)
            solve_block_forward(panels, begin, width, low, high, line)
            tasks = (end - high + WIDE - 1) // WIDE
            if tasks > 0:
                product_phase(matrix, by, sharing, agenda, COLUMNS, s, low, tasks)
        column[first : first + own] = line[:own]
        for j in range(later, end):
            column[tree.row_index[row + j - later]] += line[j]
    for a in range(len(parts.above) - 1, -1, -1):
        s = parts.above[a]
        if tree.panel[s + 1] - tree.panel[s] <= LARGE:
            solve_back(tree, panels, column, line, s, s + 1)
            continue
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        first, row, end = tree.first_column[s], tree.first_row[s], panel_end(tree, s)
        line[:end] = np.float32(0.0)
        line[:own] = column[first : first + own]
        for j in range(later, end):
            line[j] = column[tree.row_index[row + j - later]]
        for low in range(own - 1 - (own - 1) % BLOCK, -1, -BLOCK):
            high = block_end(tree, s, low)
            if high < end:
                product_phase(matrix, by, sharing, agenda, LINES, s, low, (high - low + DEEP - 1) // DEEP)
            solve_block_back(panels, begin, width, low, high, line)
        column[first : first + own] = line[:own]
    product_phase(matrix, by, sharing, agenda, BACK, ZERO, ZERO, len(parts.first) + 1)


@kernel
def largest(x: Array) -> float:
    """Return the largest magnitude; NaN if there is one."""
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
    """Solve A x = b by conjugate gradients, starting from zero.

    It stops when the preconditioner estimates the remaining change of x, in the largest component, as at most
    `tolerance` or at most this `share` of the first guess.

    Args:
        matrix: A.
        by: The preconditioner.
        sharing: Data that threads share, see Sharing.
        b: Right-hand side, shape (3 f,).
        x: Solution, shape (3 f,), written.
        tolerance: Absolute tolerance in the unit of x.
        share: Relative tolerance.
        most: Largest number of iterations.
        agenda: Agenda of tasks for the other threads.

    Returns:
        The number of iterations; -1: not converged in `most`; -2: A or its preconditioner is not positive.
    """
    work = sharing.work
    r, z, p, q = work[0], work[1], work[2], work[3]
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
            for i in range(size):  # the preconditioned residual improves x at no cost
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
    """Take tasks of `conjugate_gradients` from the agenda until it closes, as a supporting thread."""
    support_products(matrix, by, sharing, agenda)


@kernel
def copy_matrix(matrix: Matrix, tree: Tree, supernode: IndexArray, panels: Array) -> None:
    """Copy the matrix into the panels of its factor; `supernode` (f,) is that of each node, by unknown."""
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
    """Set columns 0 .. width for the given supernodes and all above them, none for others, shape (s, 2)."""
    spans[:] = 0
    for s in supernodes:
        while s >= 0 and spans[s, 1] == 0:
            spans[s, 1] = width
            s = tree.parent[s]
