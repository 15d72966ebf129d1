"""Symbolic factorisation, once per model: elimination order, supernodes, and the place of every number.

The unknowns are free nodes (blocks of three) followed by the border (frames, joints) and, as a last column,
the right-hand side, so that factoring also solves forward. Each supernode has one dense panel: its columns as
rows of L^T, contiguous over [own columns | later unknowns | border | right-hand side]. The border's own
matrix is the Schur complement of the elimination.

Sources: Liu 1990 (elimination trees), Duff and Reid 1983 (multifrontal), Ashcraft and Grimes 1989 (relaxed
supernodes).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from softsim_core.base import BoolArray, IndexArray
from softsim_core.physics.linalg.compile import kernel
from softsim_core.physics.linalg.ordering import (
    column_counts,
    elimination_order,
    elimination_tree,
    graph_of,
    postorder,
)

RELAXATION = ((24, 0.6), (48, 0.4), (96, 0.25), (1 << 30, 0.08))
"""Pairs of a number of columns and a share of zeros up to which supernodes are merged."""


@dataclass(slots=True, eq=False)
class Supernode:
    """Columns eliminated together.

    Attributes:
        columns: Free nodes eliminated here, by place in the elimination order.
        coupled: Scalars eliminated later, border included, that they are coupled to.
        children: Supernodes with an update for this one.
        zeros: Explicit zeros accepted so far by relaxation, in scalars.
    """

    columns: list[int]
    coupled: int
    children: list[int] = field(default_factory=list)
    zeros: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Plan of an elimination: supernodes in elimination (post) order.

    Attributes:
        position: Elimination position of each free node, shape (f,).
        columns: Scalars eliminated by each supernode, shape (s,).
        first_column: First scalar unknown of each supernode, shape (s,).
        parent: The supernode above each, or -1, shape (s,).
        later: Panel column at which the later unknowns start, shape (s,).
        side: Later unknowns of each supernode, border and right-hand side included, shape (s,).
        width: Panel row length, padded, shape (s,); updates have rows of width - later.
        panel: Offset of each panel in the panel store, shape (s + 1,).
        update: Offset of each update matrix in the stack, shape (s,).
        stack_size: Length of the stack.
        first_child: Ranges of each supernode's children, with the border as last supernode, shape (s + 2,).
        children: Supernodes in those ranges.
        first_run: Ranges of each supernode's runs, shape (s + 1,).
        runs: Rows (start in the update, start in the parent's panel, length) in those ranges, shape (r, 3).
        first_row: Ranges of each supernode's row indices, shape (s + 1,).
        row_index: Scalar unknowns (3 position + axis; 3 f + border) of the panel columns after the own ones.
        supernode: Supernode of each free node, shape (f,).
        row_offset: Offset in the panel store of the first of a free node's three panel rows, shape (f,).
    """

    position: IndexArray
    columns: IndexArray
    first_column: IndexArray
    parent: IndexArray
    later: IndexArray
    side: IndexArray
    width: IndexArray
    panel: IndexArray
    update: IndexArray
    stack_size: int
    first_child: IndexArray
    children: IndexArray
    first_run: IndexArray
    runs: IndexArray
    first_row: IndexArray
    row_index: IndexArray
    supernode: IndexArray
    row_offset: IndexArray

    def panel_columns(self, supernodes: IndexArray, unknowns: IndexArray) -> IndexArray:
        """Return the panel column of each unknown in its supernode, -1 if absent.

        `supernodes` and `unknowns` (scalar unknowns) have shape (k,).
        """
        return panel_columns(
            self.columns, self.first_column, self.later, self.first_row, self.row_index, supernodes, unknowns
        )


def plan(
    count: int,
    edges: IndexArray,
    border_edges: IndexArray,
    border_size: int,
    lanes: int,
    tile_rows: int,
    order: IndexArray | None = None,
) -> Plan:
    """Return the plan of the elimination of `count` free nodes.

    Args:
        count: Number of free nodes f.
        edges: Pairs of coupled free nodes, shape (e, 2), any order, repetitions allowed.
        border_edges: Pairs (free node, border unknown), shape (g, 2).
        border_size: Number of border unknowns.
        lanes: Rows are padded to a multiple of it.
        tile_rows: The number of rows is padded to a multiple of it.
        order: Free nodes in elimination order, shape (f,); None: a good one.
    """
    graph = graph_of(count, edges)
    order = elimination_order(graph) if order is None else order
    order = order[postorder(elimination_tree(*graph, order))]
    tree = elimination_tree(*graph, order)
    border = np.zeros((count, border_size), dtype=np.bool_)
    border[border_edges[:, 0], border_edges[:, 1]] = True
    border = border[order]
    inherit(tree, border)
    counts = column_counts(*graph, order, tree)
    supernodes, roots = _amalgamate(*_fundamental(tree, counts, border.sum(axis=1)))
    return _lay_out(graph, order, border, supernodes, roots, (lanes, tile_rows))


@kernel
def inherit(parent: IndexArray, border: BoolArray) -> None:
    """Add the border unknowns (n, b) that a position is coupled to, to those of its parent."""
    for j in range(len(parent)):
        if parent[j] >= 0:
            for b in range(border.shape[1]):
                border[parent[j], b] |= border[j, b]


@kernel
def panel_columns(
    columns: IndexArray, first_column: IndexArray, later: IndexArray, first_row: IndexArray,
    row_index: IndexArray, supernodes: IndexArray, unknowns: IndexArray,
) -> IndexArray:  # fmt: skip
    """Return the panel column of each unknown (k,) in the supernode beside it (k,), -1 if absent."""
    result = np.empty(len(unknowns), np.int64)
    for i in range(len(unknowns)):
        s = supernodes[i]
        place = unknowns[i] - first_column[s]
        if place >= columns[s] or place < 0:
            own = row_index[first_row[s] : first_row[s + 1]]
            found = np.searchsorted(own, unknowns[i])
            there = found < len(own) and own[found] == unknowns[i]
            place = later[s] + found if there else -1
        result[i] = place
    return result


def _fundamental(
    parent: IndexArray, counts: IndexArray, border: IndexArray
) -> tuple[list[Supernode], list[int]]:
    """Return fundamental supernodes and the parent of each (-1 for roots), for positions in postorder."""
    children = np.bincount(parent[parent >= 0], minlength=len(parent))
    follows = np.zeros(len(parent), dtype=bool)
    if len(parent):
        follows[1:] = (
            (parent[:-1] == np.arange(1, len(parent)))
            & (children[1:] == 1)
            & (counts[:-1] == counts[1:] + 1)
            & (border[:-1] == border[1:])
        )
    first = np.flatnonzero(~follows)
    last = np.append(first[1:], len(parent))[: len(first)] - 1
    owner = np.append(np.cumsum(~follows) - 1, -1)  # a parent of -1 has the owner -1
    parents = owner[parent[last]].tolist()
    coupled = (3 * counts + border)[last].tolist()
    supernodes = [
        Supernode(list(range(low, high + 1)), size)
        for low, high, size in zip(first.tolist(), last.tolist(), coupled, strict=True)
    ]
    for s, p in enumerate(parents):
        if p >= 0:
            supernodes[p].children.append(s)
    return supernodes, parents


def _amalgamate(supernodes: list[Supernode], parents: list[int]) -> tuple[list[Supernode], list[int]]:
    """Merge children into parents where this adds few zeros; return the supernodes and the roots' indices."""
    for parent in supernodes:  # children precede their parents
        for c in sorted(parent.children, key=lambda child: -len(supernodes[child].columns)):
            child = supernodes[c]
            own, own_parent = 3 * len(child.columns), 3 * len(parent.columns)
            zeros = child.zeros + parent.zeros + own * (own_parent + parent.coupled - child.coupled)
            merged = own + own_parent
            total = merged * (merged + 1) // 2 + merged * parent.coupled
            share = next(share for limit, share in RELAXATION if merged <= limit)
            if zeros <= share * total:
                parent.columns = child.columns + parent.columns
                parent.children.remove(c)
                parent.children.extend(child.children)
                parent.zeros = zeros
                child.columns = []
    for parent in supernodes:
        parent.columns.sort()
    return supernodes, [s for s, _ in enumerate(supernodes) if parents[s] < 0]


def _postorder(supernodes: list[Supernode], roots: list[int]) -> list[int]:
    """Return children before parents, each subtree contiguous, widest update first (for a small stack)."""
    result: list[int] = []
    stack = list(reversed(roots))
    while stack:
        s = stack.pop()
        result.append(s)
        stack.extend(sorted(supernodes[s].children, key=lambda child: -supernodes[child].coupled))
    return result[::-1]


def _lay_out(
    graph: tuple[IndexArray, IndexArray],
    order: IndexArray,
    border: BoolArray,
    supernodes: list[Supernode],
    roots: list[int],
    padding: tuple[int, int],
) -> Plan:
    """Number all supernodes and compute offsets, relative positions and the stack."""
    lanes, tile_rows = padding
    sequence = _postorder(supernodes, roots)
    number = {s: index for index, s in enumerate(sequence)}
    size, count = len(sequence), len(order)
    child_lists = [[number[c] for c in supernodes[s].children] for s in sequence] + [
        [number[r] for r in roots]
    ]
    parent = np.full(size, -1, dtype=np.int64)
    for p, below in enumerate(child_lists[:-1]):
        parent[below] = p
    columns = np.array([3 * len(supernodes[s].columns) for s in sequence], dtype=np.int64)
    coupled = np.array([supernodes[s].coupled for s in sequence], dtype=np.int64)
    placed = np.array([c for s in sequence for c in supernodes[s].columns], dtype=np.int64)
    position = np.empty(count, dtype=np.int64)
    position[order[placed]] = np.arange(count)
    first_column = np.cumsum(columns) - columns
    last = placed[(first_column + columns) // 3 - 1]
    first_row = np.concatenate([[0], np.cumsum(coupled)])
    row_index = row_unknowns(*graph, order[placed], position, border[last], columns, parent, first_row)
    later, side = round_up(columns, lanes), coupled + 1
    width = later + round_up(side, lanes)
    panel = np.concatenate([[0], np.cumsum(round_up(columns, tile_rows) * width)])
    supernode = np.repeat(np.arange(size), columns // 3)[position]
    local = 3 * position - first_column[supernode]
    update = np.zeros(size, dtype=np.int64)
    first_run, runs = runs_of(
        (columns, first_column, later, side), parent, first_row, row_index, 3 * count, border.shape[1]
    )
    return Plan(
        position=position,
        columns=columns,
        first_column=first_column,
        parent=parent,
        later=later,
        side=side,
        width=width,
        panel=panel,
        update=update,
        stack_size=plan_stack(np.arange(size), round_up(side, tile_rows) * (width - later), parent, update),
        first_child=np.cumsum([0] + [len(below) for below in child_lists]),
        children=np.array([c for below in child_lists for c in below], dtype=np.int64),
        first_run=first_run,
        runs=runs,
        first_row=first_row,
        row_index=row_index,
        supernode=supernode,
        row_offset=panel[supernode] + local * width[supernode],
    )


@kernel
def row_unknowns(
    starts: IndexArray, neighbours: IndexArray, nodes: IndexArray, position: IndexArray, border: BoolArray,
    columns: IndexArray, parent: IndexArray, first_row: IndexArray,
) -> IndexArray:  # fmt: skip
    """Return Plan.row_index: rows of the nodes eliminated in each supernode, and those passed up by children.

    `nodes` (f,) are those of the graph in elimination order, `position` is its inverse, and `border` (s, b)
    are the border unknowns of each supernode.
    """
    count, size = len(nodes), len(columns)
    result, visited = np.empty(first_row[-1], np.int64), np.full(count, -1, np.int64)
    child, following = np.full(size, -1, np.int64), np.full(size, -1, np.int64)
    found, first = np.empty(count, np.int64), 0
    for s in range(size):
        height, end = 0, first + columns[s] // 3
        for k in range(first, end):
            visited[k] = s
        for k in range(first, end):
            for e in range(starts[nodes[k]], starts[nodes[k] + 1]):
                row = position[neighbours[e]]
                if row >= end and visited[row] != s:
                    visited[row], found[height] = s, row
                    height += 1
        c = child[s]
        while c >= 0:
            for i in range(first_row[c], first_row[c + 1], 3):
                if result[i] >= 3 * count:
                    break
                row = result[i] // 3
                if row >= end and visited[row] != s:
                    visited[row], found[height] = s, row
                    height += 1
            c = following[c]
        place = first_row[s]
        for row in np.sort(found[:height]):
            for axis in range(3):
                result[place] = 3 * row + axis
                place += 1
        for b in range(border.shape[1]):
            if border[s, b]:
                result[place] = 3 * count + b
                place += 1
        if parent[s] >= 0:
            following[s], child[parent[s]] = child[parent[s]], s
        first = end
    return result


@kernel
def runs_of(
    panels: tuple[IndexArray, IndexArray, IndexArray, IndexArray], parent: IndexArray, first_row: IndexArray,
    row_index: IndexArray, first_border: int, border: int,
) -> tuple[IndexArray, IndexArray]:  # fmt: skip
    """Return Plan.first_run and Plan.runs; `panels` are Plan.columns, first_column, later and side."""
    columns, first_column, later, side = panels
    size = len(columns)
    first_run, runs, height = np.zeros(size + 1, np.int64), np.empty((len(row_index) + size, 3), np.int64), 0
    for s in range(size):
        p, before = parent[s], -2
        at = first_row[p] if p >= 0 else 0
        length = first_row[s + 1] - first_row[s]
        for i in range(length + 1):
            if i == length:  # the right-hand side
                target = later[p] + side[p] - 1 if p >= 0 else border
            else:
                unknown = row_index[first_row[s] + i]
                if p < 0:
                    target = unknown - first_border
                elif unknown < first_column[p] + columns[p]:
                    target = unknown - first_column[p]
                else:
                    while row_index[at] < unknown:
                        at += 1
                    target = later[p] + at - first_row[p]
            if target == before + 1:
                runs[height - 1, 2] += 1
            else:
                runs[height, 0], runs[height, 1], runs[height, 2] = i, target, 1
                height += 1
            before = target
        first_run[s + 1] = height
    return first_run, runs[:height].copy()


def round_up(length: Any, multiple: int) -> Any:
    """Return the smallest multiple of `multiple` that is not below `length` (a number or an array)."""
    return length + (-length) % multiple


def plan_stack(
    sequence: IndexArray, needs: IndexArray, parent: IndexArray, update: IndexArray, base: int = 0,
    waiting: IndexArray | None = None,
) -> int:  # fmt: skip
    """Fill `update` with the offsets of the updates, the longest first.

    Each update takes the lowest place that stays free while it is needed: from the factorisation of its
    supernode to the factorisation of the parent.

    Args:
        sequence: Supernodes in the order of factorisation, shape (k,).
        needs: Length of each update, shape (s,).
        parent: Parent of each supernode, shape (s,).
        update: Offsets, shape (s,).
        base: Lowest offset.
        waiting: Supernodes whose updates already lie there and wait for some of the sequence.

    Returns:
        The end of the stack.
    """
    there = np.zeros(0, np.int64) if waiting is None else waiting
    count, time = len(sequence), np.full(len(parent) + 1, len(sequence))  # the last: no parent
    time[sequence] = np.arange(count)
    longest_first = sequence[np.argsort(-needs[sequence], kind="stable")]
    placed = np.concatenate([there, longest_first])
    begin, end = time[placed], time[parent[placed]]
    begin[: len(there)] = -1
    low = np.concatenate([update[there], np.zeros(count, np.int64)])
    high = low + needs[placed]
    for k in range(len(there), len(placed)):
        beside = np.flatnonzero((begin[:k] <= end[k]) & (end[:k] >= begin[k]))
        beside = beside[np.argsort(low[beside], kind="stable")]
        free = np.maximum.accumulate(
            np.append(base, high[beside])
        )  # start of the free space before each and at the end
        fits = np.flatnonzero(low[beside] - free[:-1] >= needs[placed[k]])
        low[k] = free[fits[0] if len(fits) else -1]
        high[k] = low[k] + needs[placed[k]]
    update[placed] = low
    return int(high.max(initial=base))


Numbers: TypeAlias = NDArray[Any]
"""float64 or float32 array; all arrays of a Factor that kernels get are of one type."""


class Tree(NamedTuple):
    """Arrays of a `Plan` for the compiled kernels; the fields have the meaning that they have there."""

    columns: IndexArray
    later: IndexArray
    side: IndexArray
    width: IndexArray
    panel: IndexArray
    update: IndexArray
    first_child: IndexArray
    children: IndexArray
    first_run: IndexArray
    runs: IndexArray
    first_row: IndexArray
    row_index: IndexArray
    first_column: IndexArray
    parent: IndexArray


class Factor(NamedTuple):
    """Storage for a matrix with its right-hand side, its Cholesky factor and its solution.

    Attributes:
        panels, stack: Factor panels, and update matrices not yet used.
        schur: Upper triangle of the matrix of the dense unknowns, then the right-hand side, (d, d + 1).
        solution: All scalar unknowns, the sparse ones first, shape (3 f + d,).
        gathered: One panel row's unknowns.
    """

    panels: Numbers
    stack: Numbers
    schur: Numbers
    solution: Numbers
    gathered: Numbers


def tree_of(plan: Plan) -> Tree:
    """Return the arrays of a plan for the kernels."""
    return Tree(**{name: getattr(plan, name) for name in Tree._fields})


def empty_factor(plan: Plan, dense: int, kind: type[np.floating[Any]] = np.float64) -> Factor:
    """Return storage for a matrix with that plan and a number of dense unknowns, in numbers of one type."""
    return Factor(
        panels=np.zeros(plan.panel[-1], kind),
        stack=np.zeros(plan.stack_size, kind),
        schur=np.zeros((dense, dense + 1), kind),
        solution=np.zeros(3 * len(plan.position) + dense, kind),
        gathered=np.zeros(int(plan.width.max(initial=1)), kind),
    )


def clear(factor: Factor) -> None:
    """Set the matrix and its right-hand side to zero."""
    factor.panels.fill(0.0)
    factor.schur.fill(0.0)
