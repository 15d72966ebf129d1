"""Vector registers with the arithmetic of numbers, and how a batch of elements is loaded and stored."""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from softsim_core.linalg.simd import LANES, Vectors


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
        """Square root."""
        return Lanes(self.v, self.v.root(self.value))

    def below(self, other: Lanes | float) -> Any:
        """Mask: less than `other`, or not a number."""
        return self.v.less(self.value, self._other(other))

    def at_least(self, floor: Lanes | float) -> Lanes:
        """The larger of this and `floor`, which also replaces what is not a number."""
        return self.where(self.below(floor), floor)

    def size(self) -> Lanes:
        """The absolute value."""
        return self.where(self.below(0.0), self * -1.0)

    def equals(self, other: Lanes | float) -> Any:
        """Mask: the same number as `other`."""
        return self.v.builder.fcmp_ordered("==", self.value, self._other(other))

    def positive(self) -> Lanes:
        """This, or 0 where it is negative; what is not a number stays."""
        return self.where(self.v.builder.fcmp_ordered("<", self.value, self._other(0.0)), 0.0)

    def where(self, mask: Any, other: Lanes | float) -> Lanes:
        """`other` where the mask holds, else this."""
        return Lanes(self.v, self.v.select(mask, self._other(other), self.value))


Triple = list[Lanes]
Matrix = list[list[Lanes]]


def dot(a: Triple, b: Triple) -> Lanes:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Triple, b: Triple) -> Triple:
    """Vector product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def unit(a: Triple) -> Triple:
    """The direction of a."""
    length = dot(a, a).root()
    return [component / length for component in a]


def difference(a: Triple, b: Triple) -> Triple:
    """Componentwise a - b."""
    return [p - q for p, q in zip(a, b, strict=True)]


def times(a: Matrix, b: Triple) -> Triple:
    """Matrix times vector."""
    return [dot(row, b) for row in a]


def cofactors(f: Matrix) -> Matrix:
    """Cof F."""
    return [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])]


def contraction(a: Matrix, b: Matrix) -> Lanes:
    """A : B."""
    return dot(a[0], b[0]) + dot(a[1], b[1]) + dot(a[2], b[2])


class Batch:
    """Gathers and scatters of one batch inside an intrinsic."""

    def __init__(self, context: Any, builder: Any) -> None:
        self.v = Vectors(context, builder, LANES)
        self.builder = builder

    def row(self, base: Any, index: Any) -> Lanes:
        """Row `index` of LANES numbers behind `base`."""
        return Lanes(self.v, self.v.load(self.v.at(base, index)))

    def rows(self, base: Any, start: Any, count: int) -> list[Lanes]:
        """`count` rows of LANES numbers from number `start` on."""
        integer = start.type
        return [self.row(base, self.builder.add(start, integer(LANES * i))) for i in range(count)]

    def put(self, base: Any, row: int, lanes: Lanes) -> None:
        """Write row `row` of LANES numbers behind `base`."""
        self.v.store(lanes.value, self.v.at(base, ir.IntType(64)(LANES * row)))

    def start(self, array_type: Any, array: Any, row: Any) -> Any:
        """Address of row `row` of an array of rows of LANES numbers."""
        return self.v.at(self.v.data(array_type, array), self.builder.mul(row, row.type(LANES)))

    def load(self, base: Any, count: int, first: int = 0) -> list[Lanes]:
        """`count` rows of LANES numbers behind `base`, from row `first` on."""
        return self.rows(base, ir.IntType(64)(LANES * first), count)

    def load_matrix(self, base: Any, first: int = 0) -> Matrix:
        """Nine rows behind `base`, from row `first` on, as a matrix."""
        rows = self.load(base, 9, first)
        return [rows[3 * i : 3 * i + 3] for i in range(3)]

    def put_matrix(self, base: Any, first: int, matrix: Matrix) -> None:
        """Write a matrix to nine rows behind `base`, from row `first` on."""
        for i in range(3):
            for j in range(3):
                self.put(base, first + 3 * i + j, matrix[i][j])

    def nodes(self, base: Any, start: Any) -> list[list[Any]]:
        """Numbers of the four nodes of every lane."""
        integer = start.type
        return [
            [
                self.builder.load(self.v.at(base, self.builder.add(start, integer(LANES * a + lane))))
                for lane in range(LANES)
            ]
            for a in range(4)
        ]

    def gather(self, base: Any, nodes: list[Any]) -> Triple:
        """Rows `nodes` of an array (n, 3), one node a lane; nothing behind the array is read."""
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
        parts: list[list[Any]] = []  # of four lanes each: (x0 .. x3, y0 .. y3) and (z0 .. z3, anything)
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
        """Pieces of two lanes (of one vector each) with a row (a, b, c, 0) of every lane."""
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
        """Write a row (a, b, c, 0) of every lane, one behind the other from number `start` on."""
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
