"""Principal stretches at points in registers, and stress and tangent of isotropic laws in them.

With F = U diag(s) V^T, both proper rotations and only the smallest stretch negative where det F is, an
isotropic law has P = U diag(psi) V^T, psi the derivatives of its energy by s. Its tangent has three modes
u_i v_i^T that stretch, coupled by the second derivatives h, and for each pair of axes i, j, with the third
axis l, two further modes:

    u_i v_j^T + u_j v_i^T  with  a_l = (psi_i - psi_j) / (s_i - s_j),
    u_i v_j^T - u_j v_i^T  with  b_l = (psi_i + psi_j) / (s_i + s_j)

Sources: Hestenes 1958 (one-sided rotations); Kim and Eberle 2022, Dynamic deformables (modes).
"""

from __future__ import annotations

from typing import Any

from softsim_core.base import Array
from softsim_core.physics.dynamics.numba_backend.batches import (
    Matrix,
    Triple,
    at_least,
    choose,
    cross,
    dot,
    matrix_at,
    minus,
    over,
    plus,
    positive,
    product,
    put_matrix,
    put_triple,
    scaled,
    size,
    times,
    transposed,
    triple_at,
)
from softsim_core.physics.dynamics.numba_backend.layout import kernel
from softsim_core.physics.dynamics.numba_backend.points import DEFORMATION, LAW, PRESSURE, STRESS, TANGENT
from softsim_core.physics.linalg import bits_of, part, put, root, row, where

FIRST_DIRECTIONS = LAW
"""Rows of a point with U."""

SECOND_DIRECTIONS = LAW + 9
"""Rows of a point with V."""

STRETCHES = LAW + 18
"""Rows of a point with s."""

PRINCIPAL_STRESS = LAW + 21
"""Rows of a point with psi."""

HESSIAN = LAW + 24
"""Rows of a point with h: 11, 12, 13, 22, 23, 33."""

PAIRS = LAW + 30
"""Rows of a point with a and b."""

POWERS = LAW + 36
"""Six rows of a point for a law's own use."""

SWEEPS = 8
"""Largest number of sweeps over all pairs of columns; most matrices need four."""

CLEAN = 1e-28
"""Squared cosine between columns below which no further sweep is needed."""


@part
def half_turn(difference: Any, off: Any) -> tuple[Any, Any]:
    """Return tangent and cosine of the smaller rotation that makes a symmetric 2 x 2 matrix diagonal.

    `difference` is that of its diagonal entries, `off` its other entry.
    """
    sign = where(difference < 0.0, -1.0, 1.0)
    long = root(difference * difference + 4.0 * off * off) + size(difference)
    tangent = 2.0 * off * sign / at_least(long, 1e-300)
    return tangent, 1.0 / root(tangent * tangent + 1.0)


@part
def rotated(cosine: Any, sine: Any, a: Triple, b: Triple) -> tuple[Triple, Triple]:
    """Return cos a - sin b and sin a + cos b."""
    return minus(scaled(cosine, a), scaled(sine, b)), plus(scaled(sine, a), scaled(cosine, b))


@part
def make_orthogonal(a: Triple, b: Triple, v: Triple, w: Triple) -> Any:
    """Return two columns, v and w after a rotation that makes the columns orthogonal, and if it was due."""
    first, second, off = dot(a, a), dot(b, b), dot(a, b)
    tangent, cosine = half_turn(second - first, off)
    sine = tangent * cosine
    a, b = rotated(cosine, sine, a, b)
    v, w = rotated(cosine, sine, v, w)
    return a, b, v, w, CLEAN * first * second < off * off


@part
def longer_first(a: Triple, b: Triple, v: Triple, w: Triple) -> tuple[Triple, Triple, Triple, Triple]:
    """Return two columns, the longer one first, and v and w; a change of sign keeps V a rotation."""
    is_shorter = dot(a, a) < dot(b, b)
    first, second = choose(is_shorter, b, a), choose(is_shorter, scaled(-1.0, a), b)
    return first, second, choose(is_shorter, w, v), choose(is_shorter, scaled(-1.0, v), w)


@part
def signed_stretches(f: Matrix) -> tuple[Matrix, Triple, Matrix]:
    """Return the columns of U, s, and the columns of V of F; see the module."""
    a, b, c = transposed(f)
    zero = 0.0 * a[0]
    one = zero + 1.0
    u, v, w = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for _ in range(SWEEPS):
        a, b, u, v, is_first_rough = make_orthogonal(a, b, u, v)
        a, c, u, w, is_second_rough = make_orthogonal(a, c, u, w)
        b, c, v, w, is_third_rough = make_orthogonal(b, c, v, w)
        if not bits_of(is_first_rough | is_second_rough | is_third_rough):
            break
    a, c, u, w = longer_first(a, c, u, w)
    b, c, v, w = longer_first(b, c, v, w)
    a, b, u, v = longer_first(a, b, u, v)
    directions = frame_along(a, b)
    return directions, (dot(directions[0], a), dot(directions[1], b), dot(directions[2], c)), (u, v, w)


@part
def frame_along(a: Triple, b: Triple) -> Matrix:
    """Return a right-handed frame with its first axis along a, and its second in the plane of a and b."""
    length, zero = dot(a, a), 0.0 * a[0]
    one = zero + 1.0
    is_zero = length < 1e-280
    first = choose(is_zero, (one, zero, zero), over(a, root(length)))
    rest = minus(b, scaled(dot(first, b), first))
    is_flat = dot(rest, rest) < at_least(1e-28 * length, 1e-280)
    is_along_x = first[0] * first[0] > 0.5
    axis = (where(is_along_x, 0.0, one), where(is_along_x, 1.0, zero), zero)
    rest = choose(is_flat, cross(first, axis), rest)
    second = over(rest, root(dot(rest, rest)))
    return (first, second, cross(first, second))


@part
def nearest_rotation(f: Matrix) -> Matrix:
    """Return U V^T, the proper rotation nearest to F in the Frobenius norm."""
    u, _, v = signed_stretches(f)
    first, second = transposed(u), transposed(v)
    return (times(second, first[0]), times(second, first[1]), times(second, first[2]))


@kernel
def nearest_rotations(deformation: Array, rotations: Array) -> None:
    """Compute the rotations nearest to LANES matrices, both (9, LANES), also where they are degenerate."""
    put_matrix(rotations, 0, nearest_rotation(matrix_at(deformation, 0)))


@part
def put_stretches(points: Array, point: int) -> None:
    """Write U, V and s of a point."""
    u, s, v = signed_stretches(matrix_at(points, point + DEFORMATION))
    put_triple(points, point + STRETCHES, s)
    put_matrix(points, point + FIRST_DIRECTIONS, transposed(u))
    put_matrix(points, point + SECOND_DIRECTIONS, transposed(v))


@part
def put_principal(points: Array, point: int, psi: Triple, h: Matrix, a: Triple, b: Triple) -> None:
    """Write psi, h, a and b of a point."""
    put_triple(points, point + PRINCIPAL_STRESS, psi)
    put_hessian(points, point, h)
    put_triple(points, point + PAIRS, a)
    put_triple(points, point + PAIRS + 3, b)


@part
def put_hessian(points: Array, point: int, h: Matrix) -> None:
    """Write h of a point."""
    put_triple(points, point + HESSIAN, h[0])
    put(points, point + HESSIAN + 3, h[1][1])
    put(points, point + HESSIAN + 4, h[1][2])
    put(points, point + HESSIAN + 5, h[2][2])


@part
def hessian_at(points: Array, point: int) -> Matrix:
    """Return h of a point."""
    first, second = triple_at(points, point + HESSIAN), triple_at(points, point + HESSIAN + 3)
    return (first, (first[1], second[0], second[1]), (first[2], second[1], second[2]))


@part
def add_volume(points: Array, point: int, at_point: Any, rest: Any) -> None:
    """Add the contribution of theta = det F - 1 to psi, h, a and b of a point; see fem.materials.rubber.

    `at_point` is a_p, `rest` is s.
    """
    s, h = triple_at(points, point + STRETCHES), hessian_at(points, point)
    now, found = row(points, point + PRESSURE) - rest, row(points, point + PRESSURE + 1) - rest
    sides, turning = (s[1] * s[2], s[2] * s[0], s[0] * s[1]), scaled(found, s)
    local = scaled(at_point, sides)
    psi = plus(triple_at(points, point + PRINCIPAL_STRESS), scaled(now, sides))
    a = minus(triple_at(points, point + PAIRS), turning)
    b = plus(triple_at(points, point + PAIRS + 3), turning)
    h01 = h[0][1] + local[0] * sides[1] + turning[2]
    h02 = h[0][2] + local[0] * sides[2] + turning[1]
    h12 = h[1][2] + local[1] * sides[2] + turning[0]
    h = (
        (h[0][0] + local[0] * sides[0], h01, h02),
        (h01, h[1][1] + local[1] * sides[1], h12),
        (h02, h12, h[2][2] + local[2] * sides[2]),
    )
    put_principal(points, point, psi, h, a, b)


@part
def make_diagonal(hpp: Any, hqq: Any, hpq: Any, hrp: Any, hrq: Any, v: Triple, w: Triple) -> Any:
    """Return h after a rotation of axes p and q that makes hpq zero, without it, and directions v and w."""
    tangent, cosine = half_turn(hqq - hpp, hpq)
    sine = tangent * cosine
    v, w = rotated(cosine, sine, v, w)
    turned = tangent * hpq
    return hpp - turned, hqq + turned, cosine * hrp - sine * hrq, sine * hrp + cosine * hrq, v, w


@part
def clamp_modes(points: Array, point: int) -> None:
    """Set the negative eigenvalues of h, a and b of a point to zero."""
    h = hessian_at(points, point)
    h00, h01, h02, h11, h12, h22 = h[0][0], h[0][1], h[0][2], h[1][1], h[1][2], h[2][2]
    zero = 0.0 * h00
    one = zero + 1.0
    u, v, w = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for _ in range(SWEEPS - 2):
        h00, h11, h02, h12, u, v = make_diagonal(h00, h11, h01, h02, h12, u, v)
        h00, h22, h01, h12, u, w = make_diagonal(h00, h22, h02, zero, h12, u, w)
        h11, h22, h01, h02, v, w = make_diagonal(h11, h22, h12, h01, zero, v, w)
        h12 = zero
    a, b, c = scaled(positive(h00), u), scaled(positive(h11), v), scaled(positive(h22), w)
    first = plus(plus(scaled(u[0], a), scaled(v[0], b)), scaled(w[0], c))
    second = plus(plus(scaled(u[1], a), scaled(v[1], b)), scaled(w[1], c))
    third = plus(plus(scaled(u[2], a), scaled(v[2], b)), scaled(w[2], c))
    put_hessian(points, point, (first, second, third))
    for k in range(6):
        put(points, point + PAIRS + k, positive(row(points, point + PAIRS + k)))


@part
def put_modes(points: Array, point: int, w: Any, modes: Array) -> None:
    """Write stress and tangent of a point from its psi, h, a and b, times its weight w.

    `modes` is a buffer of 162 rows: the share of each entry of F in nine modes, and that times h, a or b.
    """
    v = matrix_at(points, point + SECOND_DIRECTIONS)
    pull = scaled(w, triple_at(points, point + PRINCIPAL_STRESS))
    half, h = 0.5 * w, hessian_at(points, point)
    a, b = scaled(half, triple_at(points, point + PAIRS)), scaled(half, triple_at(points, point + PAIRS + 3))
    for i in range(3):
        own = triple_at(points, point + FIRST_DIRECTIONS + 3 * i)
        put_triple(points, point + STRESS + 3 * i, times(v, product(pull, own)))
        for j in range(3):
            other = triple_at(points, point + SECOND_DIRECTIONS + 3 * j)
            stretched = product(own, other)
            x, y = own[1] * other[2], own[2] * other[1]
            m = 9 * (3 * i + j)
            put_triple(modes, m, stretched)
            put_triple(modes, m + 81, scaled(w, times(h, stretched)))
            put_pair(modes, m + 3, x, y, a[0], b[0])
            x, y = own[2] * other[0], own[0] * other[2]
            put_pair(modes, m + 5, x, y, a[1], b[1])
            x, y = own[0] * other[1], own[1] * other[0]
            put_pair(modes, m + 7, x, y, a[2], b[2])
    place = point + TANGENT
    for m in range(9):
        first, second = triple_at(modes, 9 * m), triple_at(modes, 9 * m + 3)
        third = triple_at(modes, 9 * m + 6)
        for n in range(81 + 9 * m, 162, 9):
            entry = dot(first, triple_at(modes, n)) + dot(second, triple_at(modes, n + 3))
            put(points, place, entry + dot(third, triple_at(modes, n + 6)))
            place += 1


@part
def put_pair(modes: Array, m: int, x: Any, y: Any, a: Any, b: Any) -> None:
    """Write the shares x + y and x - y of an entry in two modes, and their products with a and b."""
    put(modes, m, x + y)
    put(modes, m + 1, x - y)
    put(modes, m + 81, a * (x + y))
    put(modes, m + 82, b * (x - y))
