"""Factorisation on several threads: independent parts of the elimination tree, then the supernodes above.

The parts are subtrees of about the same cost, with neighbours joined. The supernodes above them are factored
one by one, large ones in pieces. The division depends on the tree alone, not on the number of threads.

For a large panel above the parts, the updates of its children are added in strips of rows. Then, as in
cholesky, a block of rows is factored, its further columns in strips of columns, and its contribution to all
later rows is subtracted in strips of rows.
"""

from __future__ import annotations

import heapq
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.linalg.cholesky import (
    BLOCK,
    FITS,
    STRIP,
    ZERO,
    add_update,
    copy_strips,
    factor_part,
    factor_rows,
    gather_schur,
    strips_length,
    subtract_products,
    subtract_strips,
    subtract_tiles,
)
from softsim_core.physics.linalg.compile import kernel
from softsim_core.physics.linalg.instructions import LANES, ROWS, solve_rows
from softsim_core.physics.linalg.symbolic import Factor, Numbers, Plan, Tree, plan_stack, round_up
from softsim_core.physics.linalg.threads import (
    CLOSED,
    await_others,
    claim,
    claim_or_leave,
    order,
    publish,
    report,
)

PARTS = 24
"""A subtree costs at most this part of the whole, unless it is a single supernode."""


class Division(NamedTuple):
    """Division of an elimination tree into independent parts and the supernodes above them.

    Attributes:
        first, end: Supernodes of each part, shape (p,); the costly parts come first.
        above: Supernodes above all parts, ascending, shape (a,).
        first_row: First entry of each part in `row`, and the end of the last part, shape (p + 1,).
        row: Unknowns above that each part is coupled to.
    """

    first: IndexArray
    end: IndexArray
    above: IndexArray
    first_row: IndexArray
    row: IndexArray


WORTHWHILE = 3e8
"""Flops of a factorisation, some 10 ms, above which several threads are faster."""


def take_whole_tree(plan: Plan) -> Division:
    """Return the whole tree as one part."""
    none = np.zeros(0, np.int64)
    return Division(np.zeros(1, np.int64), np.array([len(plan.columns)]), none, np.zeros(2, np.int64), none)


def factor_flops(plan: Plan) -> Array:
    """Return the multiplications and additions of each supernode's elimination, shape (s,)."""
    own, coupled = plan.columns.astype(float), plan.side - 1.0
    return np.asarray(own * (own + 1.0) * (2.0 * own + 1.0) / 6.0 + own * coupled * (own + coupled))


def divide_tree(plan: Plan, worthwhile: float | None = None) -> Division:
    """Return the parts of a plan's tree, or the whole if its cost is at most `worthwhile`.

    `worthwhile` None: WORTHWHILE.
    """
    size = len(plan.columns)
    first, whole = np.arange(size), factor_flops(plan)
    if whole.sum() <= (WORTHWHILE if worthwhile is None else worthwhile):
        return take_whole_tree(plan)
    children: list[list[int]] = [[] for _ in range(size)]
    roots = []
    for s, p in enumerate(plan.parent.tolist()):  # children precede their parents
        if p >= 0:
            whole[p] += whole[s]
            first[p] = min(first[p], first[s])
            children[p].append(s)
        else:
            roots.append(s)
    limit = whole[roots].sum() / PARTS
    heap = [(-whole[s], s) for s in roots]
    heapq.heapify(heap)
    above, parts = [], []
    while heap:
        cost, s = heapq.heappop(heap)
        if -cost > limit and children[s]:
            above.append(s)
            for c in children[s]:
                heapq.heappush(heap, (-whole[c], c))
        else:
            parts.append((int(first[s]), s + 1, -cost))
    joined: list[tuple[int, int, float]] = []
    for low, high, cost in sorted(parts):
        before = joined[-1] if joined else (0, -1, 0.0)
        if before[1] == low and before[2] + cost <= limit:
            joined[-1] = before[0], high, before[2] + cost
        else:
            joined.append((low, high, cost))
    joined.sort(key=lambda part: (-part[2], part[0]))
    rows = [_rows(plan, low, high) for low, high, _ in joined]
    return Division(
        np.array([part[0] for part in joined], np.int64),
        np.array([part[1] for part in joined], np.int64),
        np.array(sorted(above), np.int64),
        np.cumsum([0] + [len(each) for each in rows]),
        np.concatenate([np.zeros(0, np.int64), *rows]),
    )


def _rows(plan: Plan, first: int, end: int) -> IndexArray:
    """Return the unknowns of free nodes beyond supernodes first .. end that these are coupled to."""
    low = plan.first_column[end - 1] + plan.columns[end - 1]
    rows = np.unique(plan.row_index[plan.first_row[first] : plan.first_row[end]])
    return np.asarray(rows[(rows >= low) & (rows < 3 * len(plan.position))])


def with_space_for(plan: Plan, division: Division, tile_rows: int) -> Plan:
    """Return the plan with a stack in which the parts' updates do not overlap.

    Those above use the remaining space.

    Updates of a part for supernodes above it, or for the unknowns after all of them, stay in place.
    """
    needs, update, end = round_up(plan.side, tile_rows) * (plan.width - plan.later), plan.update.copy(), 0
    left = [np.zeros(0, np.int64)]
    for low, high in zip(division.first.tolist(), division.end.tolist(), strict=True):
        end = plan_stack(np.arange(low, high), needs, plan.parent, update, end)
        above = plan.parent[low:high]
        left.append(low + np.flatnonzero((above >= high) | (above < 0)))
    beyond = plan_stack(division.above, needs, plan.parent, update, waiting=np.concatenate(left))
    return replace(plan, update=update, stack_size=max(end, beyond))


PART, GATHER, COLUMNS, LATER = (cast(int, np.int64(kind)) for kind in range(4))
"""Kinds of phases."""

LINES = 64
"""Rows of a panel and its update that one task gathers."""

WIDE = 8 * STRIP
"""Columns of a block that one task factors."""

DEEP = 4 * STRIP
"""Later rows from which one task subtracts."""


class PanelBuffers(NamedTuple):
    """Buffers that threads share while they factor one panel.

    Attributes:
        coefficients: For each ROWS rows of the block, see solve_rows, shape (BLOCK / ROWS, ROWS^2).
        strips: The block in strips of columns, see cholesky.copy_strips.
    """

    coefficients: Numbers
    strips: Numbers


def allocate_panels(tree: Tree, division: Division, kind: type[np.floating[Any]]) -> PanelBuffers:
    """Return buffers for the factor of a divided tree in numbers of one type."""
    widest = int(tree.width[division.above].max(initial=0))
    return PanelBuffers(np.zeros((BLOCK // ROWS, ROWS * ROWS), kind), np.zeros(strips_length(widest), kind))


@kernel
def gather_lines(tree: Tree, store: Factor, s: int, low: int, high: int) -> None:
    """Add the children's updates to lines low .. high of a panel and its update, counted by panel columns."""
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
    """Factor rows low .. high of a panel up to the column where they end."""
    end, row = high + (-high) % LANES, begin + low * width
    for i in range(low, high, ROWS):
        subtract_products(panels, begin, width, i, panels, row, width, i - low, end)
        factor_rows(panels, begin, width, i, end, coefficients[(i - low) // ROWS])


@kernel
def factor_columns(
    panels: Numbers,
    begin: int,
    width: int,
    low: int,
    high: int,
    first: int,
    end: int,
    buffers: PanelBuffers,
    goal: int,
) -> None:
    """Factor columns first .. end of rows low .. high, and copy them as strips from `goal` on."""
    row, strips, coefficients = begin + low * width, buffers.strips, buffers.coefficients
    for i in range(low, high, ROWS):
        place = begin + i * width + first
        subtract_tiles(panels, place, width, panels, row + i, row + first, width, i - low, end - first)
        solve_rows(panels, place, width, coefficients[(i - low) // ROWS], end - first)
    copy_strips(panels, row + first, width, high - low, end - first, strips, goal)


@kernel
def subtract_later(tree: Tree, store: Factor, s: int, low: int, high: int, row: int, strips: Numbers) -> None:
    """Subtract the contribution of rows low .. high from DEEP later lines from `row` on.

    Lines are those of the panel from `high` on up to its last row, in whole tasks, then those of the update.
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
    tree: Tree,
    store: Factor,
    division: Division,
    buffers: PanelBuffers,
    kind: int,
    s: int,
    low: int,
    task: int,
) -> None:
    """Run one task of a phase for supernode `s` with the block that starts at row `low`."""
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
            factor_columns(store.panels, begin, width, low, high, first, end, buffers, goal)
        else:
            subtract_later(tree, store, s, low, high, task * DEEP, buffers.strips)


@kernel
def factor_phase(
    tree: Tree,
    store: Factor,
    division: Division,
    buffers: PanelBuffers,
    agenda: IndexArray,
    kind: int,
    s: int,
    low: int,
    count: int,
) -> None:
    """Publish a phase, take part in it, and wait until it is done."""
    publish(agenda, kind, s, low, count)
    task = claim(agenda)
    while task >= 0:
        factor_task(tree, store, division, buffers, kind, s, low, task)
        report(agenda)
        task = claim(agenda)
    await_others(agenda)


@kernel
def lead_factor(
    tree: Tree, store: Factor, division: Division, buffers: PanelBuffers, agenda: IndexArray
) -> None:
    """Factor the matrix in the panels as `cholesky.factor`, as the thread that writes the agenda."""
    factor_phase(tree, store, division, buffers, agenda, PART, ZERO, ZERO, len(division.first))
    panels = store.panels
    for a in range(len(division.above)):
        s = division.above[a]
        own, later, width, begin = tree.columns[s], tree.later[s], tree.width[s], tree.panel[s]
        rows, side = own + (-own) % ROWS, tree.side[s]
        if rows * width <= FITS:
            factor_part(tree, store, s, s + 1)
            continue
        factor_phase(
            tree, store, division, buffers, agenda, GATHER, s, ZERO, (later + side + ROWS) // LINES + 1
        )
        for i in range(own, rows):  # padding rows are rows of the identity
            panels[begin + i * width + i] = 1.0
        for low in range(0, rows, BLOCK):
            high = min(rows, low + BLOCK)
            factor_triangle(panels, begin, width, low, high, buffers.coefficients)
            beside = (later - high + WIDE - 1) // WIDE if high < rows else 0
            beside += (width - later + WIDE - 1) // WIDE
            factor_phase(tree, store, division, buffers, agenda, COLUMNS, s, low, beside)
            below = (rows - high + DEEP - 1) // DEEP + (side - 1 + DEEP - 1) // DEEP
            factor_phase(tree, store, division, buffers, agenda, LATER, s, low, below)
    gather_schur(tree, store)


@kernel
def support_factor(
    tree: Tree, store: Factor, division: Division, buffers: PanelBuffers, agenda: IndexArray
) -> None:
    """Take tasks of a factorisation from the agenda until it closes, as a supporting thread."""
    task = claim_or_leave(agenda)
    while task != CLOSED:
        kind, s, low = order(agenda)
        factor_task(tree, store, division, buffers, kind, s, low, task)
        report(agenda)
        task = claim_or_leave(agenda)
