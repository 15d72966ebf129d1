"""Element kinematics in explicit vector code: LANES elements at once, one in each lane.

Arrays of a batch are laid out lane by lane: gradients (batches, 12, LANES), nodes (batches, 4, LANES). The
formulas stand in ordinary arithmetic on `Lanes`; they are those of fem.corotational.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types

from softsim_core.dynamics.fast.compile import intrinsic
from softsim_core.dynamics.fast.simd import LANES, Vectors

NEWTON_STEPS = 6
"""Newton steps for the polar rotation of a batch; lanes that need more are left to the scalar kernel."""


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

    def nodes(self, base: Any, start: Any) -> list[list[Any]]:
        """Offsets (3 node) of the four nodes of every lane."""
        integer = start.type
        result = []
        for a in range(4):
            places = []
            for lane in range(LANES):
                node = self.builder.load(self.v.at(base, self.builder.add(start, integer(LANES * a + lane))))
                places.append(self.builder.mul(node, integer(3)))
            result.append(places)
        return result

    def gather(self, base: Any, places: list[Any]) -> Triple:
        """The three coordinates at `places`, one place a lane."""
        result = []
        for i in range(3):
            vector = ir.Constant(self.v.type, ir.Undefined)
            for lane, place in enumerate(places):
                number = self.builder.load(self.v.at(base, self.builder.add(place, place.type(i))))
                vector = self.builder.insert_element(vector, number, ir.IntType(32)(lane))
            result.append(Lanes(self.v, vector))
        return result

    def subtract(self, base: Any, places: list[Any], triple: Triple) -> None:
        """Subtract three coordinates at `places`, lane after lane (places may repeat)."""
        for lane, place in enumerate(places):
            for i in range(3):
                at = self.v.at(base, self.builder.add(place, place.type(i)))
                number = self.builder.extract_element(triple[i].value, ir.IntType(32)(lane))
                self.builder.store(self.builder.fsub(self.builder.load(at), number), at)


@intrinsic
def frame_rotations(typing: Any, x: Any, corners: Any, batch: Any, rotations: Any) -> Any:
    """Rotations (9, LANES) of a batch by the frames of three corners (law `qr`)."""
    signature = types.void(x, corners, types.int64, rotations)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        positions, index = b.v.data(signature.args[0], args[0]), b.v.data(signature.args[1], args[1])
        out = b.v.data(signature.args[3], args[3])
        first, second, third, _ = b.nodes(index, builder.mul(args[2], args[2].type(4 * LANES)))
        origin = b.gather(positions, first)
        e_x = unit(difference(b.gather(positions, second), origin))
        e_z = unit(cross(e_x, difference(b.gather(positions, third), origin)))
        e_y = cross(e_z, e_x)
        for i in range(3):
            for j, axis in enumerate((e_x, e_y, e_z)):
                b.put(out, 3 * i + j, axis[i])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def polar_rotations(
    typing: Any, x: Any, nodes: Any, gradients: Any, batch: Any, deformation: Any, rotations: Any
) -> Any:
    """Deformation gradients (9, LANES) and nearest rotations (10, LANES) of a batch (law `polar`).

    Row 9 of `rotations` is the size of the last Newton step against the root: a lane where it is not tiny, or
    where the rotation is nearly undefined (1 then), is left to the scalar kernel. Source: Markley 1993, see
    kernels.nearest_rotation.
    """
    signature = types.void(x, nodes, gradients, types.int64, deformation, rotations)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        positions, index, slopes = (b.v.data(signature.args[i], args[i]) for i in range(3))
        out_f, out = b.v.data(signature.args[4], args[4]), b.v.data(signature.args[5], args[5])
        batch, integer = args[3], args[3].type
        places = b.nodes(index, builder.mul(batch, integer(4 * LANES)))
        g = b.rows(slopes, builder.mul(batch, integer(12 * LANES)), 12)
        corners = [b.gather(positions, place) for place in places]
        f = [
            [
                corners[0][i] * g[j]
                + corners[1][i] * g[3 + j]
                + corners[2][i] * g[6 + j]
                + corners[3][i] * g[9 + j]
                for j in range(3)
            ]
            for i in range(3)
        ]
        cofactor = [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])]
        det = dot(f[0], cofactor[0])
        cc = dot(cofactor[0], cofactor[0]) + dot(cofactor[1], cofactor[1]) + dot(cofactor[2], cofactor[2])
        ff = dot(f[0], f[0]) + dot(f[1], f[1]) + dot(f[2], f[2])
        k = (ff * 3.0).root()
        step = k
        for _ in range(NEWTON_STEPS):
            p = k * k - ff
            step = (p * p - k * det * 8.0 - cc * 4.0) / (k * p * 4.0 - det * 8.0)
            k = k - step
        a = (k * k - ff) * 0.5
        denominator = a * k - det
        share = a + ff
        for i in range(3):
            row = [dot(f[i], f[n]) for n in range(3)]
            for j in range(3):
                triple = row[0] * f[0][j] + row[1] * f[1][j] + row[2] * f[2][j]
                b.put(out, 3 * i + j, (share * f[i][j] + k * cofactor[i][j] - triple) / denominator)
                b.put(out_f, 3 * i + j, f[i][j])
        cube = k * k * k
        weak = b.v.less(denominator.value, (cube * 1e-3).value)
        b.put(out, 9, Lanes(b.v, builder.select(weak, (k * 0.0 + 1.0).value, (step / k).value)))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def batch_forces(
    typing: Any,
    y: Any,
    nodes: Any,
    gradients: Any,
    lame: Any,
    batch: Any,
    rotations: Any,
    rotated: Any,
    forces: Any,
) -> Any:
    """Subtract the elastic forces of a batch at positions y, and store its rotated gradients.

    rotated: (LANES, 4, 4), row n of an element holds h_n and a zero, as simd.add_block reads it.
    """
    signature = types.void(y, nodes, gradients, lame, types.int64, rotations, rotated, forces)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        positions, index, slopes, moduli = (b.v.data(signature.args[i], args[i]) for i in range(4))
        turn, out, total = (b.v.data(signature.args[i], args[i]) for i in (5, 6, 7))
        batch, integer = args[4], args[4].type
        places = b.nodes(index, builder.mul(batch, integer(4 * LANES)))
        g = b.rows(slopes, builder.mul(batch, integer(12 * LANES)), 12)
        r = b.rows(turn, integer(0), 9)
        lam, mu = b.rows(moduli, builder.mul(batch, integer(2 * LANES)), 2)
        h = [
            [
                r[3 * i] * g[3 * n] + r[3 * i + 1] * g[3 * n + 1] + r[3 * i + 2] * g[3 * n + 2]
                for i in range(3)
            ]
            for n in range(4)
        ]
        corners = [b.gather(positions, place) for place in places]
        w = [
            [sum((corners[n][i] * h[n][j] for n in range(1, 4)), corners[0][i] * h[0][j]) for j in range(3)]
            for i in range(3)
        ]
        strain = [w[i][i] - 1.0 for i in range(3)]
        pressure = lam * (strain[0] + strain[1] + strain[2])
        double = mu * 2.0
        s = [
            [pressure + double * strain[i] if i == j else mu * (w[i][j] + w[j][i]) for j in range(3)]
            for i in range(3)
        ]
        for n in range(4):
            b.subtract(total, places[n], [dot(s[i], h[n]) for i in range(3)])
            for i in range(3):
                for lane in range(LANES):
                    at = b.v.at(out, integer(16 * lane + 4 * n + i))
                    builder.store(builder.extract_element(h[n][i].value, ir.IntType(32)(lane)), at)
        return context.get_dummy_value()

    return signature, generate
