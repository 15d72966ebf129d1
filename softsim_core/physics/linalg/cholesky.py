"""Compiled supernodal multifrontal Cholesky factorisation, with forward and backward solves.

A block of rows is factored and copied into strips of columns. Its contribution to all later rows is computed
strip by strip, so that both strips of each pair are in the cache. Panels that fit in the cache need no
strips, see cholesky.factor_part.

Source: Goto and van de Geijn 2008, Anatomy of high-performance matrix multiplication.

The layout is that of symbolic.Plan: a panel row has [own columns | later unknowns | border | right-hand
side].
"""

from __future__ import annotations

from math import sqrt
from typing import Final, cast

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.linalg.compile import kernel
from softsim_core.physics.linalg.instructions import (
    LANES,
    ROWS,
    add_to,
    dot_product,
    solve_rows,
    tile_one,
    tile_two,
)
from softsim_core.physics.linalg.symbolic import Factor, Tree

BLOCK = 128
"""Rows of a block."""

STRIP = 2 * LANES
"""Columns of a strip; ROWS divides it."""

FITS = 1 << 15
"""Largest panel, in numbers, that is factored without blocks: 256 kB."""


@kernel
def copy_strips(
    panels: Array, start: int, width: int, count: int, length: int, strips: Array, goal: int
) -> None:
    """Copy `count` rows of `length` numbers, `width` apart, as consecutive strips, row by row in each."""
    for first in range(0, length, STRIP):
        many, place = min(STRIP, length - first), goal + first * count
        for k in range(count):
            row = start + k * width + first
            for i in range(many):
                strips[place + i] = panels[row + i]
            for i in range(many, STRIP):
                strips[place + i] = 0.0
            place += STRIP


@kernel
def subtract_strips(
    target: Array, place: int, stride: int, rows: int, strips: Array, left: int, first: int, right: int,
    length: int, count: int, upper: bool,
) -> None:  # fmt: skip
    """Subtract from target[i, j] the product of columns first + i and j of strips, over `count` rows.

    The target has rows i < `rows` of `length` numbers from `place` on; `rows` is rounded up to a multiple of
    ROWS. The strips with the columns of i begin at `left`, those with the columns of j at `right`. With
    `upper`, i and j have the same numbering, and only j >= i is computed.
    """
    group = 0
    while group < rows:
        end = min(rows, group + STRIP - (first + group) % STRIP)
        for j in range(group - group % STRIP if upper else 0, length, STRIP):
            b = right + j * count
            for i in range(group, end, ROWS):
                a = left + (first + i) // STRIP * STRIP * count + (first + i) % STRIP
                if j + STRIP <= length:
                    tile_two(target, place + i * stride + j, stride, strips, a, b, STRIP, count)
                else:
                    tile_one(target, place + i * stride + j, stride, strips, a, b, STRIP, count)
        group = end


@kernel
def strips_length(width: int) -> int:
    """Return how many numbers the strips of a block need for panels of a width."""
    return BLOCK * (width + 2 * STRIP)


@kernel
def subtract_block(
    panels: Array, begin: int, width: int, low: int, high: int, rows: int, later: int, side: int,
    stack: Array, top: int, strips: Array,
) -> None:  # fmt: skip
    """Subtract the product of panel rows low .. high from later rows.

    These are the later rows of the panel, up to `rows`, and the rows of its update. The update lies in
    `stack` from `top`, in `side` rows of width - later numbers.
    """
    count, pitch, own = high - low, width - later, later - high
    beyond = (own + STRIP - 1) // STRIP * STRIP * count
    line = begin + low * width
    copy_strips(panels, line + high, width, count, own, strips, 0)
    copy_strips(panels, line + later, width, count, pitch, strips, beyond)
    place, left = begin + high * width, rows - high
    subtract_strips(panels, place + high, width, left, strips, 0, 0, 0, own, count, True)
    subtract_strips(panels, place + later, width, left, strips, 0, 0, beyond, pitch, count, False)
    subtract_strips(stack, top, pitch, side, strips, beyond, 0, beyond, pitch, count, True)


ZERO: Final = cast(int, np.int64(0))
"""Zero for kernels: Numba would compile another version of a kernel for each literal argument."""


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
    """Subtract source^T source over `count` rows from rows row .. row + ROWS of target, from the diagonal."""
    j = row - row % LANES
    start = place + row * stride
    while j + 2 * LANES <= length:
        tile_two(target, start + j, stride, source, first + row, first + j, pitch, count)
        j += 2 * LANES
    if j < length:
        tile_one(target, start + j, stride, source, first + row, first + j, pitch, count)


@kernel
def factor_rows(panels: Array, begin: int, width: int, row: int, end: int, coefficients: Array) -> None:
    """Factor ROWS panel rows from `row` on up to column `end`, already updated by the rows above them."""
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
    solve_rows(panels, start + skip, width, coefficients, end - skip)


@kernel
def add_update(
    tree: Tree, child: int, stack: Array, own: int, later: int, width: int, panels: Array, panel: int, goal:
        Array,
    top: int, pitch: int, low: int, high: int,
) -> None:  # fmt: skip
    """Add a child's update (an upper triangle in the stack) to its parent's panel and update.

    The parent has `own` columns; its later unknowns start at panel column `later`; its update is in `goal`
    from `top` on, in rows of length `pitch`. Only targets from `low` to `high`, by panel column, are updated.
    """
    side, length = tree.side[child], tree.width[child] - tree.later[child]
    begin = tree.update[child]
    first, end = tree.first_run[child], tree.first_run[child + 1]
    for r in range(first, end):
        above = max(0, low - tree.runs[r, 1])
        for i in range(above, min(tree.runs[r, 2], high - tree.runs[r, 1])):
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
def widest(tree: Tree, first: int, end: int) -> int:
    """Return the width of the widest panel of supernodes first .. end that is factored in blocks, else 0."""
    result = 0
    for s in range(first, end):
        if tree.panel[s + 1] - tree.panel[s] > FITS:
            result = max(result, tree.width[s])
    return result


@kernel
def factor_part(tree: Tree, store: Factor, first_supernode: int, end: int) -> None:
    """Factor the panels of supernodes first_supernode .. end; their children are factored or among them."""
    panels, stack = store.panels, store.stack
    coefficients = np.zeros(ROWS * ROWS, panels.dtype)
    strips = np.empty(strips_length(widest(tree, first_supernode, end)), panels.dtype)
    for s in range(first_supernode, end):
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        pitch, top, side = width - later, tree.update[s], tree.side[s]
        for i in range(pitch * (side + (-side) % ROWS)):
            stack[top + i] = 0.0
        for c in range(tree.first_child[s], tree.first_child[s + 1]):
            child = tree.children[c]
            add_update(tree, child, stack, own, later, width, panels, begin, stack, top, pitch, ZERO, width)
        rows = own + (-own) % ROWS
        for i in range(own, rows):  # padding rows are rows of the identity
            panels[begin + i * width + i] = 1.0
        fits = rows * width <= FITS
        block = rows if fits else BLOCK
        for low in range(0, rows, block):
            high = min(rows, low + block)
            for i in range(low, high, ROWS):
                subtract_products(panels, begin, width, i, panels, begin + low * width, width, i - low, width)
                factor_rows(panels, begin, width, i, width, coefficients)
            if not fits:
                subtract_block(panels, begin, width, low, high, rows, later, side - 1, stack, top, strips)
        if fits:
            for i in range(0, side - 1, ROWS):
                subtract_products(stack, top, pitch, i, panels, begin + later, width, rows, pitch)


@kernel
def gather_schur(tree: Tree, store: Factor) -> None:
    """Add the factored panels' contribution to the dense unknowns to store.schur."""
    size = len(tree.columns)
    border, pitch = store.schur.reshape(-1), store.schur.shape[1]
    for c in range(tree.first_child[size], tree.first_child[size + 1]):
        child = tree.children[c]
        add_update(
            tree, child, store.stack, ZERO, ZERO, ZERO, store.panels, ZERO, border, ZERO, pitch, ZERO, pitch
        )


@kernel
def factor(tree: Tree, store: Factor) -> None:
    """Factor all panels and solve forward; the Schur complement of the dense unknowns is in store.schur.

    All arrays of the store have one type, float64 or float32.
    """
    factor_part(tree, store, ZERO, len(tree.columns))
    gather_schur(tree, store)


@kernel
def solve_backward(tree: Tree, store: Factor) -> None:
    """Compute store.solution of the free unknowns; its tail must already have the border's."""
    panels, solution, gathered = store.panels, store.solution, store.gathered
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


@kernel
def subtract_tiles(
    target: Array, place: int, stride: int, source: Array, a: int, b: int, pitch: int, count: int, length: int
) -> None:
    """Subtract the sum over `count` rows of source[a + i] source[b + j] from ROWS rows of target[i, j].

    The rows have `length` numbers.
    """
    j = 0
    while j + 2 * LANES <= length:
        tile_two(target, place + j, stride, source, a, b + j, pitch, count)
        j += 2 * LANES
    if j < length:
        tile_one(target, place + j, stride, source, a, b + j, pitch, count)


def forward_space(tree: Tree, columns: int) -> int:
    """Return how many numbers `space` of forward_rows needs for a number of padded columns."""
    widest = int(tree.width.max(initial=0))
    strips = BLOCK * (widest + columns + 3 * STRIP)
    return FITS + (widest + 3 * ROWS) * columns + BLOCK * (BLOCK + columns) + strips


@kernel
def solve_block(
    space: Array, begin: int, right: int, line: int, count: int, length: int, coefficients: Array
) -> None:
    """Substitute forward: `count` columns of a factor at `begin`, `length` right-hand sides at `right`.

    Rows of both are `line` numbers apart.
    """
    for i in range(0, count, ROWS):
        subtract_tiles(space, right + i * line, line, space, begin + i, right, line, i, length)
        for a in range(ROWS):
            for b in range(a):
                coefficients[ROWS * a + b] = space[begin + (i + b) * line + i + a]
            coefficients[ROWS * a + a] = 1.0 / space[begin + (i + a) * line + i + a]
        solve_rows(space, right + i * line, line, coefficients, length)


@kernel
def forward_blocks(
    tree: Tree, panels: Array, s: int, low: int, high: int, rows: Array, pitch: int, space: Array,
    goal: Array, coefficients: Array,
) -> None:  # fmt: skip
    """Do the work of forward_rows for one large supernode, block by block of its rows.

    `space` has its rows of Y, those of later unknowns, one block side by side, and that block's strips.
    """
    own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
    coupled, first, place = tree.side[s] - 1, tree.first_row[s], tree.first_column[s]
    count, length = own + (-own) % ROWS, high - low
    scratch = count * length
    beside = scratch + (coupled + (-coupled) % ROWS) * length
    strips = beside + BLOCK * (BLOCK + length)
    for k in range(own):
        for i in range(length):
            space[k * length + i] = rows[(place + k) * pitch + low + i]
    for i in range(own * length, beside):
        space[i] = 0.0
    for top in range(0, count, BLOCK):
        many = min(BLOCK, count - top)
        line, end = many + length, top + many
        for k in range(many):
            for i in range(many):
                space[beside + k * line + i] = panels[begin + (top + k) * width + top + i]
            for i in range(length):
                space[beside + k * line + many + i] = space[(top + k) * length + i]
        solve_block(space, beside, beside + many, line, many, length, coefficients)
        for k in range(many):
            for i in range(length):
                space[(top + k) * length + i] = space[beside + k * line + many + i]
        right = strips
        copy_strips(space, top * length, length, many, length, space, right)
        left = right + many * (length + (-length) % STRIP)
        copy_strips(panels, begin + top * width + end, width, many, own - end, space, left)
        subtract_strips(
            space, end * length, length, count - end, space, left, ZERO, right, length, many, False
        )
        copy_strips(panels, begin + top * width + later, width, many, coupled, space, left)
        subtract_strips(space, scratch, length, coupled, space, left, ZERO, right, length, many, False)
        subtract_strips(goal, low * pitch + low, pitch, length, space, right, ZERO, right, length, many, True)
    for k in range(own):
        for i in range(length):
            rows[(place + k) * pitch + low + i] = space[k * length + i]
    for j in range(coupled):
        add_to(rows, tree.row_index[first + j] * pitch + low, space, scratch + j * length, length)


@kernel
def forward_rows(
    tree: Tree, store: Factor, spans: IndexArray, spread: Array, space: Array, product: Array
) -> None:
    """Compute Y = L^-1 H^T in place, the border's rows H_b^T - A_bi A^-1 H^T, and -Y^T Y (upper triangle).

    A supernode's panel rows and its rows of Y are copied side by side to `space`, where tiles use both, large
    ones in blocks. All arrays have one type, float64 or float32. `space` has
    forward_space numbers.
    """
    panels, rows, pitch = store.panels, spread.reshape(-1), spread.shape[1]
    goal = product.reshape(-1)
    product[:] = 0.0
    coefficients = np.zeros(ROWS * ROWS, panels.dtype)
    for s in range(len(tree.columns)):
        low, high = spans[s, 0], spans[s, 1]
        if low >= high:
            continue
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        coupled, first, place = tree.side[s] - 1, tree.first_row[s], tree.first_column[s]
        count, length = own + (-own) % ROWS, high - low
        line = width + length
        if count * line + ROWS * length > FITS:
            forward_blocks(tree, panels, s, low, high, rows, pitch, space, goal, coefficients)
            continue
        for k in range(count):
            for i in range(width):
                space[k * line + i] = panels[begin + k * width + i]
            for i in range(length):
                space[k * line + width + i] = rows[(place + k) * pitch + low + i] if k < own else 0.0
        solve_block(space, ZERO, width, line, count, length, coefficients)
        for k in range(own):
            for i in range(length):
                rows[(place + k) * pitch + low + i] = space[k * line + width + i]
        scratch = count * line
        for j in range(0, coupled, ROWS):
            for i in range(ROWS * length):
                space[scratch + i] = 0.0
            subtract_tiles(space, scratch, length, space, later + j, width, line, count, length)
            for i in range(min(ROWS, coupled - j)):
                to = tree.row_index[first + j + i] * pitch + low
                add_to(rows, to, space, scratch + i * length, length)
        for i in range(0, length, ROWS):
            subtract_products(goal, low * pitch + low, pitch, i, space, width, line, count, length)


@kernel
def solve_columns(tree: Tree, store: Factor, spread: Array, count: int) -> None:
    """Compute L^-T of the first `count` columns of `spread` (unknowns, padded) in place.

    Dense ones are solved.
    """
    first = 0
    for s in range(len(tree.columns)):
        first += tree.columns[s]
    for c in range(count):
        for s in range(len(tree.columns)):
            right = tree.panel[s] + tree.later[s] + tree.side[s] - 1
            for k in range(tree.columns[s]):
                store.panels[right + k * tree.width[s]] = spread[tree.first_column[s] + k, c]
        for b in range(first, len(spread)):
            store.solution[b] = spread[b, c]
        solve_backward(tree, store)
        for k in range(first):
            spread[k, c] = store.solution[k]
