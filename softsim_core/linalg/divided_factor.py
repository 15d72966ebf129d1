"""The factorisation of a divided tree: parts side by side, then each supernode above them in pieces.

Of a large panel above the parts, the updates of its children are added in strips of rows. Then, as in
`blocks`, a block of rows is factored, its further columns in strips of columns, and what it takes off all
that comes later in strips of rows.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np

from softsim_core.arrays import IndexArray
from softsim_core.linalg.agenda import CLOSED, await_others, claim, claim_or_leave, order, publish, report
from softsim_core.linalg.blocks import BLOCK, FITS, STRIP, copy_strips, strips_length, subtract_strips
from softsim_core.linalg.cholesky import (
    ZERO,
    add_update,
    factor_part,
    factor_rows,
    gather_schur,
    subtract_products,
    subtract_tiles,
)
from softsim_core.linalg.compile import kernel
from softsim_core.linalg.division import Division
from softsim_core.linalg.layout import Factor, Numbers, Tree
from softsim_core.linalg.simd import LANES, ROWS, solve_rows

PART, GATHER, COLUMNS, LATER = (cast(int, np.int64(kind)) for kind in range(4))
"""Kinds of phases."""

LINES = 64
"""Rows of a panel and its update that one task gathers."""

WIDE = 8 * STRIP
"""Columns of a block that one task factors."""

DEEP = 4 * STRIP
"""Later rows that one task subtracts from."""


class Room(NamedTuple):
    """What the threads share while they factor one panel.

    Attributes:
        coefficients: Of each ROWS rows of the block, see simd.solve_rows, shape (BLOCK / ROWS, ROWS^2).
        strips: The block in strips of columns, see blocks.copy_strips.
    """

    coefficients: Numbers
    strips: Numbers


def room_for(tree: Tree, division: Division, kind: type[np.floating[Any]]) -> Room:
    """Room for the factor of a divided tree in numbers of one type."""
    widest = int(tree.width[division.above].max(initial=0))
    return Room(np.zeros((BLOCK // ROWS, ROWS * ROWS), kind), np.zeros(strips_length(widest), kind))


@kernel
def gather_lines(tree: Tree, store: Factor, s: int, low: int, high: int) -> None:
    """Lines low .. high of a panel and its update, counted by panel columns, take what the children leave."""
    own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
    pitch, top = width - later, tree.update[s]
    lines = tree.side[s] + (-tree.side[s]) % ROWS
    for i in range(pitch * max(0, low - later), pitch * min(lines, high - later)):
        store.stack[top + i] = 0.0
    for c in range(tree.first_child[s], tree.first_child[s + 1]):
        add_update(
            tree, tree.children[c], store.stack, own, later, width, store.panels, begin, store.stack, top,
            pitch, low, high,
        )  # fmt: skip


@kernel
def factor_triangle(
    panels: Numbers, begin: int, width: int, low: int, high: int, coefficients: Numbers
) -> None:
    """Rows low .. high of a panel up to the column where they end."""
    end, row = high + (-high) % LANES, begin + low * width
    for i in range(low, high, ROWS):
        subtract_products(panels, begin, width, i, panels, row, width, i - low, end)
        factor_rows(panels, begin, width, i, end, coefficients[(i - low) // ROWS])


@kernel
def factor_columns(
    panels: Numbers, begin: int, width: int, low: int, high: int, first: int, end: int, room: Room, goal: int
) -> None:
    """Columns first .. end of rows low .. high, and these as strips from `goal` on."""
    row, strips, coefficients = begin + low * width, room.strips, room.coefficients
    for i in range(low, high, ROWS):
        place = begin + i * width + first
        subtract_tiles(panels, place, width, panels, row + i, row + first, width, i - low, end - first)
        solve_rows(panels, place, width, coefficients[(i - low) // ROWS], end - first)
    copy_strips(panels, row + first, width, high - low, end - first, strips, goal)


@kernel
def subtract_later(tree: Tree, store: Factor, s: int, low: int, high: int, row: int, strips: Numbers) -> None:
    """What rows low .. high take off DEEP lines from `row` on: of the panel after them, or of its update.

    Lines count from `high` on up to the last row of the panel in whole tasks, then those of the update.
    """
    later, width, begin = tree.later[s], tree.width[s], tree.panel[s]
    rows, pitch, count = tree.columns[s] + (-tree.columns[s]) % ROWS, width - later, high - low
    own, left = later - high, rows - high
    beyond = (own + STRIP - 1) // STRIP * STRIP * count
    inside = (left + DEEP - 1) // DEEP * DEEP
    if row < inside:
        place, many = begin + (high + row) * width + high, min(DEEP, left - row)
        a = row * count
        subtract_strips(store.panels, place + row, width, many, strips, a, ZERO, a, own - row, count, True)
        subtract_strips(store.panels, place + own, width, many, strips, a, ZERO, beyond, pitch, count, False)
    else:
        row -= inside
        place, many = tree.update[s] + row * (pitch + 1), min(DEEP, tree.side[s] - 1 - row)
        a = beyond + row * count
        subtract_strips(store.stack, place, pitch, many, strips, a, ZERO, a, pitch - row, count, True)


@kernel
def factor_task(
    tree: Tree, store: Factor, division: Division, room: Room, kind: int, s: int, low: int, task: int
) -> None:
    """One task of a phase; `s`: the supernode, `low`: first row of its block."""
    if kind == PART:
        factor_part(tree, store, division.first[task], division.end[task])
    elif kind == GATHER:
        gather_lines(tree, store, s, task * LINES, (task + 1) * LINES)
    else:
        later, width, begin = tree.later[s], tree.width[s], tree.panel[s]
        rows = tree.columns[s] + (-tree.columns[s]) % ROWS
        high = min(rows, low + BLOCK)
        if kind == COLUMNS:
            own = later - high if high < rows else 0
            tasks = (own + WIDE - 1) // WIDE
            if task < tasks:
                first = high + task * WIDE
                end, goal = min(first + WIDE, later), task * WIDE * (high - low)
            else:
                first = later + (task - tasks) * WIDE
                end, goal = min(first + WIDE, width), (task - tasks) * WIDE * (high - low)
                goal += (later - high + STRIP - 1) // STRIP * STRIP * (high - low)
            factor_columns(store.panels, begin, width, low, high, first, end, room, goal)
        else:
            subtract_later(tree, store, s, low, high, task * DEEP, room.strips)


@kernel
def factor_phase(
    tree: Tree, store: Factor, division: Division, room: Room, agenda: IndexArray, kind: int, s: int, low:
        int,
    count: int,
) -> None:  # fmt: skip
    """Have a phase done."""
    publish(agenda, kind, s, low, count)
    task = claim(agenda)
    while task >= 0:
        factor_task(tree, store, division, room, kind, s, low, task)
        report(agenda)
        task = claim(agenda)
    await_others(agenda)


@kernel
def lead_factor(tree: Tree, store: Factor, division: Division, room: Room, agenda: IndexArray) -> None:
    """See cholesky.factor: the thread that writes the agenda."""
    factor_phase(tree, store, division, room, agenda, PART, ZERO, ZERO, len(division.first))
    panels = store.panels
    for a in range(len(division.above)):
        s = division.above[a]
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        rows, side = own + (-own) % ROWS, tree.side[s]
        if rows * width <= FITS:
            factor_part(tree, store, s, s + 1)
            continue
        factor_phase(tree, store, division, room, agenda, GATHER, s, ZERO, (later + side + ROWS) // LINES + 1)
        for i in range(own, rows):  # padding rows are those of the identity
            panels[begin + i * width + i] = 1.0
        for low in range(0, rows, BLOCK):
            high = min(rows, low + BLOCK)
            factor_triangle(panels, begin, width, low, high, room.coefficients)
            beside = (later - high + WIDE - 1) // WIDE if high < rows else 0
            beside += (width - later + WIDE - 1) // WIDE
            factor_phase(tree, store, division, room, agenda, COLUMNS, s, low, beside)
            below = (rows - high + DEEP - 1) // DEEP + (side - 1 + DEEP - 1) // DEEP
            factor_phase(tree, store, division, room, agenda, LATER, s, low, below)
    gather_schur(tree, store)


@kernel
def support_factor(tree: Tree, store: Factor, division: Division, room: Room, agenda: IndexArray) -> None:
    """See cholesky.factor: a thread that helps."""
    task = claim_or_leave(agenda)
    while task != CLOSED:
        kind, s, low = order(agenda)
        factor_task(tree, store, division, room, kind, s, low, task)
        report(agenda)
        task = claim_or_leave(agenda)
