"""Cells of any element in batches of LANES, one in each lane, and how they deform."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils as numba_cgutils

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.lanes import Batch, Lanes
from softsim_core.fem.group import ElementGroup
from softsim_core.linalg.compile import intrinsic
from softsim_core.linalg.simd import LANES

cgutils: Any = numba_cgutils


_LINE = 8
"""Numbers of eight bytes in a cache line."""


class CellBatches(NamedTuple):
    """Cells of one element in B batches, with a nodes and q points; lanes beyond the last repeat it.

    Attributes:
        nodes: Node indices, shape (B, a, LANES).
        gradients: Shape gradients in [1/m], rows ((B a + node) q + point) 3 + axis, shape (B a q 3, LANES).
        size: How many cells there are, shape (1,).
    """

    nodes: IndexArray
    gradients: Array
    size: IndexArray


def cell_batches(group: ElementGroup) -> CellBatches:
    """The cells of a group."""
    rows = np.swapaxes(group.gradients, 1, 2).reshape(len(group.cells), -1)
    return CellBatches(in_lanes(group.cells), in_lanes(rows).reshape(-1, LANES), np.array([len(group.cells)]))


def in_lanes(rows: Any) -> Any:
    """Rows (e, r) as batches (B, r, LANES); lanes beyond the last row repeat it."""
    missing = -len(rows) % LANES
    padded = np.concatenate([rows, np.repeat(rows[-1:], missing, axis=0)])
    batches = padded.reshape(-1, LANES, rows.shape[1]).swapaxes(1, 2)
    result = aligned(batches.shape, batches.dtype)
    result[:] = batches
    return result


def aligned(shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
    """Zeros that begin on a cache line: a row that lies on two of them takes twice the time."""
    numbers = math.prod(shape)
    buffer = np.zeros(numbers + _LINE, dtype)
    first = -(buffer.ctypes.data // buffer.itemsize) % _LINE
    return buffer[first : first + numbers].reshape(shape)


@kernel
def gather(nodal: Array, nodes: IndexArray, batch: int, out: Array) -> None:
    """Rows 3 a + i of `out`: component i of nodal values (n, 3) at node a of every lane of a batch."""
    for a in range(nodes.shape[1]):
        for lane in range(LANES):
            node = nodes[batch, a, lane]
            for i in range(3):
                out[3 * a + i, lane] = nodal[node, i]


@intrinsic
def put_gradient(
    typing: Any, nodal: Any, gradients: Any, first: Any, stride: Any, count: Any, out: Any, row: Any
) -> Any:
    """Nine rows of `out` from `row` on: sum over the nodes of nodal values times shape gradients.

    The values of node n are rows 3 n + i, its gradient rows first + n stride + j; `count` nodes.
    """
    integer = types.int64
    signature = types.void(nodal, gradients, integer, integer, integer, out, integer)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        kinds, zero = signature.args, ir.Constant(b.v.type, [0.0] * LANES)
        sums = [b.v.variable(zero) for _ in range(9)]
        with cgutils.for_range(builder, args[4]) as loop:
            n = loop.index
            values = b.load(b.start(kinds[0], args[0], builder.mul(n, n.type(3))), 3)
            place = builder.add(args[2], builder.mul(n, args[3]))
            slopes = b.load(b.start(kinds[1], args[1], place), 3)
            for i in range(3):
                for j in range(3):
                    slot = sums[3 * i + j]
                    builder.store((Lanes(b.v, builder.load(slot)) + values[i] * slopes[j]).value, slot)
        goal = b.start(kinds[5], args[5], args[6])
        for k, slot in enumerate(sums):
            b.put(goal, k, Lanes(b.v, builder.load(slot)))
        return context.get_dummy_value()

    return signature, generate


@kernel
def count_folded(x: Array, cells: CellBatches) -> int:
    """How many cells have det F <= 0 at one of their points, at positions (n, 3) in [m]."""
    nodes, gradients = cells.nodes, cells.gradients
    batches, a, _ = nodes.shape
    pitch = len(gradients) // (batches * a)
    values, f, folded = np.empty((3 * a, LANES)), np.empty((9, LANES)), np.empty(LANES, np.bool_)
    result = 0
    for batch in range(batches):
        gather(x, nodes, batch, values)
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
    """See fem.cells.strain_change."""
    nodes, gradients = cells.nodes, cells.gradients
    batches, a, _ = nodes.shape
    pitch = len(gradients) // (batches * a)
    values, other = np.empty((3 * a, LANES)), np.empty((3 * a, LANES))
    old, new, largest = np.empty((9, LANES)), np.empty((9, LANES)), np.zeros(LANES)
    for batch in range(batches):
        gather(before, nodes, batch, values)
        gather(after, nodes, batch, other)
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
                if not total <= largest[lane]:  # also takes over what is not a number, and keeps it
                    largest[lane] = total
                    if total != total:
                        return np.nan
    change: float = 0.5 * np.sqrt(largest.max())
    return change
