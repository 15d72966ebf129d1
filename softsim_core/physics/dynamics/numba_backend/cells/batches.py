"""Cells of any element in batches of LANES: deformation, places of their blocks, inverted cells.

Each cell has one block for each pair of its nodes, which are in elimination order. Blocks of free nodes are
added to the panels at once; blocks of moving regions are stored until the regions' Jacobians are known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend import CellPlaces, Nodes, Pairs, Work, kernel
from softsim_core.physics.dynamics.numba_backend.cells.algebra import plus, put_triple, scaled, triple_at
from softsim_core.physics.fem import ElementGroup
from softsim_core.physics.linalg import LANES, Plan, add_block, part

_LINE = 8
"""Numbers of eight bytes per cache line."""


class CellBatches(NamedTuple):
    """Cells of one element in B batches, with a nodes and q points; unused lanes repeat the last cell.

    Attributes:
        nodes: Node indices, shape (B, a, LANES).
        gradients: Shape gradients in [1/m], rows ((B a + node) q + point) 3 + axis, shape (B a q 3, LANES).
        size: Number of cells, shape (1,).
    """

    nodes: IndexArray
    gradients: Array
    size: IndexArray


def cell_batches(group: ElementGroup) -> CellBatches:
    """Return the cells of a group in batches."""
    rows = np.swapaxes(group.gradients, 1, 2).reshape(len(group.cells), -1)
    return CellBatches(in_lanes(group.cells), in_lanes(rows).reshape(-1, LANES), np.array([len(group.cells)]))


def in_lanes(rows: Any) -> Any:
    """Return rows (e, r) as batches (B, r, LANES); unused lanes repeat the last row."""
    missing = -len(rows) % LANES
    padded = np.concatenate([rows, np.repeat(rows[-1:], missing, axis=0)])
    batches = padded.reshape(-1, LANES, rows.shape[1]).swapaxes(1, 2)
    result = allocate_aligned(batches.shape, batches.dtype)
    result[:] = batches
    return result


def allocate_aligned(shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
    """Return zeros that start on a cache line.

    A vector row that spans two cache lines takes twice the time.
    """
    numbers = math.prod(shape)
    buffer = np.zeros(numbers + _LINE, dtype)
    first = -(buffer.ctypes.data // buffer.itemsize) % _LINE
    return buffer[first : first + numbers].reshape(shape)


@kernel
def gather_nodes(nodal: Array, nodes: IndexArray, batch: int, out: Array) -> None:
    """Write component i of nodal values (n, 3) at node a of every lane of a batch to row 3 a + i of `out`."""
    for a in range(nodes.shape[1]):
        for lane in range(LANES):
            node = nodes[batch, a, lane]
            for i in range(3):
                out[3 * a + i, lane] = nodal[node, i]


@part
def put_gradient(
    nodal: Array, gradients: Array, first: int, stride: int, count: int, out: Array, index: int
) -> None:
    """Write nine rows of `out` from `index` on: the sum over the nodes of nodal values times shape gradients.

    The values of node n are rows 3 n + i, its gradient rows first + n stride + j; there are `count` nodes.
    """
    values, g = triple_at(nodal, 0), triple_at(gradients, first)
    x, y, z = scaled(values[0], g), scaled(values[1], g), scaled(values[2], g)
    for n in range(1, count):
        values, g = triple_at(nodal, 3 * n), triple_at(gradients, first + n * stride)
        x, y, z = plus(x, scaled(values[0], g)), plus(y, scaled(values[1], g)), plus(z, scaled(values[2], g))
    put_triple(out, index, x)
    put_triple(out, index + 3, y)
    put_triple(out, index + 6, z)


@kernel
def count_folded(x: Array, cells: CellBatches) -> int:
    """Count the cells with det F <= 0 at one of their points, at positions (n, 3) in [m]."""
    nodes, gradients = cells.nodes, cells.gradients
    batches, a, _ = nodes.shape
    pitch = len(gradients) // (batches * a)
    values, f, folded = np.empty((3 * a, LANES)), np.empty((9, LANES)), np.empty(LANES, np.bool_)
    result = 0
    for batch in range(batches):
        gather_nodes(x, nodes, batch, values)
        folded[:] = False
        for q in range(0, pitch, 3):
            put_gradient(values, gradients, batch * a * pitch + q, pitch, a, f, 0)
            for lane in range(LANES):
                volume = f[0, lane] * (f[4, lane] * f[8, lane] - f[5, lane] * f[7, lane])
                volume += f[1, lane] * (f[5, lane] * f[6, lane] - f[3, lane] * f[8, lane])
                volume += f[2, lane] * (f[3, lane] * f[7, lane] - f[4, lane] * f[6, lane])
                folded[lane] |= volume <= 0.0
        for lane in range(min(LANES, cells.size[0] - batch * LANES)):
            result += folded[lane]
    return result


@kernel
def largest_strain_change(cells: CellBatches, before: Array, after: Array) -> float:
    """Return the largest change of the Green strain at a point between node positions, by the Frobenius norm.

    NaN if a position is NaN.
    """
    nodes, gradients = cells.nodes, cells.gradients
    batches, a, _ = nodes.shape
    pitch = len(gradients) // (batches * a)
    values, other = np.empty((3 * a, LANES)), np.empty((3 * a, LANES))
    old, new, largest = np.empty((9, LANES)), np.empty((9, LANES)), np.zeros(LANES)
    for batch in range(batches):
        gather_nodes(before, nodes, batch, values)
        gather_nodes(after, nodes, batch, other)
        for q in range(0, pitch, 3):
            place = batch * a * pitch + q
            put_gradient(values, gradients, place, pitch, a, old, 0)
            put_gradient(other, gradients, place, pitch, a, new, 0)
            for lane in range(LANES):
                total = 0.0
                for i in range(3):
                    for j in range(i + 1):
                        entry = 0.0
                        for k in range(0, 9, 3):
                            entry += new[k + i, lane] * new[k + j, lane] - old[k + i, lane] * old[k + j, lane]
                        total += (1.0 if i == j else 2.0) * entry * entry
                if not total <= largest[lane]:  # written so that NaN is taken over
                    largest[lane] = total
                    if total != total:
                        return np.nan
    change: float = 0.5 * np.sqrt(largest.max())
    return change


@kernel
def add_blocks(
    blocks: Array, place: int, pitch: int, e: int, places: CellPlaces, panels: Array, pair_blocks: Array
) -> None:
    """Add the blocks of cell e to the panels; write them to `pair_blocks` if a node is in a moving region.

    Rows of the blocks are four numbers, the fourth zero. The first row starts at number `place` of `blocks`,
    each further one `pitch` numbers later.
    """
    strides, starts = places.strides, places.starts
    a = strides.shape[1]
    for n in range(a):
        if strides[e, n] == 0:
            break
        pair = n
        for m in range(n + 1):  # column by column, so that no row is loaded right after it was stored
            add_block(panels, starts[e, pair], strides[e, m], blocks, place + 3 * pair * pitch, pitch)
            pair += a - m - 1
    first = places.pair_blocks[e]
    if first >= 0:
        numbers = blocks.reshape(-1)
        for k in range(starts.shape[1]):
            for i in range(3):
                row = place + (3 * k + i) * pitch
                for j in range(3):
                    pair_blocks[first + k, i, j] = numbers[row + j]


@kernel
def add_all_blocks(blocks: Array, places: CellPlaces, panels: Array, pair_blocks: Array) -> None:
    """Add the blocks (m, a (a + 1) / 2, 3, 4) of all cells; the fourth number of a row is zero."""
    for e in range(len(blocks)):
        add_blocks(blocks, e * blocks.shape[1] * 12, 4, e, places, panels, pair_blocks)


@kernel
def scatter(pairs: Pairs, nodes: Nodes, work: Work) -> None:
    """Add the stored blocks of moving regions to panels and reduced coordinates.

    Work.jacobian must be set.
    """
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
            j0, j1, j2 = jacobian[b, q, 0], jacobian[b, q, 1], jacobian[b, q, 2]
            c0 = blocks[block, 0, 0] * j0 + blocks[block, 0, 1] * j1 + blocks[block, 0, 2] * j2
            c1 = blocks[block, 1, 0] * j0 + blocks[block, 1, 1] * j1 + blocks[block, 1, 2] * j2
            c2 = blocks[block, 2, 0] * j0 + blocks[block, 2, 1] * j1 + blocks[block, 2, 2] * j2
            for r in range(nodes.size[a]):
                m = nodes.reduced[a, r]
                if a == b and m > k:
                    continue
                total = jacobian[a, r, 0] * c0 + jacobian[a, r, 1] * c1 + jacobian[a, r, 2] * c2
                if a != b and m == k:  # the transposed block contributes, too
                    total *= 2.0
                schur[min(m, k), max(m, k)] += total


def node_pairs(cells: IndexArray) -> IndexArray:
    """Return all ordered pairs of nodes of each cell (m, a), cell by cell, shape (m a a, 2)."""
    count = cells.shape[1]
    first, second = np.repeat(cells, count, axis=1), np.tile(cells, (1, count))
    return np.stack([first.ravel(), second.ravel()], axis=1)


def elimination_order(
    cells: IndexArray, nodes: Nodes, local: IndexArray, layout: Plan
) -> tuple[IndexArray, IndexArray]:
    """Return the elimination order (m,) of cells (m, a), and the order of the nodes in each, shape (m, a)."""
    count = len(layout.position)
    places = np.append(layout.position, count)[local]  # local is -1 if a node is not free
    rank = (places + ((local < 0) & (nodes.region_number < 0)))[cells]
    order = np.argsort(rank.min(axis=1, initial=count), kind="stable")
    return order, np.argsort(rank[order], axis=1, kind="stable")


def cell_places(
    kinds: Sequence[IndexArray], nodes: Nodes, local: IndexArray, layout: Plan
) -> tuple[list[CellPlaces], Pairs]:
    """Return the places of the blocks of kinds of cells (m, a) in elimination order, and the stored pairs."""
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
        pair_blocks = np.where(touching, height + len(first) * (np.cumsum(touching) - 1), -1)
        height += len(first) * int(touching.sum())
        result.append(CellPlaces(starts, np.where(free >= 0, width, 0), pair_blocks))
        cell, pair = np.nonzero(region[:, second] >= 0)
        block, one, z = pair_blocks[cell] + pair, (cell, first[pair]), region[cell, second[pair]]
        mixed, inside = free[one] >= 0, region[one] >= 0
        rows = np.stack([block, offset[one], width[one], supernode[one], z], axis=1)
        beside.append(rows[mixed])
        regions.append(np.stack([block, region[one], z], axis=1)[inside])
    pairs = Pairs(np.zeros((height, 3, 3)), np.concatenate(beside), np.concatenate(regions))
    return result, pairs
