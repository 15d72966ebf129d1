"""Stress and tangent of points in explicit vector code, and what they give a cell; see point_cells.

Arrays are rows of LANES numbers, one cell in each lane. What belongs to a point stands in POINT_ROWS rows:

    0 F, 9 gradient of the velocities, 18 slope of theta by F (each 3 x 3), 27 theta, 28 the same as the last
    solve had it, 29 its rate, 30 stress (3 x 3), 39 tangent (the upper triangle of 9 x 9, ij before kl),
    84 pressure at 27, 85 that at 28, from 86 on what a law needs

Stress and tangent are times the weight of the point.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils as numba_cgutils

from softsim_core.dynamics.numba_backend.lanes import (
    Batch,
    Lanes,
    Matrix,
    cofactors,
    contraction,
    difference,
    dot,
    times,
)
from softsim_core.linalg.compile import intrinsic
from softsim_core.linalg.simd import LANES

cgutils: Any = numba_cgutils

POINT_ROWS = 128
"""Rows of a point, see the module."""

LEFT_ROWS = 27
"""Rows of a pair's first node at a point: sum over J of g_J times the tangent (i J)(k l)."""

UPPER = [[min(a, b) * 9 - min(a, b) * (min(a, b) - 1) // 2 + abs(a - b) for b in range(9)] for a in range(9)]
"""Which row of the upper triangle is that of a and b."""


@intrinsic
def put_cofactors(typing: Any, points: Any, row: Any, moved: Any, place: Any) -> Any:
    """Rows 18 to 30 of theta = det F - 1; `moved`: gradient of what the last solve moved, nine rows."""
    signature = types.void(points, types.int64, moved, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        point = b.start(signature.args[0], args[0], args[1])
        f, rate = b.load_matrix(point), b.load_matrix(point, 9)
        step = b.load_matrix(b.start(signature.args[2], args[2], args[3]))
        cofactor = cofactors(f)
        before = [difference(f[i], step[i]) for i in range(3)]
        turned = cofactors(before)
        b.put_matrix(point, 18, cofactor)
        b.put(point, 27, dot(f[0], cofactor[0]) - 1.0)
        b.put(point, 28, dot(before[0], turned[0]) - 1.0 + contraction(turned, step))
        b.put(point, 29, contraction(cofactor, rate))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_answer(
    typing: Any, points: Any, row: Any, held: Any, place: Any, weights: Any, weight: Any, bulk: Any, lag: Any
) -> Any:
    """Add to stress and tangent of a point what is held there, and to the stress what answers velocities.

    held: six rows from `place` on, H of fem.prony as its upper triangle; weights: row `weight` is that of the
    point; bulk: one row, the change of pressure by that of the mean volume; lag: in [s].
    """
    real, integer = types.float64, types.int64
    signature = types.void(points, integer, held, integer, weights, integer, bulk, real)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        point = b.start(kinds[0], args[0], args[1])
        numbers = b.load(b.start(kinds[2], args[2], args[3]), 6)
        w = b.load(b.start(kinds[4], args[4], args[5]), 1)[0]
        mean = w * b.load(b.v.data(kinds[6], args[6]), 1)[0]
        lag = Lanes(b.v, b.v.splat(args[7]))
        h = [[w * numbers[min(i, j) * (5 - min(i, j)) // 2 + max(i, j)] for j in range(3)] for i in range(3)]
        f, rate, slope = (b.load_matrix(point, first) for first in (0, 9, 18))
        tangent, stress = b.load(point, 45, 39), b.load_matrix(point, 30)
        for i in range(3):
            for j in range(3):
                for k in range(j, 3):
                    place = UPPER[3 * i + j][3 * i + k]
                    tangent[place] = tangent[place] + h[j][k]
                    b.put(point, 39 + place, tangent[place])
        flat = [each for line in rate for each in line]
        for i in range(3):
            for j in range(3):
                answer = mean * slope[i][j]
                for k in range(9):
                    answer = answer + tangent[UPPER[3 * i + j][k]] * flat[k]
                b.put(point, 30 + 3 * i + j, stress[i][j] + dot(f[i], h[j]) + lag * answer)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_node(
    typing: Any, points: Any, point: Any, gradients: Any, place: Any, weights: Any, weight: Any, node: Any,
    volumes: Any, forces: Any,
) -> Any:  # fmt: skip
    """What a point gives a node: w theta' g to its volumes, - P g to its forces.

    The gradient is in rows `place` of `gradients`; volumes and forces: rows 3 node + i.
    """
    integer = types.int64
    signature = types.void(points, integer, gradients, integer, weights, integer, integer, volumes, forces)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        at_point = b.start(kinds[0], args[0], args[1])
        g = b.load(b.start(kinds[2], args[2], args[3]), 3)
        w = b.load(b.start(kinds[4], args[4], args[5]), 1)[0]
        first = builder.mul(args[6], args[6].type(3))
        volumes, forces = b.start(kinds[7], args[7], first), b.start(kinds[8], args[8], first)
        turned, pull = times(b.load_matrix(at_point, 18), g), times(b.load_matrix(at_point, 30), g)
        old_volumes, old_forces = b.load(volumes, 3), b.load(forces, 3)
        for i in range(3):
            b.put(volumes, i, old_volumes[i] + w * turned[i])
            b.put(forces, i, old_forces[i] - pull[i])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_left(
    typing: Any, points: Any, point: Any, gradients: Any, place: Any, scale: Any, out: Any, row: Any
) -> Any:
    """LEFT_ROWS rows of `out` from `row` on, of the node whose gradient is in rows `place`, times `scale`."""
    integer = types.int64
    signature = types.void(points, integer, gradients, integer, types.float64, out, integer)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        tangent = b.load(b.start(kinds[0], args[0], args[1]), 45, 39)
        scale = Lanes(b.v, b.v.splat(args[4]))
        g = [scale * each for each in b.load(b.start(kinds[2], args[2], args[3]), 3)]
        goal = b.start(kinds[5], args[5], args[6])
        for i in range(3):
            for other in range(9):
                b.put(goal, 9 * i + other, dot([tangent[UPPER[3 * i + j][other]] for j in range(3)], g))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_block(
    typing: Any, left: Any, gradients: Any, place: Any, points: Any, volumes: Any, first: Any, second: Any,
    bulk: Any, out: Any, pair: Any,
) -> Any:  # fmt: skip
    """The block of nodes `first` and `second`, in rows (i, 4) of every lane from row 3 pair of `out` on.

    left: LEFT_ROWS a point, of `points` points; gradients: those of the second node, three rows a point from
    `place` on; volumes: rows 3 n + i of node n; bulk: one row, what the product of two of them is worth.
    """
    integer = types.int64
    signature = types.void(left, gradients, integer, integer, volumes, integer, integer, bulk, out, integer)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds, integer = Batch(context, builder), signature.args, args[2].type
        worth = b.load(b.v.data(kinds[7], args[7]), 1)[0]
        mine, other = (
            b.load(b.start(kinds[4], args[4], builder.mul(n, integer(3))), 3) for n in (args[5], args[6])
        )
        mine = [worth * each for each in mine]
        block = [[b.v.variable((mine[i] * other[j]).value) for j in range(3)] for i in range(3)]
        with cgutils.for_range(builder, args[3]) as loop:
            q = loop.index
            line = b.start(kinds[0], args[0], builder.mul(q, integer(LEFT_ROWS)))
            g = b.load(b.start(kinds[1], args[1], builder.add(args[2], builder.mul(q, integer(3)))), 3)
            for i in range(3):
                for k in range(3):
                    total = Lanes(b.v, builder.load(block[i][k])) + dot(b.load(line, 3, 9 * i + 3 * k), g)
                    builder.store(total.value, block[i][k])
        goal = b.v.data(kinds[8], args[8])
        goal = b.v.at(goal, builder.mul(args[9], integer(12 * LANES)))
        for i in range(3):
            b.put_rows(goal, 4 * LANES * i, [Lanes(b.v, builder.load(slot)) for slot in block[i]])
        return context.get_dummy_value()

    return signature, generate


def put_tangent(b: Batch, point: Any, entry: Any) -> None:
    """Write the tangent of a point, entry(a, b) for each row of its upper triangle."""
    for first in range(9):
        for second in range(first, 9):
            b.put(point, 39 + UPPER[first][second], entry(first, second))


def flat(matrix: Matrix) -> list[Lanes]:
    """The nine entries, row by row."""
    return [each for line in matrix for each in line]
