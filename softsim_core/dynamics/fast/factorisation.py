"""Compiled supernodal multifrontal Cholesky factorisation, forward solve on the way, and backward solve.

The layout is that of symbolic.Plan: a panel row holds [own columns | later unknowns | border | right-hand
side].
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from softsim_core.arrays import Array
from softsim_core.dynamics.fast.compile import kernel
from softsim_core.dynamics.fast.layout import Tree, Work
from softsim_core.dynamics.fast.simd import LANES, ROWS, add_to, dot_product, solve_rows, tile_one, tile_two


@kernel
def subtract_products(
    target: Array,
    place: int,
    stride: int,
    row: int,
    source: Array,
    first: int,
    pitch: int,
    count: int,
    length: int,
) -> None:
    """Rows row .. row + ROWS of target -= source^T source over `count` rows, from the diagonal on."""
    j = row - row % LANES
    start = place + row * stride
    while j + 2 * LANES <= length:
        tile_two(target, start + j, stride, source, first + row, first + j, pitch, count)
        j += 2 * LANES
    if j < length:
        tile_one(target, start + j, stride, source, first + row, first + j, pitch, count)


@kernel
def factor_rows(panels: Array, begin: int, width: int, row: int, coefficients: Array) -> None:
    """Factor ROWS panel rows from `row` on, already updated by the rows above them."""
    start = begin + row * width
    for i in range(ROWS):
        for j in range(i + 1):
            total = panels[start + j * width + row + i]
            for q in range(j):
                total -= coefficients[ROWS * i + q] * coefficients[ROWS * j + q]
            if i == j:
                coefficients[ROWS * i + i] = 1.0 / sqrt(total)
            else:
                coefficients[ROWS * i + j] = total * coefficients[ROWS * j + j]
    skip = row - row % LANES
    solve_rows(panels, start + skip, width, coefficients, width - skip)


@kernel
def add_update(
    tree: Tree, child: int, stack: Array, own: int, later: int, width: int, panels: Array, panel: int, goal:
        Array,
    top: int, pitch: int,
) -> None:  # fmt: skip
    """Add a child's update (an upper triangle in the stack) to its parent's panel and update.

    The parent has `own` columns; its later unknowns start at panel column `later`; `goal` holds its update
    from `top`, in rows of length `pitch`.
    """
    side, length = tree.side[child], tree.width[child] - tree.later[child]
    begin = tree.update[child]
    first, end = tree.first_run[child], tree.first_run[child + 1]
    for r in range(first, end):
        for i in range(tree.runs[r, 2]):
            row, target = tree.runs[r, 0] + i, tree.runs[r, 1] + i
            if row == side - 1:
                return  # the right-hand side has no row
            base = begin + row * length
            in_panel = target < own
            line = panel + target * width if in_panel else top + (target - later) * pitch - later
            for q in range(r, end):
                start, where, count = tree.runs[q, 0], tree.runs[q, 1], tree.runs[q, 2]
                if q == r:
                    start, where, count = row, target, count - i
                if in_panel:
                    add_to(panels, line + where, stack, base + start, count)
                else:
                    add_to(goal, line + where, stack, base + start, count)


@kernel
def factor(tree: Tree, work: Work) -> None:
    """Factor all panels and solve forward; the border's matrix and right-hand side end in work.schur."""
    panels, stack = work.panels, work.stack
    size = len(tree.columns)
    coefficients = np.zeros(ROWS * ROWS)
    for s in range(size):
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        pitch, top, side = width - later, tree.update[s], tree.side[s]
        for i in range(pitch * (side + (-side) % ROWS)):
            stack[top + i] = 0.0
        for c in range(tree.first_child[s], tree.first_child[s + 1]):
            add_update(tree, tree.children[c], stack, own, later, width, panels, begin, stack, top, pitch)
        rows = own + (-own) % ROWS
        for i in range(own, rows):  # padding rows are those of the identity
            panels[begin + i * width + i] = 1.0
        for i in range(0, rows, ROWS):
            subtract_products(panels, begin, width, i, panels, begin, width, i, width)
            factor_rows(panels, begin, width, i, coefficients)
        for i in range(0, side - 1, ROWS):
            subtract_products(stack, top, pitch, i, panels, begin + later, width, rows, pitch)
    border, pitch = work.schur.reshape(-1), work.schur.shape[1]
    for c in range(tree.first_child[size], tree.first_child[size + 1]):
        add_update(tree, tree.children[c], stack, 0, 0, 0, panels, 0, border, 0, pitch)


@kernel
def solve_backward(tree: Tree, work: Work) -> None:
    """Fill work.solution of the free unknowns; its tail already holds the border's."""
    panels, solution, gathered = work.panels, work.solution, work.gathered
    for s in range(len(tree.columns) - 1, -1, -1):
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        coupled, first, goal = tree.side[s] - 1, tree.first_row[s], tree.first_column[s]
        for j in range(coupled):
            gathered[j] = solution[tree.row_index[first + j]]
        for k in range(own):
            row = begin + k * width + later
            solution[goal + k] = panels[row + coupled] - dot_product(panels, row, gathered, 0, coupled)
        for k in range(own - 1, -1, -1):
            row = begin + k * width
            total = solution[goal + k]
            for j in range(k + 1, own):
                total -= panels[row + j] * solution[goal + j]
            solution[goal + k] = total / panels[row + k]
