r"""What the turning of an element's rotation adds to its stiffness: exact, or kept from being negative.

The element blocks of the law `polar` are those with frozen rotation plus [h_a]x D [h_b]x, with

    D = gamma M^-1 - mu I,    M = tr(S) I - S,    gamma = 2 mu - lambda tr(S - I).

Of the Hessian dP/dF only the three modes that turn can be negative: their eigenvalues are minus twice those
of D. The step takes the negative part of D, so that every element block is positive semidefinite.

With E = S - I, rho = lambda / mu and t = gamma / mu = 2 - rho tr E, D = -mu N M^-1 with N = M - t I. In the
deviator B = tr(E) / 3 I - E this is N = q I + B and M = (q + t) I + B with q = (2/3 + rho) tr E. The
negative part of D keeps the positive eigenvalues n of N, as n / (n + t). Functions of B with its three
eigenvalues, D and its negative part are quadratic polynomials in B. Their coefficients follow from the
characteristic polynomial b^3 - 3 p^2 b - det B, p^2 = B : B / 6: its signs count the positive n, and where
there are one or two of them, the root that lies alone on its side of zero gives the projector. An error is
tiny against mu, not against D.

Source: Kim and Eberle 2022, Dynamic deformables (eigensystem of corotational energies); Smith 1961 (roots).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numpy.polynomial import chebyshev

from softsim_core.dynamics.numba_backend.lanes import Lanes, Matrix

SMALLEST_VOLUME = 1e-6
"""det M, 8 at rest, is taken no smaller than this: that of a flat, overstretched element has no bound."""

SMALLEST = 1e-9
"""Relative gap of eigenvalues, or stretch, below which a denominator is kept from vanishing."""


def _largest_root(u: Any) -> Any:
    """Y in [1/2, 1] with 4 y^3 - 3 y = 2 s^2 - 1, s = (u + 1) / 2 in [0, 1]."""
    return np.asarray(np.cos(2.0 / 3.0 * np.arccos(np.clip(0.5 * (u + 1.0), 0.0, 1.0))))


ROOT = chebyshev.cheb2poly(chebyshev.chebinterpolate(_largest_root, 14)).tolist()
"""Coefficients of a polynomial in u that is `_largest_root` on [-1, 1] within 5e-14."""


def twist_stiffness(strain: Matrix, lam: Lanes, mu: Lanes, exact: Any) -> Matrix:
    """D, or its negative part.

    Args:
        strain: E, symmetric.
        lam: First Lame parameter times volume; zero in lanes without an element.
        mu: Second one times volume.
        exact: Whether D itself is wanted, one bit for all lanes.
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
    """Entry of B B."""
    return b[i][0] * b[0][j] + b[i][1] * b[1][j] + b[i][2] * b[2][j]


def _coefficients(
    b: Matrix, square: Matrix, rho: Lanes, trace: Lanes, exact: Any
) -> tuple[Lanes, Lanes, Lanes]:
    """C with -D / mu, or its positive part, c0 I + c1 B + c2 B^2."""
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
    """`_largest_root` of u, the coefficients in pairs: fewer operations wait for another."""
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
    """A mask that holds everywhere."""
    return ir.Constant(ir.VectorType(ir.IntType(1), v.type.count), [1] * v.type.count)


def _not(v: Any, mask: Any) -> Any:
    """The other lanes."""
    return v.builder.xor(mask, _all(v))
