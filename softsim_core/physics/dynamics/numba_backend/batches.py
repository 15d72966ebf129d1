"""Cells of any element in batches of LANES, and algebra on registers: vectors and matrices of three.

A vector is a triple of registers or numbers, and a matrix a triple of rows.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend.layout import kernel
from softsim_core.physics.fem import ElementGroup
from softsim_core.physics.linalg import LANES, bits_of, gather, part, put, root, row, where

Triple = tuple[Any, Any, Any]
Matrix = tuple[Triple, Triple, Triple]


@part
def dot(a: Triple, b: Triple) -> Any:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part
def cross(a: Triple, b: Triple) -> Triple:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@part
def scaled(factor: Any, a: Triple) -> Triple:
    """Return a times a factor."""
    return (factor * a[0], factor * a[1], factor * a[2])


@part
def plus(a: Triple, b: Triple) -> Triple:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@part
def minus(a: Triple, b: Triple) -> Triple:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@part
def product(a: Triple, b: Triple) -> Triple:
    """Return a times b, component by component."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


@part
def over(a: Triple, divisor: Any) -> Triple:
    """Return a by a divisor."""
    return (a[0] / divisor, a[1] / divisor, a[2] / divisor)


@part
def unit(a: Triple) -> Triple:
    """Return the direction of a."""
    return over(a, root(dot(a, a)))


@part
def choose(mask: Any, a: Triple, b: Triple) -> Triple:
    """Return a where the mask is set, else b."""
    return (where(mask, a[0], b[0]), where(mask, a[1], b[1]), where(mask, a[2], b[2]))


@part
def times(m: Matrix, a: Triple) -> Triple:
    """Return matrix times vector."""
    return (dot(m[0], a), dot(m[1], a), dot(m[2], a))


@part
def transposed(m: Matrix) -> Matrix:
    """Return the transposed matrix."""
    return (
        (m[0][0], m[1][0], m[2][0]),
        (m[0][1], m[1][1], m[2][1]),
        (m[0][2], m[1][2], m[2][2]),
    )


@part
def difference(m: Matrix, n: Matrix) -> Matrix:
    """Return the difference of two matrices."""
    return (minus(m[0], n[0]), minus(m[1], n[1]), minus(m[2], n[2]))


@part
def cofactors(m: Matrix) -> Matrix:
    """Return the cofactors of a matrix."""
    return (cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]))


@part
def contraction(m: Matrix, n: Matrix) -> Any:
    """Return M : N."""
    return dot(m[0], n[0]) + dot(m[1], n[1]) + dot(m[2], n[2])


@part
def at_least(a: Any, floor: Any) -> Any:
    """Return the larger of two numbers; the second one where the first is NaN."""
    return where(a >= floor, a, floor)


@part
def positive(a: Any) -> Any:
    """Return a number, or 0 where it is negative; NaN stays NaN."""
    return where(a < 0.0, 0.0, a)


@part
def size(a: Any) -> Any:
    """Return the absolute value."""
    return where(a < 0.0, -a, a)


@part
def triple_at(array: Array, index: int) -> Triple:
    """Return three rows of an array of registers."""
    return (row(array, index), row(array, index + 1), row(array, index + 2))


@part
def matrix_at(array: Array, index: int) -> Matrix:
    """Return nine rows of an array of registers as a matrix."""
    return (triple_at(array, index), triple_at(array, index + 3), triple_at(array, index + 6))


@part
def put_triple(array: Array, index: int, a: Triple) -> None:
    """Write three rows of an array of registers."""
    put(array, index, a[0])
    put(array, index + 1, a[1])
    put(array, index + 2, a[2])


@part
def put_matrix(array: Array, index: int, m: Matrix) -> None:
    """Write nine rows of an array of registers."""
    put_triple(array, index, m[0])
    put_triple(array, index + 3, m[1])
    put_triple(array, index + 6, m[2])


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


@part
def gather_nodes(nodal: Array, nodes: IndexArray, batch: int, out: Array) -> None:
    """Write component i of nodal values (n, 3) at node a of every lane of a batch to row 3 a + i of `out`."""
    count = nodes.shape[1]
    for a in range(count):
        put_triple(out, 3 * a, gather(nodal, nodes, count * batch + a))


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
    values, deformation = np.empty((3 * a, LANES)), np.empty((9, LANES))
    result = 0
    for batch in range(batches):
        gather_nodes(x, nodes, batch, values)
        folded = 0
        for q in range(0, pitch, 3):
            put_gradient(values, gradients, batch * a * pitch + q, pitch, a, deformation, 0)
            f = matrix_at(deformation, 0)
            folded |= bits_of(dot(f[0], cross(f[1], f[2])) <= 0.0)
        for lane in range(min(LANES, cells.size[0] - batch * LANES)):
            result += (folded >> lane) & 1
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
    gradient, largest = np.empty((9, LANES)), np.zeros((1, LANES))
    for batch in range(batches):
        gather_nodes(before, nodes, batch, values)
        gather_nodes(after, nodes, batch, other)
        for q in range(0, pitch, 3):
            place = batch * a * pitch + q
            put_gradient(values, gradients, place, pitch, a, gradient, 0)
            u, v, w = transposed(matrix_at(gradient, 0))
            put_gradient(other, gradients, place, pitch, a, gradient, 0)
            x, y, z = transposed(matrix_at(gradient, 0))
            along = (dot(x, x) - dot(u, u), dot(y, y) - dot(v, v), dot(z, z) - dot(w, w))
            across = (dot(x, y) - dot(u, v), dot(y, z) - dot(v, w), dot(z, x) - dot(w, u))
            total = dot(along, along) + 2.0 * dot(across, across)
            if bits_of(~(total == total)):
                return np.nan
            put(largest, 0, at_least(total, row(largest, 0)))
    change: float = 0.5 * np.sqrt(largest.max())
    return change
