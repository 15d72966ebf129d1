"""Cells of rubber in explicit vector code: LANES cells at once, one in each lane; see rubber for formulas.

Arrays are rows of LANES numbers. What belongs to a point stands in POINT_ROWS rows of `points`:

    0 F, 9 C = cof F, 18 gradient of the velocities (each 3 x 3), 27 det F - 1, 28 the same as the last solve
    had it, 29 its rate, 30 first = 2 w psi', 31 second = 4 w psi'', 32 turning = w (p - s), 33 w a_p,
    34 stress w P + lag times the answer to the velocities (3 x 3)
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils as numba_cgutils

from softsim_core.dynamics.numba_backend.lanes import Batch, Lanes, Matrix, cross, difference, dot, times
from softsim_core.linalg.compile import intrinsic
from softsim_core.linalg.simd import LANES

cgutils: Any = numba_cgutils

POINT_ROWS = 43
"""Rows of a point, see the module."""

NODE_ROWS = 6
"""Rows of a node at a point: F g and C g."""

LEFT_ROWS = 18
"""Rows of a pair's first node at a point: second F g, w a_p C g, first g, and turning F [g]x (3 x 3)."""

MODULI = 7
"""Rows of a batch's moduli: c1, c2, c3, l, s, a_p and a - a_p, see RubberCells."""


def cofactors(f: Matrix) -> Matrix:
    """Cof F."""
    return [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])]


def contraction(a: Matrix, b: Matrix) -> Lanes:
    """A : B."""
    return dot(a[0], b[0]) + dot(a[1], b[1]) + dot(a[2], b[2])


@intrinsic
def put_volume(typing: Any, points: Any, row: Any, moved: Any) -> Any:
    """Rows 9 to 30 but 18 to 27 of a point; `moved`: gradient of what the last solve moved, nine rows."""
    signature = types.void(points, types.int64, moved)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        point = b.start(signature.args[0], args[0], args[1])
        f, rate = b.load_matrix(point), b.load_matrix(point, 18)
        step = b.load_matrix(b.v.data(signature.args[2], args[2]))
        cofactor = cofactors(f)
        before = [difference(f[i], step[i]) for i in range(3)]
        turned = cofactors(before)
        b.put_matrix(point, 9, cofactor)
        b.put(point, 27, dot(f[0], cofactor[0]) - 1.0)
        b.put(point, 28, dot(before[0], turned[0]) - 1.0 + contraction(turned, step))
        b.put(point, 29, contraction(cofactor, rate))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_stress(
    typing: Any, points: Any, row: Any, weights: Any, place: Any, moduli: Any, batch: Any, means: Any,
    lag: Any, mean_share: Any, scale: Any,
) -> Any:  # fmt: skip
    """Rows 30 to 43 of a point; those of the stiffness, 30 to 34, times `scale`.

    weights: row `place` is the rest volume w; means: rows of the means of the rows 27 to 30 over the cells.
    """
    real, integer = types.float64, types.int64
    signature = types.void(points, integer, weights, integer, moduli, integer, means, real, real, real)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        point = b.start(kinds[0], args[0], args[1])
        w = b.load(b.start(kinds[2], args[2], args[3]), 1)[0]
        batch = args[5]
        numbers = b.load(b.start(kinds[4], args[4], builder.mul(batch, batch.type(MODULI))), MODULI)
        c1, c2, c3, log, slope, at_points, on_mean = numbers
        mean_now, mean_before, mean_rate = b.load(b.v.data(kinds[6], args[6]), 3)
        lag, mean_share, scale = (Lanes(b.v, b.v.splat(each)) for each in args[7:])
        f, cofactor, rate = b.load_matrix(point), b.load_matrix(point, 9), b.load_matrix(point, 18)
        now, before, change = b.load(point, 3, 27)
        t = contraction(f, f) - 3.0
        over = (w * 0.0 + 1.0) / (t + 4.0)
        first = w * 2.0 * (c1 + t * (c2 * 2.0 + t * c3 * 3.0) - log * over)
        second = w * 4.0 * (c2 * 2.0 + t * c3 * 6.0 + log * over * over)
        tension = w * (at_points * now + on_mean * mean_now - slope)
        turning = w * (at_points * before + on_mean * mean_before - slope)
        local = w * at_points
        along = second * contraction(f, rate)
        pressure = local * change + w * mean_share * on_mean * mean_rate
        for i in range(3):
            r, s = (i + 1) % 3, (i + 2) % 3
            turned = difference(cross(f[r], rate[s]), cross(f[s], rate[r]))  # change of row i of cof F
            for j in range(3):
                answer = (
                    first * rate[i][j] + along * f[i][j] + turning * turned[j] + pressure * cofactor[i][j]
                )
                b.put(point, 34 + 3 * i + j, first * f[i][j] + tension * cofactor[i][j] + lag * answer)
        for k, each in enumerate((first, second, turning, local)):
            b.put(point, 30 + k, each * scale)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_node(
    typing: Any, points: Any, point: Any, gradients: Any, place: Any, weights: Any, weight: Any, node: Any,
    out: Any, row: Any, volumes: Any, forces: Any,
) -> Any:  # fmt: skip
    """F g and C g of a node at a point, from `row` of `out` on; w C g to its volumes, - P g to its forces.

    The gradient is in rows `place` of `gradients`; volumes and forces: rows 3 node + i.
    """
    integer = types.int64
    signature = types.void(
        points, integer, gradients, integer, weights, integer, integer, out, integer, volumes, forces
    )

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        at_point = b.start(kinds[0], args[0], args[1])
        g = b.load(b.start(kinds[2], args[2], args[3]), 3)
        w = b.load(b.start(kinds[4], args[4], args[5]), 1)[0]
        first = builder.mul(args[6], args[6].type(3))
        goal = b.start(kinds[7], args[7], args[8])
        volumes, forces = b.start(kinds[9], args[9], first), b.start(kinds[10], args[10], first)
        stretched, turned = times(b.load_matrix(at_point), g), times(b.load_matrix(at_point, 9), g)
        pull = times(b.load_matrix(at_point, 34), g)
        old_volumes, old_forces = b.load(volumes, 3), b.load(forces, 3)
        for i in range(3):
            b.put(goal, i, stretched[i])
            b.put(goal, 3 + i, turned[i])
            b.put(volumes, i, old_volumes[i] + w * turned[i])
            b.put(forces, i, old_forces[i] - pull[i])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_left(
    typing: Any,
    points: Any,
    point: Any,
    gradients: Any,
    place: Any,
    nodes: Any,
    node: Any,
    out: Any,
    row: Any,
) -> Any:
    """LEFT_ROWS rows of `out` from `row` on, of the node whose rows begin at `node` and `place`."""
    integer = types.int64
    signature = types.void(points, integer, gradients, integer, nodes, integer, out, integer)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        at_point = b.start(kinds[0], args[0], args[1])
        g = b.load(b.start(kinds[2], args[2], args[3]), 3)
        of_node = b.load(b.start(kinds[4], args[4], args[5]), NODE_ROWS)
        goal = b.start(kinds[6], args[6], args[7])
        first, second, turning, local = b.load(at_point, 4, 30)
        turn = [turning * each for each in g]
        f = b.load_matrix(at_point)
        for i in range(3):
            b.put(goal, i, second * of_node[i])
            b.put(goal, 3 + i, local * of_node[3 + i])
            b.put(goal, 6 + i, first * g[i])
            across = cross(f[i], turn)  # F (g_m x g_n) = (rows of F x g_m) g_n
            for j in range(3):
                b.put(goal, 9 + 3 * i + j, across[j])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_block(
    typing: Any, left: Any, right: Any, node: Any, gradients: Any, place: Any, points: Any, volumes: Any,
    first: Any, second: Any, bulk: Any, out: Any, pair: Any,
) -> Any:  # fmt: skip
    """The block of nodes `first` and `second`, in rows (i, 4) of every lane from row 3 pair of `out` on.

    left: LEFT_ROWS a point; right: NODE_ROWS a point from `node` on; gradients: three rows a point from
    `place` on; volumes: rows 3 n + i of node n; bulk: one row, what the product of two of them is worth.
    """
    integer = types.int64
    signature = types.void(
        left, right, integer, gradients, integer, integer, volumes, integer, integer, bulk, out, integer
    )

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds, integer = Batch(context, builder), signature.args, args[2].type
        worth = b.load(b.v.data(kinds[9], args[9]), 1)[0]
        ends = [b.start(kinds[6], args[6], builder.mul(n, integer(3))) for n in (args[7], args[8])]
        mine, other = (b.load(end, 3) for end in ends)
        mine = [worth * each for each in mine]
        block = [[b.v.variable((mine[i] * other[j]).value) for j in range(3)] for i in range(3)]
        with cgutils.for_range(builder, args[5]) as loop:
            q = loop.index
            line = b.start(kinds[0], args[0], builder.mul(q, integer(LEFT_ROWS)))
            here = b.start(kinds[1], args[1], builder.add(args[2], builder.mul(q, integer(NODE_ROWS))))
            g = b.load(b.start(kinds[3], args[3], builder.add(args[4], builder.mul(q, integer(3)))), 3)
            along, turn = dot(b.load(line, 3, 6), g), times(b.load_matrix(line, 9), g)
            for which in (0, 3):
                row, column = b.load(line, 3, which), b.load(here, 3, which)
                for i in range(3):
                    for j in range(3):
                        total = Lanes(b.v, builder.load(block[i][j])) + row[i] * column[j]
                        if which == 0 and i == j:
                            total = total + along
                        elif which == 0:
                            k = 3 - i - j
                            total = total + turn[k] if (i + 1) % 3 == j else total - turn[k]
                        builder.store(total.value, block[i][j])
        goal = b.v.data(kinds[10], args[10])
        goal = b.v.at(goal, builder.mul(args[11], integer(12 * LANES)))
        for i in range(3):
            b.put_rows(goal, 4 * LANES * i, [Lanes(b.v, builder.load(slot)) for slot in block[i]])
        return context.get_dummy_value()

    return signature, generate
