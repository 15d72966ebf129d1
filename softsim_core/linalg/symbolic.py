"""Symbolic factorisation, once a model: elimination order, supernodes, and where every number goes.

The unknowns are free nodes (blocks of three) followed by the border (frames, joints) and, as a last column,
the right-hand side, so that factoring also solves forward. Each supernode keeps one dense panel: its columns
as rows of L^T, contiguous over [own columns | later unknowns | border | right-hand side]. The border's own
matrix is what the elimination leaves.

Sources: Liu 1990 (elimination trees), Duff and Reid 1983 (multifrontal), Ashcraft and Grimes 1989 (relaxed
supernodes).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softsim_core.arrays import IndexArray

RELAXATION = ((24, 0.6), (48, 0.4), (96, 0.25), (1 << 30, 0.08))
"""Merge supernodes while the merged one has at most so many columns, and this share of zeros."""


@dataclass(slots=True, eq=False)
class Supernode:
    """Columns eliminated together.

    Attributes:
        columns: Free nodes eliminated here, in elimination order (numbers of the input graph).
        rows: Later free nodes coupled to them.
        border: Border unknowns coupled to them.
        children: Supernodes whose update goes here.
        zeros: Explicit zeros accepted so far by relaxation, in scalars.
    """

    columns: list[int]
    rows: set[int]
    border: set[int]
    children: list[int] = field(default_factory=list)
    zeros: int = 0

    def size(self) -> tuple[int, int]:
        """Scalars eliminated here, and scalars they are coupled to."""
        return 3 * len(self.columns), 3 * len(self.rows) + len(self.border)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The result: supernodes in elimination (post) order.

    Attributes:
        position: Elimination position of each free node, shape (f,).
        columns: Scalars eliminated by each supernode, shape (s,).
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
        column_of: For each supernode, the panel column of each later scalar unknown (dictionary), border
            included.
    """

    position: IndexArray
    columns: IndexArray
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
    column_of: list[dict[int, int]]


def minimum_degree(count: int, edges: IndexArray) -> IndexArray:
    """Elimination position of each of `count` nodes of the graph with `edges` (e, 2)."""
    if count == 0:
        return np.zeros(0, dtype=np.int64)
    ones = np.ones(len(edges))
    graph = sp.coo_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsc()
    graph = graph + graph.T
    graph.data[:] = -1.0
    dominant = graph + sp.diags(np.asarray(-graph.sum(axis=1)).ravel() + 1.0)
    options = {"SymmetricMode": True}
    factors = splu(dominant.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return np.asarray(factors.perm_c, dtype=np.int64)


def plan(
    count: int, edges: IndexArray, border_edges: IndexArray, border_size: int, lanes: int, tile_rows: int
) -> Plan:
    """Plan the elimination of `count` free nodes.

    Args:
        count: Number of free nodes f.
        edges: Pairs of coupled free nodes, shape (e, 2), any order, repetitions allowed.
        border_edges: Pairs (free node, border unknown), shape (g, 2).
        border_size: Number of border unknowns.
        lanes: Rows are padded to a multiple of it.
        tile_rows: The number of rows is padded to a multiple of it.
    """
    order = minimum_degree(count, edges)
    supernodes, root_children = _amalgamate(*_fundamental(count, edges, border_edges, order), order)
    return _lay_out(count, supernodes, root_children, border_size, lanes, tile_rows)


def _fundamental(
    count: int, edges: IndexArray, border_edges: IndexArray, order: IndexArray
) -> tuple[list[Supernode], list[int]]:
    """Fundamental supernodes and the parent of each (-1 for roots)."""
    inverse = np.empty(count, dtype=np.int64)
    inverse[order] = np.arange(count)
    later: list[set[int]] = [set() for _ in range(count)]  # by position: later positions coupled to it
    for a, b in order[edges].tolist():
        if a != b:
            later[min(a, b)].add(max(a, b))
    border: list[set[int]] = [set() for _ in range(count)]
    for node, unknown in border_edges.tolist():
        border[order[node]].add(unknown)
    parent = [-1] * count
    children = [0] * count
    for j in range(count):
        if later[j]:
            parent[j] = p = min(later[j])
            later[p] |= later[j] - {p}
            border[p] |= border[j]
            children[p] += 1
    supernodes: list[Supernode] = []
    parents: list[int] = []
    owner = [-1] * count
    for j in range(count):
        previous = owner[j - 1] if j > 0 and parent[j - 1] == j and children[j] == 1 else -1
        same = (
            previous >= 0 and len(later[j - 1]) == len(later[j]) + 1 and len(border[j - 1]) == len(border[j])
        )
        if same:
            owner[j] = previous
            supernodes[previous].columns.append(int(inverse[j]))
            supernodes[previous].rows = later[j]
        else:
            owner[j] = len(supernodes)
            supernodes.append(Supernode([int(inverse[j])], later[j], border[j]))
            parents.append(-1)
        parents[owner[j]] = parent[j]
    for s, p in enumerate(parents):
        supernodes[s].rows = {int(inverse[row]) for row in supernodes[s].rows}
        parents[s] = owner[p] if p >= 0 else -1
        if parents[s] >= 0:
            supernodes[parents[s]].children.append(s)
    return supernodes, parents


def _amalgamate(
    supernodes: list[Supernode], parents: list[int], order: IndexArray
) -> tuple[list[Supernode], list[int]]:
    """Merge children into parents where the zeros that costs are few; the roots' indices come second."""
    for parent in supernodes:  # children come before their parents
        for c in sorted(parent.children, key=lambda child: -len(supernodes[child].columns)):
            child = supernodes[c]
            (own, coupled), (own_parent, coupled_parent) = child.size(), parent.size()
            zeros = child.zeros + parent.zeros + own * (own_parent + coupled_parent - coupled)
            merged = own + own_parent
            total = merged * (merged + 1) // 2 + merged * coupled_parent
            share = next(share for limit, share in RELAXATION if merged <= limit)
            if zeros <= share * total:
                parent.columns = child.columns + parent.columns
                parent.children.remove(c)
                parent.children.extend(child.children)
                parent.zeros = zeros
                child.columns = []
    for parent in supernodes:
        parent.columns.sort(key=lambda node: order[node])
    return supernodes, [s for s, node in enumerate(supernodes) if parents[s] < 0]


def _postorder(supernodes: list[Supernode], roots: list[int]) -> list[int]:
    """Children before parents, each subtree contiguous, widest update first (keeps the stack small)."""
    result: list[int] = []
    stack = list(reversed(roots))
    while stack:
        s = stack.pop()
        result.append(s)
        stack.extend(sorted(supernodes[s].children, key=lambda child: -supernodes[child].size()[1]))
    return result[::-1]


def _lay_out(
    count: int, supernodes: list[Supernode], roots: list[int], border_size: int, lanes: int, tile_rows: int
) -> Plan:
    """Number everything and compute offsets, relative positions and the stack."""
    sequence = _postorder(supernodes, roots)
    number = {s: index for index, s in enumerate(sequence)}
    position = np.empty(count, dtype=np.int64)
    placed = 0
    for s in sequence:
        for column in supernodes[s].columns:
            position[column] = placed
            placed += 1
    size = len(sequence)
    columns, later_start, side, width = (np.zeros(size, np.int64) for _ in range(4))
    panel, update = np.zeros(size + 1, np.int64), np.zeros(size, np.int64)
    supernode, row_offset = np.zeros(count, np.int64), np.zeros(count, np.int64)
    unknowns: list[list[int]] = []  # scalar unknowns of each panel's columns, in order
    for index, s in enumerate(sequence):
        node = supernodes[s]
        later = sorted(int(position[row]) for row in node.rows)
        own = [int(position[column]) for column in node.columns]
        scalars = [3 * p + i for p in own + later for i in range(3)] + [
            3 * count + k for k in sorted(node.border)
        ]
        unknowns.append(scalars)
        columns[index], side[index] = 3 * len(own), len(scalars) - 3 * len(own) + 1
        later_start[index] = _padded(columns[index], lanes)
        width[index] = later_start[index] + _padded(side[index], lanes)
        panel[index + 1] = panel[index] + _padded(columns[index], tile_rows) * width[index]
        for local, column in enumerate(node.columns):
            supernode[column] = index
            row_offset[column] = panel[index] + 3 * local * width[index]
    column_of = [
        {unknown: place if place < own else place + start - own for place, unknown in enumerate(scalars)}
        for scalars, own, start in zip(unknowns, columns.tolist(), later_start.tolist(), strict=True)
    ]
    border_columns = {3 * count + k: k for k in range(border_size)}

    child_lists = [[number[c] for c in supernodes[s].children] for s in sequence] + [
        [number[r] for r in roots]
    ]
    parent_of = {child: p for p, below in enumerate(child_lists) for child in below}
    runs: list[tuple[int, int, int]] = []
    first_run = [0]
    for index in range(size):
        p = parent_of[index]
        places = border_columns if p == size else column_of[p]
        target = [places[unknown] for unknown in unknowns[index][columns[index] :]]
        target.append(border_size if p == size else int(later_start[p] + side[p]) - 1)  # the right-hand side
        start = 0
        for here in range(1, len(target) + 1):
            if here == len(target) or target[here] != target[here - 1] + 1:
                runs.append((start, target[start], here - start))
                start = here
        first_run.append(len(runs))
    return Plan(
        position=position,
        columns=columns,
        later=later_start,
        side=side,
        width=width,
        panel=panel,
        update=update,
        stack_size=_plan_stack(_padded(side, tile_rows) * (width - later_start), child_lists, update),
        first_child=np.cumsum([0] + [len(below) for below in child_lists]),
        children=np.array([c for below in child_lists for c in below], dtype=np.int64),
        first_run=np.array(first_run, dtype=np.int64),
        runs=np.array(runs, dtype=np.int64).reshape(-1, 3),
        first_row=np.cumsum([0] + [len(u) - int(c) for u, c in zip(unknowns, columns, strict=True)]),
        row_index=np.array(
            [k for u, c in zip(unknowns, columns, strict=True) for k in u[c:]], dtype=np.int64
        ),
        supernode=supernode,
        row_offset=row_offset,
        column_of=column_of,
    )


def _padded(length: Any, multiple: int) -> Any:
    """The next multiple of `multiple` not below `length` (a number or an array)."""
    return length + (-length) % multiple


def _plan_stack(needs: IndexArray, child_lists: list[list[int]], update: IndexArray) -> int:
    """Fill `update` with the first fit of each update beside those still needed; returns the length."""
    held: dict[int, tuple[int, int]] = {}  # supernode -> (start, end) of its update
    highest = 0
    for index, need in enumerate(needs.tolist()):
        start = 0
        for low, high in sorted(held.values()):
            if low - start >= need:
                break
            start = high
        update[index] = start
        highest = max(highest, start + need)
        for child in child_lists[index]:
            del held[child]
        held[index] = (start, start + need)
    return highest
