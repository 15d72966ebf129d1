"""Where the stiffness blocks of a cell of any nodes go: to the factor's panels, and to reduced coordinates.

Of each cell there is one block for each pair of its nodes, which stand in the order of their elimination.
Those of free nodes are added to the panels at once; what moving regions take is kept until their Jacobians
are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.layout import Nodes, Pairs, Work
from softsim_core.fem.group import ElementGroup
from softsim_core.linalg.simd import add_block
from softsim_core.linalg.symbolic import Plan


class CellPlaces(NamedTuple):
    """Places of the blocks of m cells with a nodes each: free ones, then those in moving regions, then fixed.

    Attributes:
        starts: Panel place of the block of each pair of nodes, 00, 01, ... 11, ...; -1 where one is not free,
            shape (m, a (a + 1) / 2).
        strides: Panel width at each node, 0 where it is not free, shape (m, a).
        kept: Place in Pairs.blocks of each cell's first block, -1: none of its nodes is in a moving region,
            shape (m,).
    """

    starts: IndexArray
    strides: IndexArray
    kept: IndexArray


@kernel
def add_blocks(
    blocks: Array, place: int, pitch: int, e: int, places: CellPlaces, panels: Array, kept: Array
) -> None:
    """Add the blocks of cell e to the panels, and to `kept` if a moving region takes part.

    Rows of the blocks are four numbers, the fourth zero; the first is at number `place` of `blocks`, each
    further one `pitch` numbers behind.
    """
    strides, starts = places.strides, places.starts
    a = strides.shape[1]
    for n in range(a):
        if strides[e, n] == 0:
            break
        pair = n
        for m in range(n + 1):  # column by column: what was just stored in a row is not loaded at once
            add_block(panels, starts[e, pair], strides[e, m], blocks, place + 3 * pair * pitch, pitch)
            pair += a - m - 1
    first = places.kept[e]
    if first >= 0:
        numbers = blocks.reshape(-1)
        for k in range(starts.shape[1]):
            for i in range(3):
                row = place + (3 * k + i) * pitch
                for j in range(3):
                    kept[first + k, i, j] += numbers[row + j]


@kernel
def add_all_blocks(blocks: Array, places: CellPlaces, panels: Array, kept: Array) -> None:
    """Add the blocks (m, a (a + 1) / 2, 3, 4) of all cells, the fourth number of a row zero."""
    for e in range(len(blocks)):
        add_blocks(blocks, e * blocks.shape[1] * 12, 4, e, places, panels, kept)


@kernel
def scatter(pairs: Pairs, nodes: Nodes, work: Work) -> None:
    """Add what is kept of the blocks to panels and reduced; work.jacobian has to be in place."""
    panels, schur, jacobian, blocks = work.factor.panels, work.factor.schur, work.jacobian, pairs.blocks
    for p in range(len(pairs.beside)):
        block, place, width = pairs.beside[p, 0], pairs.beside[p, 1], pairs.beside[p, 2]
        supernode, z = pairs.beside[p, 3], pairs.beside[p, 4]
        for q in range(nodes.size[z]):
            at = place + nodes.reduced_column[supernode, nodes.reduced[z, q]]
            for i in range(3):
                total = 0.0
                for j in range(3):
                    total += blocks[block, i, j] * jacobian[z, q, j]
                panels[at + i * width] += total
    for p in range(len(pairs.regions)):
        block, a, b = pairs.regions[p, 0], pairs.regions[p, 1], pairs.regions[p, 2]
        for q in range(nodes.size[b]):
            k = nodes.reduced[b, q]
            for r in range(nodes.size[a]):
                m = nodes.reduced[a, r]
                if a == b and m > k:
                    continue
                total = 0.0
                for i in range(3):
                    for j in range(3):
                        total += jacobian[a, r, i] * blocks[block, i, j] * jacobian[b, q, j]
                if a != b and m == k:  # from the transposed block, too
                    total *= 2.0
                schur[min(m, k), max(m, k)] += total


def node_pairs(cells: IndexArray) -> IndexArray:
    """All ordered pairs of nodes of each cell (m, a), cell by cell, shape (m a a, 2)."""
    count = cells.shape[1]
    first, second = np.repeat(cells, count, axis=1), np.tile(cells, (1, count))
    return np.stack([first.ravel(), second.ravel()], axis=1)


def in_elimination_order(group: ElementGroup, nodes: Nodes, local: IndexArray, layout: Plan) -> ElementGroup:
    """The group with its cells, and the nodes of each, as they are eliminated; see CellPlaces."""
    order, inside = elimination_order(group.cells, nodes, local, layout)
    return group.part(order).ordered(inside)


def elimination_order(
    cells: IndexArray, nodes: Nodes, local: IndexArray, layout: Plan
) -> tuple[IndexArray, IndexArray]:
    """The order (m,) of cells (m, a) as they are eliminated, and then that of the nodes of each, (m, a)."""
    count = len(layout.position)
    places = np.append(layout.position, count)[local]  # local is -1 where a node is not free
    rank = (places + ((local < 0) & (nodes.region_number < 0)))[cells]
    order = np.argsort(rank.min(axis=1, initial=count), kind="stable")
    return order, np.argsort(rank[order], axis=1, kind="stable")


def cell_places(
    kinds: Sequence[IndexArray], nodes: Nodes, local: IndexArray, layout: Plan
) -> tuple[list[CellPlaces], Pairs]:
    """Places of the blocks of kinds of cells (m, a) in elimination order, and room for the kept ones."""
    result, beside, regions = [], [np.zeros((0, 5), np.int64)], [np.zeros((0, 3), np.int64)]
    height = 0
    for cells in kinds:
        first, second = np.triu_indices(cells.shape[1])
        free, region = local[cells], nodes.region_number[cells]
        supernode = np.where(free >= 0, np.append(layout.supernode, 0)[free], 0)
        offset, width = np.append(layout.row_offset, 0)[free], np.append(layout.width, 0)[supernode]
        both = np.nonzero((free[:, first] >= 0) & (free[:, second] >= 0))
        one, other = (both[0], first[both[1]]), (both[0], second[both[1]])
        starts = np.full((len(cells), len(first)), -1, np.int64)
        starts[both] = offset[one] + layout.panel_columns(supernode[one], 3 * layout.position[free[other]])
        touching = (region >= 0).any(axis=1)
        kept = np.where(touching, height + len(first) * (np.cumsum(touching) - 1), -1)
        height += len(first) * int(touching.sum())
        result.append(CellPlaces(starts, np.where(free >= 0, width, 0), kept))
        cell, pair = np.nonzero(region[:, second] >= 0)
        block, one, z = kept[cell] + pair, (cell, first[pair]), region[cell, second[pair]]
        mixed, inside = free[one] >= 0, region[one] >= 0
        rows = np.stack([block, offset[one], width[one], supernode[one], z], axis=1)
        beside.append(rows[mixed])
        regions.append(np.stack([block, region[one], z], axis=1)[inside])
    pairs = Pairs(np.zeros((height, 3, 3)), np.concatenate(beside), np.concatenate(regions))
    return result, pairs
