"""Principal stretches and the tangent that goes with them, in explicit vector code.

With F = U diag(s) V^T, both proper rotations and only the smallest stretch negative where det F is, an
isotropic law has P = U diag(psi) V^T, psi the derivatives of its energy by s. Its tangent has three modes
u_i v_i^T that stretch, coupled by the second derivatives h, and for each pair of axes i, j beside a third one
l two modes of their own:

    u_i v_j^T + u_j v_i^T  with  a_l = (psi_i - psi_j) / (s_i - s_j),
    u_i v_j^T - u_j v_i^T  with  b_l = (psi_i + psi_j) / (s_i + s_j)

Rows of a point, behind those of point_lanes: 86 U, 95 V, 104 s, 107 psi, 110 h (11, 12, 13, 22, 23, 33),
116 a, 119 b.

Sources: Hestenes 1958 (one-sided rotations); Kim and Eberle 2022, Dynamic deformables (modes).
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils as numba_cgutils

from softsim_core.dynamics.numba_backend.lanes import Batch, Lanes, Matrix, Triple, cross, dot
from softsim_core.dynamics.numba_backend.point_lanes import put_tangent
from softsim_core.linalg.compile import intrinsic
from softsim_core.linalg.simd import LANES

cgutils: Any = numba_cgutils

SWEEPS = 8
"""Over all pairs of columns, at most; most matrices take four."""

CLEAN = 1e-28
"""Squared cosine between columns, from which on a sweep was the last one."""

HESSIAN = [[0, 1, 2], [1, 3, 4], [2, 4, 5]]
"""Rows of h."""

PAIRS = ((0, 1), (0, 2), (1, 2))


def tangent_of_half(difference: Lanes, off: Lanes) -> tuple[Lanes, Lanes]:
    """Tangent and cosine of the smaller angle that makes two diagonal entries beside `off` diagonal."""
    sign = (difference * 0.0 + 1.0).where(difference.below(0.0), -1.0)
    long = (difference * difference + off * off * 4.0).root() + difference.size()
    tangent = off * sign * 2.0 / long.at_least(1e-300)
    one = difference * 0.0 + 1.0
    return tangent, one / (tangent * tangent + 1.0).root()


def signed_stretches(b: Batch, f: Matrix) -> tuple[Matrix, Triple, Matrix]:
    """Columns of U, s, and columns of V of F; see the module."""
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
    return _ordered([load(each) for each in columns], [load(each) for each in turns])


def _ordered(c: Matrix, v: Matrix) -> tuple[Matrix, Triple, Matrix]:
    """U, s and V of orthogonal columns c = F V, the shortest of which takes the sign."""
    for p, q in ((0, 2), (1, 2), (0, 1)):
        shorter = dot(c[p], c[p]).below(dot(c[q], c[q]))
        for each in (c, v):  # with a sign, or V were no rotation
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
    """Rows 86 to 107 of a point: U, V and s of its F."""
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
    """Add to psi, h, a and b of a point what theta = det F - 1 brings; see fem.materials.rubber.

    moduli: row `place` is a_p, row `slope` is s.
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
        kept = [Lanes(b.v, builder.load(entries[HESSIAN[k][k]])).positive() for k in range(3)]
        for i in range(3):
            for j in range(i, 3):
                total = kept[0] * v[0][i] * v[0][j] + kept[1] * v[1][i] * v[1][j]
                b.put(point, 110 + HESSIAN[i][j], total + kept[2] * v[2][i] * v[2][j])
        for k, each in enumerate(b.load(point, 6, 116)):
            b.put(point, 116 + k, each.positive())
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_modes(typing: Any, points: Any, row: Any, weights: Any, weight: Any) -> Any:
    """Stress and tangent of a point, rows 30 to 84, of its psi, h, a and b."""
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
