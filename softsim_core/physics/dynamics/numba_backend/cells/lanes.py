"""Vector registers with arithmetic operators; stress, tangent and principal stretches at points in them.

Arrays are rows of LANES numbers, one cell in each lane. The data of a point are in POINT_ROWS rows:

    0 F, 9 gradient of the velocities, 18 slope of theta by F (each 3 x 3), 27 theta, 28 theta as the last
    solve found it, 29 its rate, 30 stress (3 x 3), 39 tangent (the upper triangle of 9 x 9, ij before kl),
    84 pressure at 27, 85 that at 28, from 86 on data of the law

Stress and tangent are multiplied by the weight of the point.

With F = U diag(s) V^T, both proper rotations and only the smallest stretch negative where det F is, an
isotropic law has P = U diag(psi) V^T, psi the derivatives of its energy by s. Its tangent has three modes
u_i v_i^T that stretch, coupled by the second derivatives h, and for each pair of axes i, j, with the third
axis l, two further modes:

    u_i v_j^T + u_j v_i^T  with  a_l = (psi_i - psi_j) / (s_i - s_j),
    u_i v_j^T - u_j v_i^T  with  b_l = (psi_i + psi_j) / (s_i + s_j)

Such a law uses further rows of a point: 86 U, 95 V, 104 s, 107 psi, 110 h (11, 12, 13, 22, 23, 33), 116 a,
119 b.

Sources: Hestenes 1958 (one-sided rotations); Kim and Eberle 2022, Dynamic deformables (modes).
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils as numba_cgutils

from softsim_core.physics.linalg import LANES, Vectors, intrinsic


class Lanes:
    """A vector register with arithmetic operators."""

    def __init__(self, v: Vectors, value: Any) -> None:
        self.v, self.value = v, value

    def _other(self, other: Lanes | float) -> Any:
        if isinstance(other, Lanes):
            return other.value
        return ir.Constant(self.v.type, [other] * LANES)

    def __add__(self, other: Lanes | float) -> Lanes:
        return Lanes(self.v, self.v.add(self.value, self._other(other)))

    def __sub__(self, other: Lanes | float) -> Lanes:
        return Lanes(self.v, self.v.subtract(self.value, self._other(other)))

    def __mul__(self, other: Lanes | float) -> Lanes:
        return Lanes(self.v, self.v.multiply(self.value, self._other(other)))

    def __truediv__(self, other: Lanes) -> Lanes:
        return Lanes(self.v, self.v.builder.fdiv(self.value, other.value))

    def root(self) -> Lanes:
        """Return the square root."""
        return Lanes(self.v, self.v.root(self.value))

    def below(self, other: Lanes | float) -> Any:
        """Return the mask of lanes that are less than `other`, or NaN."""
        return self.v.less(self.value, self._other(other))

    def at_least(self, floor: Lanes | float) -> Lanes:
        """Return the larger of this and `floor`, which also replaces NaN."""
        return self.where(self.below(floor), floor)

    def size(self) -> Lanes:
        """Return the absolute value."""
        return self.where(self.below(0.0), self * -1.0)

    def equals(self, other: Lanes | float) -> Any:
        """Return the mask of lanes that equal `other`."""
        return self.v.builder.fcmp_ordered("==", self.value, self._other(other))

    def positive(self) -> Lanes:
        """Return this, or 0 where it is negative; NaN stays NaN."""
        return self.where(self.v.builder.fcmp_ordered("<", self.value, self._other(0.0)), 0.0)

    def where(self, mask: Any, other: Lanes | float) -> Lanes:
        """Return `other` where the mask is set, else this."""
        return Lanes(self.v, self.v.select(mask, self._other(other), self.value))


Triple = list[Lanes]
Matrix = list[list[Lanes]]


def dot(a: Triple, b: Triple) -> Lanes:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Triple, b: Triple) -> Triple:
    """Return the vector product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def unit(a: Triple) -> Triple:
    """Return the direction of a."""
    length = dot(a, a).root()
    return [component / length for component in a]


def difference(a: Triple, b: Triple) -> Triple:
    """Return a - b componentwise."""
    return [p - q for p, q in zip(a, b, strict=True)]


def times(a: Matrix, b: Triple) -> Triple:
    """Return matrix times vector."""
    return [dot(row, b) for row in a]


def cofactors(f: Matrix) -> Matrix:
    """Return the cofactors of F."""
    return [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])]


def contraction(a: Matrix, b: Matrix) -> Lanes:
    """Return A : B."""
    return dot(a[0], b[0]) + dot(a[1], b[1]) + dot(a[2], b[2])


class Batch:
    """Loads, stores, gathers and scatters of one batch inside an intrinsic."""

    def __init__(self, context: Any, builder: Any) -> None:
        self.v = Vectors(context, builder, LANES)
        self.builder = builder

    def row(self, base: Any, index: Any) -> Lanes:
        """Return row `index` of LANES numbers from `base` on."""
        return Lanes(self.v, self.v.load(self.v.at(base, index)))

    def rows(self, base: Any, start: Any, count: int) -> list[Lanes]:
        """Return `count` rows of LANES numbers from number `start` on."""
        integer = start.type
        return [self.row(base, self.builder.add(start, integer(LANES * i))) for i in range(count)]

    def put(self, base: Any, row: int, lanes: Lanes) -> None:
        """Write row `row` of LANES numbers from `base` on."""
        self.v.store(lanes.value, self.v.at(base, ir.IntType(64)(LANES * row)))

    def start(self, array_type: Any, array: Any, row: Any) -> Any:
        """Return the address of row `row` of an array of rows of LANES numbers."""
        return self.v.at(self.v.data(array_type, array), self.builder.mul(row, row.type(LANES)))

    def load(self, base: Any, count: int, first: int = 0) -> list[Lanes]:
        """Return `count` rows of LANES numbers from `base` on, starting with row `first`."""
        return self.rows(base, ir.IntType(64)(LANES * first), count)

    def load_matrix(self, base: Any, first: int = 0) -> Matrix:
        """Return nine rows from `base` on, starting with row `first`, as a matrix."""
        rows = self.load(base, 9, first)
        return [rows[3 * i : 3 * i + 3] for i in range(3)]

    def put_matrix(self, base: Any, first: int, matrix: Matrix) -> None:
        """Write a matrix to nine rows from `base` on, starting with row `first`."""
        for i in range(3):
            for j in range(3):
                self.put(base, first + 3 * i + j, matrix[i][j])

    def nodes(self, base: Any, start: Any) -> list[list[Any]]:
        """Return the numbers of the four nodes of every lane."""
        integer = start.type
        return [
            [
                self.builder.load(self.v.at(base, self.builder.add(start, integer(LANES * a + lane))))
                for lane in range(LANES)
            ]
            for a in range(4)
        ]

    def gather(self, base: Any, nodes: list[Any]) -> Triple:
        """Return rows `nodes` of an array (n, 3), one node per lane, without reading beyond the array."""
        quad, bits = ir.VectorType(ir.DoubleType(), 4), ir.VectorType(ir.IntType(1), 4)
        pointer = quad.as_pointer()
        kind = ir.FunctionType(quad, [pointer, ir.IntType(32), bits, quad])
        load = self.v.function(kind, "llvm.masked.load.v4f64.p0v4f64")
        three, undefined = ir.Constant(bits, [1, 1, 1, 0]), ir.Constant(quad, ir.Undefined)
        rows = []
        for node in nodes:
            at = self.v.at(base, self.builder.mul(node, node.type(3)))
            at = self.builder.bitcast(at, pointer)
            rows.append(self.builder.call(load, [at, ir.IntType(32)(8), three, undefined]))
        parts: list[list[Any]] = []  # four lanes each: (x0 .. x3, y0 .. y3) and (z0 .. z3, undefined)
        for lane in range(0, LANES, 4):
            pairs = [self.v.shuffle(rows[lane + i], rows[lane + i + 1], list(range(8))) for i in (0, 2)]
            parts.append([])
            for i, j in ((0, 1), (2, 2)):
                order = [i, i + 4, i + 8, i + 12, j, j + 4, j + 8, j + 12]
                parts[-1].append(self.v.shuffle(pairs[0], pairs[1], order))
        result = []
        for which, first in ((0, 0), (0, 4), (1, 0)):
            order = [8 * part + first + i for part in range(len(parts)) for i in range(4)]
            result.append(Lanes(self.v, self.v.shuffle(parts[0][which], parts[-1][which], order)))
        return result

    def rows_of(self, triple: Triple) -> list[Any]:
        """Return pieces of two lanes (of one vector each) with a row (a, b, c, 0) for every lane."""
        half = LANES // 2
        low = [lane + LANES * side for lane in range(half) for side in (0, 1)]
        high = [lane + LANES * side for lane in range(half, LANES) for side in (0, 1)]
        first, second, third = (each.value for each in triple)
        none = ir.Constant(self.v.type, [0.0] * LANES)
        pieces = []
        for order in (low, high):
            even, odd = self.v.shuffle(first, third, order), self.v.shuffle(second, none, order)
            pieces += [self.v.shuffle(even, odd, places) for places in (low, high)]
        return pieces

    def put_rows(self, base: Any, start: int, triple: Triple) -> None:
        """Write a row (a, b, c, 0) for every lane, one after the other from number `start` on."""
        for piece, rows in enumerate(self.rows_of(triple)):
            self.v.store(rows, self.v.at(base, ir.IntType(64)(start + LANES * piece)))

    def subtract(self, base: Any, nodes: list[Any], triple: Triple) -> None:
        """Subtract from rows `nodes` of an array (n, 4), lane after lane (nodes may repeat)."""
        quad = Vectors(self.v.context, self.builder, 4)
        lanes = LANES // 4  # rows in a piece
        for piece, rows in enumerate(self.rows_of(triple)):
            for part in range(lanes):
                row = self.v.shuffle(rows, rows, list(range(4 * part, 4 * part + 4)))
                node = nodes[lanes * piece + part]
                at = quad.at(base, self.builder.mul(node, node.type(4)))
                quad.store(quad.subtract(quad.load(at), row), at)


cgutils: Any = numba_cgutils

POINT_ROWS = 128
"""Number of rows of a point, see the module."""

LEFT_ROWS = 27
"""Number of rows of a pair's first node at a point: sum over J of g_J times the tangent (i J)(k l)."""

UPPER = [[min(a, b) * 9 - min(a, b) * (min(a, b) - 1) // 2 + abs(a - b) for b in range(9)] for a in range(9)]
"""Row of the upper triangle for a and b."""


@intrinsic
def put_cofactors(typing: Any, points: Any, row: Any, moved: Any, place: Any) -> Any:
    """Write rows 18 to 30 for theta = det F - 1.

    `moved` has the gradient of the last solve's displacement.
    """
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
    typing: Any,
    points: Any,
    row: Any,
    stress: Any,
    place: Any,
    weights: Any,
    weight: Any,
    bulk: Any,
    lag: Any,
) -> Any:
    """Add the viscoelastic stress H to stress and tangent of a point, and the response to velocities.

    `stress` has six rows from `place` on, H of fem.prony as its upper triangle. Row `weight` of `weights` is
    that of the point. `bulk` is one row, the change of pressure by that of the mean volume. `lag` is in [s].
    """
    real, integer = types.float64, types.int64
    signature = types.void(points, integer, stress, integer, weights, integer, bulk, real)

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
    """Add a point's contribution to a node: w theta' g to its volumes, -P g to its forces.

    The gradient is in rows `place` of `gradients`; volumes and forces are in rows 3 node + i.
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
    """Write LEFT_ROWS rows of `out` from `row` on for one node at a point, times `scale`.

    The node's gradient is in rows `place` of `gradients`.
    """
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
    """Write the block of nodes `first` and `second` to rows (i, 4) of every lane from row 3 pair of `out` on.

    `left` has LEFT_ROWS rows per point, for `points` points. `gradients` has those of the second node, three
    rows per point from `place` on. `volumes` has rows 3 n + i of node n. `bulk` is one row, the factor on the
    product of two volumes.
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
    """Write the tangent of a point: entry(a, b) for each row of its upper triangle."""
    for first in range(9):
        for second in range(first, 9):
            b.put(point, 39 + UPPER[first][second], entry(first, second))


def flat(matrix: Matrix) -> list[Lanes]:
    """Return the nine entries, row by row."""
    return [each for line in matrix for each in line]


SWEEPS = 8
"""Largest number of sweeps over all pairs of columns; most matrices need four."""

CLEAN = 1e-28
"""Squared cosine between columns below which no further sweep is needed."""

HESSIAN = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
"""Row of h for each pair of stretches."""

PAIRS = ((0, 1), (0, 2), (1, 2))


def tangent_of_half(difference: Lanes, off: Lanes) -> tuple[Lanes, Lanes]:
    """Return tangent and cosine of the smaller rotation that makes a symmetric 2 x 2 matrix diagonal.

    `difference` is that of its diagonal entries, `off` its other entry.
    """
    sign = (difference * 0.0 + 1.0).where(difference.below(0.0), -1.0)
    long = (difference * difference + off * off * 4.0).root() + difference.size()
    tangent = off * sign * 2.0 / long.at_least(1e-300)
    one = difference * 0.0 + 1.0
    return tangent, one / (tangent * tangent + 1.0).root()


def signed_stretches(b: Batch, f: Matrix) -> tuple[Matrix, Triple, Matrix]:
    """Return the columns of U, s, and the columns of V of F; see the module."""
    builder, number = b.builder, ir.IntType(LANES)
    none = ir.Constant(b.v.type, [0.0] * LANES)
    one = ir.Constant(b.v.type, [1.0] * LANES)
    columns = [[b.v.variable(f[i][j].value) for i in range(3)] for j in range(3)]
    turns = [[b.v.variable(one if i == j else none) for i in range(3)] for j in range(3)]
    active = cgutils.alloca_once(builder, number)
    builder.store(number(-1), active)

    def load(slots: list[Any]) -> Triple:
        return [Lanes(b.v, builder.load(slot)) for slot in slots]

    with (
        cgutils.for_range(builder, ir.IntType(64)(SWEEPS)),
        builder.if_then(builder.icmp_unsigned("!=", builder.load(active), number(0))),
    ):
        c, v, left = [load(each) for each in columns], [load(each) for each in turns], None
        for p, q in PAIRS:
            first, second, off = dot(c[p], c[p]), dot(c[q], c[q]), dot(c[p], c[q])
            rough = (first * second * CLEAN).below(off * off)
            left = rough if left is None else builder.or_(left, rough)
            tangent, cosine = tangent_of_half(second - first, off)
            sine = tangent * cosine
            for each in (c, v):
                each[p], each[q] = (
                    [cosine * x - sine * y for x, y in zip(each[p], each[q], strict=True)],
                    [sine * x + cosine * y for x, y in zip(each[p], each[q], strict=True)],
                )
        for slots, values in ((columns, c), (turns, v)):
            for j in range(3):
                for i in range(3):
                    builder.store(values[j][i].value, slots[j][i])
        builder.store(builder.bitcast(left, number), active)
    return _order_columns([load(each) for each in columns], [load(each) for each in turns])


def _order_columns(c: Matrix, v: Matrix) -> tuple[Matrix, Triple, Matrix]:
    """Return U, s and V for orthogonal columns c = F V; the shortest column takes the sign."""
    for p, q in ((0, 2), (1, 2), (0, 1)):
        shorter = dot(c[p], c[p]).below(dot(c[q], c[q]))
        for each in (c, v):  # with a sign, so that V remains a rotation
            each[p], each[q] = (
                [x.where(shorter, y) for x, y in zip(each[p], each[q], strict=True)],
                [y.where(shorter, x * -1.0) for x, y in zip(each[p], each[q], strict=True)],
            )
    zero = c[0][0] * 0.0
    length = dot(c[0], c[0])
    none = length.below(1e-280)
    u0 = [(x / length.root()).where(none, 1.0 if i == 0 else 0.0) for i, x in enumerate(c[0])]
    along = dot(u0, c[1])
    rest = [x - along * y for x, y in zip(c[1], u0, strict=True)]
    flat = dot(rest, rest).below((length * 1e-28).at_least(1e-280))
    other = (u0[0] * u0[0] * -1.0).below(-0.5)
    axis = [zero + 1.0, zero, zero]
    axis[0], axis[1] = axis[0].where(other, 0.0), axis[1].where(other, 1.0)
    rest = [x.where(flat, y) for x, y in zip(rest, cross(u0, axis), strict=True)]
    size = dot(rest, rest).root()
    u1 = [x / size for x in rest]
    u = [u0, u1, cross(u0, u1)]
    return u, [dot(x, y) for x, y in zip(u, c, strict=True)], v


@intrinsic
def put_stretches(typing: Any, points: Any, row: Any) -> Any:
    """Write rows 86 to 107 of a point: U, V and s of its F."""
    signature = types.void(points, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        point = b.start(signature.args[0], args[0], args[1])
        u, s, v = signed_stretches(b, b.load_matrix(point))
        for i in range(3):
            b.put(point, 104 + i, s[i])
            for j in range(3):
                b.put(point, 86 + 3 * i + j, u[j][i])
                b.put(point, 95 + 3 * i + j, v[j][i])
        return context.get_dummy_value()

    return signature, generate


def put_principal(b: Batch, point: Any, psi: Triple, h: list[Lanes], a: Triple, twist: Triple) -> None:
    """Write psi, h, a and b of a point."""
    for k, each in enumerate([*psi, *h, *a, *twist]):
        b.put(point, 107 + k, each)


@intrinsic
def add_volume(typing: Any, points: Any, row: Any, moduli: Any, place: Any, slope: Any) -> Any:
    """Add the contribution of theta = det F - 1 to psi, h, a and b of a point; see fem.materials.rubber.

    Row `place` of `moduli` is a_p, row `slope` is s.
    """
    integer = types.int64
    signature = types.void(points, integer, moduli, integer, integer)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        point = b.start(kinds[0], args[0], args[1])
        at_point, rest = (b.load(b.start(kinds[2], args[2], each), 1)[0] for each in args[3:])
        s, psi, h = b.load(point, 3, 104), b.load(point, 3, 107), b.load(point, 6, 110)
        a, twist = b.load(point, 3, 116), b.load(point, 3, 119)
        now, found = (each - rest for each in b.load(point, 2, 84))
        sides = [s[1] * s[2], s[2] * s[0], s[0] * s[1]]
        for i in range(3):
            psi[i] = psi[i] + now * sides[i]
            a[i], twist[i] = a[i] - found * s[i], twist[i] + found * s[i]
            for j in range(i, 3):
                k = HESSIAN[i][j]
                h[k] = h[k] + at_point * sides[i] * sides[j]
                if i != j:
                    h[k] = h[k] + found * s[3 - i - j]
        put_principal(b, point, psi, h, a, twist)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def clamp_modes(typing: Any, points: Any, row: Any) -> Any:
    """Set the negative eigenvalues of h, a and b of a point to zero."""
    signature = types.void(points, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        point = b.start(signature.args[0], args[0], args[1])
        one, none = ir.Constant(b.v.type, [1.0] * LANES), ir.Constant(b.v.type, [0.0] * LANES)
        entries = [b.v.variable(each.value) for each in b.load(point, 6, 110)]
        turns = [[b.v.variable(one if i == j else none) for i in range(3)] for j in range(3)]
        with cgutils.for_range(builder, ir.IntType(64)(SWEEPS - 2)):
            h = [Lanes(b.v, builder.load(slot)) for slot in entries]
            v = [[Lanes(b.v, builder.load(slot)) for slot in slots] for slots in turns]
            for p, q in PAIRS:
                r = 3 - p - q
                off = h[HESSIAN[p][q]]
                tangent, cosine = tangent_of_half(h[HESSIAN[q][q]] - h[HESSIAN[p][p]], off)
                sine = tangent * cosine
                h[HESSIAN[p][p]] = h[HESSIAN[p][p]] - tangent * off
                h[HESSIAN[q][q]] = h[HESSIAN[q][q]] + tangent * off
                h[HESSIAN[p][q]] = off * 0.0
                x, y = h[HESSIAN[r][p]], h[HESSIAN[r][q]]
                h[HESSIAN[r][p]], h[HESSIAN[r][q]] = cosine * x - sine * y, sine * x + cosine * y
                v[p], v[q] = (
                    [cosine * x - sine * y for x, y in zip(v[p], v[q], strict=True)],
                    [sine * x + cosine * y for x, y in zip(v[p], v[q], strict=True)],
                )
            for slot, each in zip(entries, h, strict=True):
                builder.store(each.value, slot)
            for slots, values in zip(turns, v, strict=True):
                for slot, each in zip(slots, values, strict=True):
                    builder.store(each.value, slot)
        v = [[Lanes(b.v, builder.load(slot)) for slot in slots] for slots in turns]
        positive = [Lanes(b.v, builder.load(entries[HESSIAN[k][k]])).positive() for k in range(3)]
        for i in range(3):
            for j in range(i, 3):
                total = positive[0] * v[0][i] * v[0][j] + positive[1] * v[1][i] * v[1][j]
                b.put(point, 110 + HESSIAN[i][j], total + positive[2] * v[2][i] * v[2][j])
        for k, each in enumerate(b.load(point, 6, 116)):
            b.put(point, 116 + k, each.positive())
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_modes(typing: Any, points: Any, row: Any, weights: Any, weight: Any) -> Any:
    """Write stress and tangent of a point, rows 30 to 84, from its psi, h, a and b."""
    integer = types.int64
    signature = types.void(points, integer, weights, integer)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        point = b.start(signature.args[0], args[0], args[1])
        w = b.load(b.start(signature.args[2], args[2], args[3]), 1)[0]
        u, v = b.load_matrix(point, 86), b.load_matrix(point, 95)
        psi, h = b.load(point, 3, 107), [w * each for each in b.load(point, 6, 110)]
        pairs = [w * 0.5 * each for each in b.load(point, 6, 116)]
        for i in range(3):
            pull = [w * psi[k] * u[i][k] for k in range(3)]
            for j in range(3):
                b.put(point, 30 + 3 * i + j, dot(pull, v[j]))

        def mode(m: int, n: int) -> list[Lanes]:
            return [u[i][m] * v[j][n] for i in range(3) for j in range(3)]

        stretched = [mode(k, k) for k in range(3)]
        modes = []
        for k, each in enumerate(stretched):
            row = [h[HESSIAN[k][m]] for m in range(3)]
            modes.append((each, [dot(row, [other[e] for other in stretched]) for e in range(9)]))
        for third in range(3):
            m, n = (third + 1) % 3, (third + 2) % 3
            one, other = mode(m, n), mode(n, m)
            for sign, worth in ((1.0, pairs[third]), (-1.0, pairs[3 + third])):
                both = [x + y if sign > 0.0 else x - y for x, y in zip(one, other, strict=True)]
                modes.append((both, [worth * each for each in both]))

        def entry(first: int, second: int) -> Lanes:
            total = modes[0][0][first] * modes[0][1][second]
            for left, right in modes[1:]:
                total = total + left[first] * right[second]
            return total

        put_tangent(b, point, entry)
        return context.get_dummy_value()

    return signature, generate
