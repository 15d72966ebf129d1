r"""Functions of deformation for rubber laws: cofactors, and sums of powers of principal stretches.

.. math:: V(G) = \sum_i \phi(x_i), \quad \phi(x) = \sum_k \tfrac{m_k}{n_k^2} (x^{n_k / 2} - 1), \qquad
    dV/dG = 2 G \phi'(C), \qquad d^2V = 2 dG \phi'(C) + 2 G \, D\phi'(C)[G^T dG + dG^T G]

with x the squared stretches, the eigenvalues of :math:`C = G^T G = Q \, diag(x) \, Q^T`, and
:math:`D\phi'(C)[H] = Q (\Gamma \circ Q^T H Q) Q^T`, where Gamma are the divided differences
:math:`(\phi'(x_i) - \phi'(x_j)) / (x_i - x_j)` and phi'' where x_i = x_j.

Where a stretch is below `LEAST_STRETCH`, phi continues as the parabola in x that meets it. All values are
therefore finite for every G, and the slope is continuous.

Source: Ball 1984, Differentiability properties of symmetric and isotropic functions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, FactorisationError

_LEVI_CIVITA = np.zeros((3, 3, 3))
_LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


def cofactor(matrices: Array) -> Array:
    """Return the cofactors d det F / dF of matrices (..., 3, 3), also of singular ones."""
    rows_first = np.moveaxis(matrices, (-2, -1), (0, 1))
    return np.ascontiguousarray(np.moveaxis(cofactor_first(rows_first), (0, 1), (-2, -1)))


def cofactor_first(matrices: Array) -> Array:
    """Return the cofactors of matrices with rows and columns first, shape (3, 3, ...).

    Fast for many matrices.
    """
    after, before = [1, 2, 0], [2, 0, 1]
    first, second = matrices[after], matrices[before]
    return np.asarray(first[:, after] * second[:, before] - first[:, before] * second[:, after])


def cofactor_slope(matrices: Array) -> Array:
    """Return d cof F_ij / dF_kl = e_ikm e_jln F_mn, shape (..., 3, 3, 3, 3)."""
    return np.asarray(
        np.einsum("ikm,jln,...mn->...ijkl", _LEVI_CIVITA, _LEVI_CIVITA, matrices, optimize=True)
    )


def stress_of_cofactor(matrices: Array, slope: Array) -> Array:
    """Return dV/dF, shape (..., 3, 3), of an energy V(cof F) with the slope dV/d cof F (..., 3, 3)."""
    return np.asarray(np.einsum("...ijkl,...kl->...ij", cofactor_slope(matrices), slope))


def tangent_of_cofactor(matrices: Array, slope: Array, curvature: Array) -> Array:
    """Return d2V/dF2 of an energy V(cof F), shape (..., 3, 3, 3, 3).

    `slope` is dV/d cof F, shape (..., 3, 3), and `curvature` is d2V/d(cof F)2, shape (..., 3, 3, 3, 3).
    """
    outer = cofactor_slope(matrices)
    nine = outer.reshape(*outer.shape[:-4], 9, 9)
    middle = curvature.reshape(*curvature.shape[:-4], 9, 9)
    turned = nine @ middle @ nine
    return np.asarray(turned.reshape(*turned.shape[:-2], 3, 3, 3, 3) + cofactor_slope(slope))


LEAST_STRETCH = 0.1
"""Stretch below which a power continues as a parabola of the squared stretch."""

_LEAST = LEAST_STRETCH**2


class Powers(NamedTuple):
    """Amplitudes m_k in [Pa] and exponents n_k > 0 of the terms, shapes (..., k)."""

    amplitudes: Array
    exponents: Array


def power_energy(matrices: Array, powers: Powers) -> Array:
    """Return V in [J/m^3] of matrices (..., 3, 3), zero for rotations, shape (...)."""
    x = _principal(matrices)[0]
    bounded, below = np.maximum(x, _LEAST)[..., None], np.minimum(x - _LEAST, 0.0)[..., None]
    m, n = (each[..., None, :] for each in powers)
    log, half = np.log(bounded), 0.5 * n
    value = m / n**2 * np.expm1(half * log)
    slope, curvature = _slope(m, n, log), _slope(m, n, log) * (half - 1.0) / bounded
    return np.asarray((value + below * (slope + 0.5 * below * curvature)).sum(axis=(-2, -1)))


def power_slope(matrices: Array, powers: Powers) -> Array:
    """Return dV/dG in [Pa], shape (..., 3, 3)."""
    x, axes = _principal(matrices)
    middle = (axes * _first(x, powers)[..., None, :]) @ np.swapaxes(axes, -1, -2)
    return np.asarray(2.0 * matrices @ middle)


def power_curvature(matrices: Array, powers: Powers) -> Array:
    """Return d2V/dG2 in [Pa], shape (..., 3, 3, 3, 3)."""
    x, axes = _principal(matrices)
    first = _first(x, powers)
    shared = (axes * first[..., None, :]) @ np.swapaxes(axes, -1, -2)
    turned = matrices @ axes
    gamma = _compute_divided_differences(x[..., :, None], x[..., None, :], powers)
    # H in the axes: A_ia Q_jb + A_ib Q_ja of dG = e_i e_j^T, A = G Q
    pair = np.einsum("...ia,...jb->...ijab", turned, axes)
    pair = pair + np.swapaxes(pair, -1, -2)
    result = np.einsum("...ijab,...ab,...klab->...ijkl", pair, gamma, pair)
    return np.asarray(result + 2.0 * np.einsum("ik,...jl->...ijkl", np.eye(3), shared))


def _principal(matrices: Array) -> tuple[Array, Array]:
    """Return the squared stretches, shape (..., 3), and their axes in columns."""
    if not np.isfinite(matrices).all():
        raise FactorisationError("the deformation of an element is not finite")
    x, axes = np.linalg.eigh(np.swapaxes(matrices, -1, -2) @ matrices)
    return x, axes


def _slope(m: Array, n: Array, log: Array) -> Array:
    """Return the slope m / (2 n) x^(n/2 - 1) of each term at log x."""
    return np.asarray(m / (2.0 * n) * np.exp((0.5 * n - 1.0) * log))


def _first(x: Array, powers: Powers) -> Array:
    """Return phi'(x), shape of x, whose last axis is that of the stretches."""
    bounded, below = np.maximum(x, _LEAST)[..., None], np.minimum(x - _LEAST, 0.0)[..., None]
    m, n = (each[..., None, :] for each in powers)
    slope = _slope(m, n, np.log(bounded))
    return np.asarray((slope * (1.0 + below * (0.5 * n - 1.0) / bounded)).sum(axis=-1))


def _compute_divided_differences(x: Array, y: Array, powers: Powers) -> Array:
    """Return the divided differences of phi' between x (..., 3, 1) and y (..., 1, 3), shape (..., 3, 3).

    With u = log(x / y), x^b - y^b = y^b expm1(b u) and x - y = y expm1(u) are exact for close stretches, too.
    """
    x, y = np.broadcast_arrays(x, y)
    m, n = (each[..., None, None, :] for each in powers)
    b = 0.5 * n - 1.0
    bounded_x, bounded_y = np.maximum(x, _LEAST), np.maximum(y, _LEAST)
    u = np.log(bounded_x / bounded_y)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(u[..., None] == 0.0, b, np.expm1(b * u[..., None]) / np.expm1(u)[..., None])
        share = np.where(x == y, x >= _LEAST, (bounded_x - bounded_y) / (x - y))
    slope = _slope(m, n, np.log(bounded_y)[..., None]) / bounded_y[..., None]
    curvature = _slope(m, n, np.log(np.full_like(n, _LEAST))) * b / _LEAST
    inner = (slope * ratio).sum(axis=-1)
    return np.asarray(share * inner + (1.0 - share) * curvature.sum(axis=-1))
