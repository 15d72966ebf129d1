"""Rotations of linear tetrahedra, and the stiffness of their rotation by the law `corotational`.

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
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from softsim_core.base import Array
from softsim_core.physics.dynamics.numba_backend import kernel
from softsim_core.physics.dynamics.numba_backend.cells.algebra import (
    Matrix,
    Triple,
    at_least,
    contraction,
    plus,
    scaled,
    times,
)
from softsim_core.physics.fem.materials import SMALLEST_VOLUME
from softsim_core.physics.linalg import part, root, where


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


ROOT = (*chebyshev.cheb2poly(chebyshev.chebinterpolate(_largest_root, 14)).tolist(), 0.0)
"""Sixteen coefficients of a polynomial in u that equals `_largest_root` on [-1, 1] within 5e-14."""


@part
def twist_stiffness(strain: Matrix, lam: Any, mu: Any, exact: bool) -> Matrix:
    """Return D, or its negative part.

    Args:
        strain: E, symmetric.
        lam: First Lame parameter times volume; zero in lanes without an element.
        mu: Second Lame parameter times volume.
        exact: Whether to return D itself.
    """
    rho = lam / at_least(mu, 1e-300)
    trace = strain[0][0] + strain[1][1] + strain[2][2]
    third = (1.0 / 3.0) * trace
    b = (
        (third - strain[0][0], -strain[0][1], -strain[0][2]),
        (-strain[1][0], third - strain[1][1], -strain[1][2]),
        (-strain[2][0], -strain[2][1], third - strain[2][2]),
    )
    square = (times(b, b[0]), times(b, b[1]), times(b, b[2]))
    c0, c1, c2 = _coefficients(b, square, rho, trace, exact)
    diagonal, linear, quadratic = -c0 * mu, -c1 * mu, -c2 * mu
    d0 = plus(scaled(linear, b[0]), scaled(quadratic, square[0]))
    d1 = plus(scaled(linear, b[1]), scaled(quadratic, square[1]))
    d2 = plus(scaled(linear, b[2]), scaled(quadratic, square[2]))
    return (
        (d0[0] + diagonal, d0[1], d0[2]),
        (d1[0], d1[1] + diagonal, d1[2]),
        (d2[0], d2[1], d2[2] + diagonal),
    )


@part
def _coefficients(b: Matrix, square: Matrix, rho: Any, trace: Any, exact: bool) -> Triple:
    """Return c0, c1, c2 such that -D / mu, or its positive part, is c0 I + c1 B + c2 B^2."""
    p2 = at_least((1.0 / 6.0) * (square[0][0] + square[1][1] + square[2][2]), 1e-60)
    p, p3 = root(p2), 3.0 * p2
    det = (1.0 / 3.0) * contraction(b, square)
    q, t = trace * (rho + 2.0 / 3.0), 2.0 - rho * trace
    m = q + t

    # how many eigenvalues of N = q I + B are positive, by the signs of its characteristic polynomial
    det_n = (q * q - p3) * q + det
    upper, minor = q < 0.0, q * q - p2 < 0.0  # tr N < 0, sum of minors < 0
    odd = det_n >= 0.0  # one or three
    mixed = upper | minor
    three, one = odd & ~mixed, odd & mixed
    none = ~odd & upper & ~minor

    # the root that is alone on its side of zero: the largest if one is positive, the smallest if two are
    sign = where(one, 1.0, -1.0)
    cosine = (sign * det) / (2.0 * p2 * p)
    u = 2.0 * root(at_least(0.5 * (cosine + 1.0), 0.0)) - 1.0
    single = sign * p * 2.0 * _polynomial(where(u > 1.0, 1.0, u))
    rest = single * single - p3  # product of the two other roots
    gap = at_least(3.0 * single * single - p3, SMALLEST * p3)

    # a single positive eigenvalue n = q + root: n / (n + t) times its projector
    n = q + single
    # two: n / (n + t) as a linear function on their plane, from their sum and product
    product = (q - single) * q + rest
    products = at_least((m - single) * m + rest, SMALLEST)
    denominator = where(one, gap * at_least(n + t, SMALLEST), gap * products)
    # three, or D itself whatever its signs: I - t M^-1
    volume = (m * m - p3) * m + det
    whole = three
    if exact:
        whole = three | ~three
    else:
        volume = at_least(volume, SMALLEST_VOLUME)
    scale = 1.0 / where(whole, volume, denominator)
    c2 = where(one, scale * n, -scale * (product + t * n))
    c1, c0 = c2 * single, c2 * rest
    plane = where(one, 0.0, scale * gap)
    c1, c0 = c1 + plane * t, c0 + plane * (product + t * q)
    scale = scale * t
    c2 = where(whole, -scale, c2)
    c1 = where(whole, scale * m, c1)
    c0 = where(whole, scale * (p3 - m * m) + 1.0, c0)
    none = none & ~whole
    return (where(none, 0.0, c0), where(none, 0.0, c1), where(none, 0.0, c2))


@part
def _polynomial(u: Any) -> Any:
    """Evaluate `_largest_root` at u with coefficients in pairs, which shortens the chain of dependencies."""
    u2 = u * u
    u4 = u2 * u2
    low = _four(ROOT[0], ROOT[1], ROOT[2], ROOT[3], u, u2) + u4 * _four(
        ROOT[4], ROOT[5], ROOT[6], ROOT[7], u, u2
    )
    high = _four(ROOT[8], ROOT[9], ROOT[10], ROOT[11], u, u2)
    high = high + u4 * _four(ROOT[12], ROOT[13], ROOT[14], ROOT[15], u, u2)
    return low + u4 * u4 * high


@part
def _four(c0: float, c1: float, c2: float, c3: float, u: Any, u2: Any) -> Any:
    """Return c0 + c1 u + c2 u^2 + c3 u^3."""
    return (c1 * u + c0) + (c3 * u + c2) * u2
