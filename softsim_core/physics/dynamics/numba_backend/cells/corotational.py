"""Compiled corotational elasticity: rotations of cells, their forces, and the stiffness of rotation.

The element blocks of the law `corotational` are those with frozen rotation plus [h_a]x D [h_b]x, with

    D = gamma M^-1 - mu I,    M = tr(S) I - S,    gamma = 2 mu - lambda tr(S - I).

Of the Hessian dP/dF only the three rotational modes can be negative: their eigenvalues are minus twice those
of D. The step uses the negative part of D, so that every element block is positive semidefinite.

With E = S - I, rho = lambda / mu and t = gamma / mu = 2 - rho tr E, D = -mu N M^-1 with N = M - t I. In the
deviator B = tr(E) / 3 I - E this is N = q I + B and M = (q + t) I + B with q = (2/3 + rho) tr E. The negative
part of D retains the positive eigenvalues n of N, as n / (n + t). As functions of B with its three
eigenvalues, D and its negative part are quadratic polynomials in B. Their coefficients follow from the
characteristic polynomial b^3 - 3 p^2 b - det B, p^2 = B : B / 6. Its signs count the positive n; where there
are one or two of them, the root that is alone on its side of zero gives the projector. The error is tiny
relative to mu, not relative to D.

Source: Kim and Eberle 2022, Dynamic deformables (eigensystem of corotational energies); Smith 1961 (roots).

In principal stretches theta = s1 + s2 + s3 - 3 and psi_i = 2 mu (s_i - 1) + p; of the tangent only the
rotational modes can be negative: b_l = 2 mu - 2 gamma / (s_i + s_j), gamma = 2 mu - p.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numpy.polynomial import chebyshev

from softsim_core.base import Array
from softsim_core.physics.dynamics.numba_backend import kernel
from softsim_core.physics.dynamics.numba_backend.cells.lanes import (
    POINT_ROWS,
    Batch,
    Lanes,
    Matrix,
    contraction,
    difference,
    put_modes,
    put_principal,
    put_stretches,
    signed_stretches,
)
from softsim_core.physics.dynamics.numba_backend.cells.points import (
    CellInputs,
    CellOutputs,
    Memory,
    PointCells,
    deform,
    finish,
    press,
    remember,
)
from softsim_core.physics.fem.materials import SMALLEST_VOLUME, Corotational, lame
from softsim_core.physics.linalg import intrinsic


@kernel
def rotate_lanes(lanes: int, deformation: Array, rotations: Array) -> None:
    """Compute rotations of deformation gradients, each (9, LANES), for the lanes set in the bits `lanes`."""
    f, r = np.empty((3, 3)), np.empty((3, 3))
    for lane in range(deformation.shape[1]):
        if (lanes >> lane) & 1:
            for i in range(9):
                f[i // 3, i % 3] = deformation[i, lane]
            nearest_rotation(f, r)
            for i in range(9):
                rotations[i, lane] = r[i // 3, i % 3]


@kernel
def nearest_rotation(f: Array, r: Array) -> None:
    """Compute the proper rotation r (3, 3) nearest to f (3, 3) in the Frobenius norm.

    Source: Markley 1993. With the nuclear-like norm k = s1 + s2 + sign(det) s3 the largest root of
    (k^2 - |f|^2)^2 - 8 k det f - 4 |adj f|^2 = 0, found by Newton from above:
    r = ((a + |f|^2) f + k adj(f)^T - f f^T f) / (a k - det f), a = (k^2 - |f|^2) / 2.
    """
    c00 = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
    c01 = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
    c02 = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
    c10 = f[0, 2] * f[2, 1] - f[0, 1] * f[2, 2]
    c11 = f[0, 0] * f[2, 2] - f[0, 2] * f[2, 0]
    c12 = f[0, 1] * f[2, 0] - f[0, 0] * f[2, 1]
    c20 = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
    c21 = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
    c22 = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    det = f[0, 0] * c00 + f[0, 1] * c01 + f[0, 2] * c02
    cc = c00 * c00 + c01 * c01 + c02 * c02 + c10 * c10 + c11 * c11 + c12 * c12
    cc += c20 * c20 + c21 * c21 + c22 * c22
    ff = 0.0
    for i in range(3):
        for j in range(3):
            ff += f[i, j] * f[i, j]
    k = sqrt(3.0 * ff)
    for _ in range(40):
        p = k * k - ff
        slope = 4.0 * k * p - 8.0 * det
        if slope <= 0.0:
            break
        step = (p * p - 8.0 * k * det - 4.0 * cc) / slope
        k -= step
        if step <= 1e-15 * k:
            break
    a = 0.5 * (k * k - ff)
    denominator = a * k - det
    if denominator <= 1e-9 * k * k * k:
        _frame_of_columns(f, r)
        return
    s = 1.0 / denominator
    for i in range(3):
        # row i of f f^T f
        d0 = f[i, 0] * f[0, 0] + f[i, 1] * f[0, 1] + f[i, 2] * f[0, 2]
        d1 = f[i, 0] * f[1, 0] + f[i, 1] * f[1, 1] + f[i, 2] * f[1, 2]
        d2 = f[i, 0] * f[2, 0] + f[i, 1] * f[2, 1] + f[i, 2] * f[2, 2]
        for j in range(3):
            r[i, j] = (a + ff) * f[i, j] - (d0 * f[0, j] + d1 * f[1, j] + d2 * f[2, j])
    r[0, 0] = s * (r[0, 0] + k * c00)
    r[0, 1] = s * (r[0, 1] + k * c01)
    r[0, 2] = s * (r[0, 2] + k * c02)
    r[1, 0] = s * (r[1, 0] + k * c10)
    r[1, 1] = s * (r[1, 1] + k * c11)
    r[1, 2] = s * (r[1, 2] + k * c12)
    r[2, 0] = s * (r[2, 0] + k * c20)
    r[2, 1] = s * (r[2, 1] + k * c21)
    r[2, 2] = s * (r[2, 2] + k * c22)


@kernel
def _frame_of_columns(f: Array, r: Array) -> None:
    """Compute a proper rotation from the columns of f by Gram-Schmidt, even if they are degenerate."""
    for j in range(2):
        for i in range(3):
            r[i, j] = f[i, j]
        if j == 1:
            dot = r[0, 0] * r[0, 1] + r[1, 0] * r[1, 1] + r[2, 0] * r[2, 1]
            for i in range(3):
                r[i, 1] -= dot * r[i, 0]
        length = sqrt(r[0, j] ** 2 + r[1, j] ** 2 + r[2, j] ** 2)
        if length < 1e-12:  # any direction will do: the least aligned axis, made normal to the first column
            least = 0
            if j == 1:
                for i in range(1, 3):
                    if abs(r[i, 0]) < abs(r[least, 0]):
                        least = i
            for i in range(3):
                r[i, j] = 1.0 if i == least else 0.0
            if j == 1:
                dot = r[least, 0]
                for i in range(3):
                    r[i, 1] -= dot * r[i, 0]
            length = sqrt(r[0, j] ** 2 + r[1, j] ** 2 + r[2, j] ** 2)
        for i in range(3):
            r[i, j] /= length
    r[0, 2] = r[1, 0] * r[2, 1] - r[2, 0] * r[1, 1]
    r[1, 2] = r[2, 0] * r[0, 1] - r[0, 0] * r[2, 1]
    r[2, 2] = r[0, 0] * r[1, 1] - r[1, 0] * r[0, 1]


SMALLEST = 1e-9
"""Smallest relative gap of eigenvalues, or stretch, in a denominator."""


def _largest_root(u: Any) -> Any:
    """Return y in [1/2, 1] with 4 y^3 - 3 y = 2 s^2 - 1, s = (u + 1) / 2 in [0, 1]."""
    return np.asarray(np.cos(2.0 / 3.0 * np.arccos(np.clip(0.5 * (u + 1.0), 0.0, 1.0))))


ROOT = chebyshev.cheb2poly(chebyshev.chebinterpolate(_largest_root, 14)).tolist()
"""Coefficients of a polynomial in u that equals `_largest_root` on [-1, 1] within 5e-14."""


def twist_stiffness(strain: Matrix, lam: Lanes, mu: Lanes, exact: Any) -> Matrix:
    """Return D, or its negative part.

    Args:
        strain: E, symmetric.
        lam: First Lame parameter times volume; zero in lanes without an element.
        mu: Second Lame parameter times volume.
        exact: Whether to return D itself, one bit for all lanes.
    """
    rho = lam / mu.at_least(1e-300)
    trace = strain[0][0] + strain[1][1] + strain[2][2]
    third = trace * (1.0 / 3.0)
    b = [[third - strain[i][j] if i == j else strain[i][j] * -1.0 for j in range(3)] for i in range(3)]
    square = [[_product(b, i, j) for j in range(3)] for i in range(3)]
    c0, c1, c2 = _coefficients(b, square, rho, trace, exact)
    diagonal, linear, quadratic = (coefficient * mu * -1.0 for coefficient in (c0, c1, c2))
    d = [[linear * b[i][j] + quadratic * square[i][j] for j in range(3)] for i in range(3)]
    return [[d[i][j] + diagonal if i == j else d[i][j] for j in range(3)] for i in range(3)]


def _product(b: Matrix, i: int, j: int) -> Lanes:
    """Return an entry of B B."""
    return b[i][0] * b[0][j] + b[i][1] * b[1][j] + b[i][2] * b[2][j]


def _coefficients(
    b: Matrix, square: Matrix, rho: Lanes, trace: Lanes, exact: Any
) -> tuple[Lanes, Lanes, Lanes]:
    """Return c0, c1, c2 such that -D / mu, or its positive part, is c0 I + c1 B + c2 B^2."""
    v = rho.v
    p2 = ((square[0][0] + square[1][1] + square[2][2]) * (1.0 / 6.0)).at_least(1e-60)
    p, p3 = p2.root(), p2 * 3.0
    cubed = [b[i][0] * square[i][0] + b[i][1] * square[i][1] + b[i][2] * square[i][2] for i in range(3)]
    det = (cubed[0] + cubed[1] + cubed[2]) * (1.0 / 3.0)
    q, t = trace * (rho + 2.0 / 3.0), rho * trace * -1.0 + 2.0
    m = q + t

    # how many eigenvalues of N = q I + B are positive, by the signs of its characteristic polynomial
    det_n = (q * q - p3) * q + det
    upper, minor = q.below(0.0), (q * q - p2).below(0.0)  # tr N < 0, sum of minors < 0
    odd = _not(v, det_n.below(0.0))  # one or three
    mixed = v.builder.or_(upper, minor)
    three = v.builder.and_(odd, _not(v, mixed))
    none = v.builder.and_(_not(v, odd), v.builder.and_(upper, _not(v, minor)))
    one = v.builder.and_(odd, mixed)

    # the root that is alone on its side of zero: the largest if one is positive, the smallest if two are
    sign = Lanes(v, v.splat(ir.DoubleType()(-1.0))).where(one, 1.0)
    cosine = (sign * det) / (p2 * p * 2.0)
    u = ((cosine + 1.0) * 0.5).at_least(0.0).root() * 2.0 - 1.0
    root = sign * p * 2.0 * _polynomial(u.where((u * -1.0).below(-1.0), 1.0))
    rest = root * root - p3  # product of the two other roots
    gap = (root * root * 3.0 - p3).at_least(p3 * SMALLEST)

    # a single positive eigenvalue n = q + root: n / (n + t) times its projector
    n = q + root
    denominator = gap * (n + t).at_least(SMALLEST)
    # two: n / (n + t) as a linear function on their plane, from their sum and product
    product = (q - root) * q + rest
    products = ((m - root) * m + rest).at_least(SMALLEST)
    denominator = (gap * products).where(one, denominator)
    # three, or D itself whatever its signs: I - t M^-1
    volume = (m * m - p3) * m + det
    volume = Lanes(v, v.builder.select(exact, volume.value, volume.at_least(SMALLEST_VOLUME).value))
    whole = v.builder.select(exact, _all(v), three)
    denominator = denominator.where(whole, volume)

    over = Lanes(v, v.splat(ir.DoubleType()(1.0))) / denominator
    alone = over * n
    c2 = (over * (product + t * n) * -1.0).where(one, alone)
    c1 = c2 * root
    c0 = c2 * rest
    plane = (over * gap).where(one, 0.0)
    c1, c0 = c1 + plane * t, c0 + plane * (product + t * q)
    over = over * t
    c2 = c2.where(whole, over * -1.0)
    c1 = c1.where(whole, over * m)
    c0 = c0.where(whole, over * (p3 - m * m) + 1.0)
    none = v.builder.and_(none, _not(v, whole))
    return c0.where(none, 0.0), c1.where(none, 0.0), c2.where(none, 0.0)


def _polynomial(u: Lanes) -> Lanes:
    """Evaluate `_largest_root` at u with coefficients in pairs, which shortens the chain of dependencies."""
    level: list[Lanes] = []
    for place in range(0, len(ROOT), 2):
        low = ROOT[place]
        level.append(u * ROOT[place + 1] + low if place + 1 < len(ROOT) else u * 0.0 + low)
    power = u * u
    while len(level) > 1:
        ahead = [
            level[place + 1] * power + level[place] if place + 1 < len(level) else level[place]
            for place in range(0, len(level), 2)
        ]
        level, power = ahead, power * power
    return level[0]


def _all(v: Any) -> Any:
    """Return a mask that is true in all lanes."""
    return ir.Constant(ir.VectorType(ir.IntType(1), v.type.count), [1] * v.type.count)


def _not(v: Any, mask: Any) -> Any:
    """Return the complement of a mask."""
    return v.builder.xor(mask, _all(v))


def corotational_moduli(law: Corotational, p: Array) -> Array:
    """Return mu in [Pa], shape (m, 1)."""
    return np.asarray(lame(p)[1][:, None])


def _rotation(u: Matrix, v: Matrix) -> Matrix:
    """Return U V^T of columns."""
    return [[u[0][i] * v[0][j] + u[1][i] * v[1][j] + u[2][i] * v[2][j] for j in range(3)] for i in range(3)]


@intrinsic
def put_rotation(typing: Any, points: Any, row: Any) -> Any:
    """Write rows 18 to 30 of a point from its stretches; row 28 is that of the present deformation."""
    signature = types.void(points, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        point = b.start(signature.args[0], args[0], args[1])
        s, u, v = b.load(point, 3, 104), b.load_matrix(point, 86), b.load_matrix(point, 95)
        r = [[u[i][0] * v[j][0] + u[i][1] * v[j][1] + u[i][2] * v[j][2] for j in range(3)] for i in range(3)]
        theta = s[0] + s[1] + s[2] - 3.0
        b.put_matrix(point, 18, r)
        b.put(point, 27, theta)
        b.put(point, 28, theta)
        b.put(point, 29, contraction(r, b.load_matrix(point, 9)))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_found(typing: Any, points: Any, row: Any, moved: Any, place: Any) -> Any:
    """Write row 28 of a point; `moved` has the gradient of the last solve's displacement from `place` on."""
    signature = types.void(points, types.int64, moved, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        point = b.start(signature.args[0], args[0], args[1])
        step = b.load_matrix(b.start(signature.args[2], args[2], args[3]))
        f = b.load_matrix(point)
        u, _, v = signed_stretches(b, [difference(f[i], step[i]) for i in range(3)])
        b.put(point, 28, contraction(_rotation(u, v), f) - 3.0)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def put_corotational(typing: Any, points: Any, row: Any, moduli: Any, place: Any, positive: Any) -> Any:
    """Write psi, h, a and b of a point; `moduli` has a_p, one more, and mu in rows from `place` on."""
    signature = types.void(points, types.int64, moduli, types.int64, types.boolean)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b, kinds = Batch(context, builder), signature.args
        point = b.start(kinds[0], args[0], args[1])
        at_point, _, mu = b.load(b.start(kinds[2], args[2], args[3]), 3)
        s, (now, found) = b.load(point, 3, 104), b.load(point, 2, 84)
        double = mu * 2.0
        gamma, sums = double - found, [s[1] + s[2], s[2] + s[0], s[0] + s[1]]
        within = [gamma.below(mu * each) for each in sums]
        all_within = builder.and_(within[0], builder.and_(within[1], within[2]))
        zero = mu * 0.0
        volume = (sums[0] * sums[1] * sums[2]).at_least(zero.where(all_within, SMALLEST_VOLUME))
        twist = []
        for k in range(3):
            share = gamma * sums[(k + 1) % 3] * sums[(k + 2) % 3] / volume
            turning = _choose(b, args[4], mu.where(within[k], share), gamma / sums[k])
            twist.append(double - turning * 2.0)
        h = [at_point + double if i == j else at_point for i in range(3) for j in range(i, 3)]
        put_principal(b, point, [double * (each - 1.0) + now for each in s], h, [double] * 3, twist)
        return context.get_dummy_value()

    return signature, generate


def _choose(b: Batch, which: Any, one: Lanes, other: Lanes) -> Lanes:
    """Return one register where the bit is set, else the other, in all lanes."""
    return Lanes(b.v, b.builder.select(which, one.value, other.value))


@kernel
def corotational_points(batch: int, inputs: CellInputs, cells: PointCells) -> None:
    """Compute stress and tangent at all points of a batch."""
    points, steps, weights, moduli = cells.buffers.points, cells.buffers.steps, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, place = len(weights) // batches, batch * (len(moduli) // batches)
    deform(batch, inputs, cells)
    for q in range(count):
        put_stretches(points, POINT_ROWS * q)
        put_rotation(points, POINT_ROWS * q)
        if len(inputs.moved):
            put_found(points, POINT_ROWS * q, steps, 9 * q)
    press(batch, cells)
    for q in range(count):
        put_corotational(points, POINT_ROWS * q, moduli, place, inputs.positive)
        put_modes(points, POINT_ROWS * q, weights, count * batch + q)


@kernel
def fill_corotational(inputs: CellInputs, cells: PointCells, into: CellOutputs) -> None:
    """Add forces and stiffness of all cells."""
    for batch in range(len(cells.cells.nodes)):
        corotational_points(batch, inputs, cells)
        finish(batch, inputs, cells, into)


@kernel
def remember_corotational(inputs: CellInputs, cells: PointCells, memory: Memory) -> None:
    """Advance the memory of all cells after a step."""
    for batch in range(len(cells.cells.nodes)):
        corotational_points(batch, inputs, cells)
        remember(batch, cells, memory)
