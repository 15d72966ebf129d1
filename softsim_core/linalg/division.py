"""Parts of an elimination tree that threads work on side by side, and the supernodes above them.

The parts are subtrees of about the same cost, neighbours taken together; what stands above them is done
supernode by supernode, large ones in pieces. All that depends on the tree alone, not on the threads.
"""

from __future__ import annotations

import heapq
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.linalg.symbolic import Plan, padded, plan_stack

PARTS = 24
"""A subtree costs at most this part of the whole, unless it is a single supernode."""


class Division(NamedTuple):
    """See the module.

    Attributes:
        first, end: Supernodes of each part, shape (p,); the costly parts come first.
        above: Supernodes above all parts, ascending, shape (a,).
        first_row: Where the rows of each part begin in `row`; the last one ends them, shape (p + 1,).
        row: Unknowns above that each part is coupled to.
    """

    first: IndexArray
    end: IndexArray
    above: IndexArray
    first_row: IndexArray
    row: IndexArray


WORTHWHILE = 3e8
"""Flops of a factorisation, some 10 ms, above which several threads are worth waking."""


def undivided(plan: Plan) -> Division:
    """The whole tree as one part."""
    none = np.zeros(0, np.int64)
    return Division(np.zeros(1, np.int64), np.array([len(plan.columns)]), none, np.zeros(2, np.int64), none)


def factor_flops(plan: Plan) -> Array:
    """Multiplications and additions of each supernode's elimination, shape (s,)."""
    own, coupled = plan.columns.astype(float), plan.side - 1.0
    return np.asarray(own * (own + 1.0) * (2.0 * own + 1.0) / 6.0 + own * coupled * (own + coupled))


def divided(plan: Plan, worthwhile: float | None = None) -> Division:
    """The parts of a plan's tree; of one with less to do, the whole. `worthwhile` None: WORTHWHILE."""
    size = len(plan.columns)
    first, whole = np.arange(size), factor_flops(plan)
    if whole.sum() <= (WORTHWHILE if worthwhile is None else worthwhile):
        return undivided(plan)
    children: list[list[int]] = [[] for _ in range(size)]
    roots = []
    for s, p in enumerate(plan.parent.tolist()):  # children come before their parents
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
    """Unknowns of free nodes beyond supernodes first .. end that these are coupled to."""
    low = plan.first_column[end - 1] + plan.columns[end - 1]
    rows = np.unique(plan.row_index[plan.first_row[first] : plan.first_row[end]])
    return np.asarray(rows[(rows >= low) & (rows < 3 * len(plan.position))])


def with_room_for(plan: Plan, division: Division, tile_rows: int) -> Plan:
    """The plan with a stack in which the parts' updates lie apart; those above them use room that is left.

    What a part leaves for supernodes above it, or for the unknowns after all of them, stays where it is.
    """
    needs, update, end = padded(plan.side, tile_rows) * (plan.width - plan.later), plan.update.copy(), 0
    left = [np.zeros(0, np.int64)]
    for low, high in zip(division.first.tolist(), division.end.tolist(), strict=True):
        end = plan_stack(np.arange(low, high), needs, plan.parent, update, end)
        above = plan.parent[low:high]
        left.append(low + np.flatnonzero((above >= high) | (above < 0)))
    beyond = plan_stack(division.above, needs, plan.parent, update, waiting=np.concatenate(left))
    return replace(plan, update=update, stack_size=max(end, beyond))
