"""Cofactors of matrices, d det F / dF, and what an energy of them gives for F."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array

_LEVI_CIVITA = np.zeros((3, 3, 3))
_LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


def cofactor(matrices: Array) -> Array:
    """D det F / dF: the cofactors of matrices (..., 3, 3), also of singular ones."""
    rows_first = np.moveaxis(matrices, (-2, -1), (0, 1))
    return np.ascontiguousarray(np.moveaxis(cofactor_first(rows_first), (0, 1), (-2, -1)))


def cofactor_first(matrices: Array) -> Array:
    """Cofactors of matrices with rows and columns first, shape (3, 3, ...): fast where there are many."""
    after, before = [1, 2, 0], [2, 0, 1]
    first, second = matrices[after], matrices[before]
    return np.asarray(first[:, after] * second[:, before] - first[:, before] * second[:, after])


def cofactor_slope(matrices: Array) -> Array:
    """D cof F_ij / dF_kl = e_ikm e_jln F_mn, shape (..., 3, 3, 3, 3)."""
    return np.asarray(
        np.einsum("ikm,jln,...mn->...ijkl", _LEVI_CIVITA, _LEVI_CIVITA, matrices, optimize=True)
    )


def stress_of_cofactor(matrices: Array, slope: Array) -> Array:
    """dV/dF, shape (..., 3, 3), of an energy V(cof F) with the slope dV/d cof F (..., 3, 3)."""
    return np.asarray(np.einsum("...ijkl,...kl->...ij", cofactor_slope(matrices), slope))


def tangent_of_cofactor(matrices: Array, slope: Array, curvature: Array) -> Array:
    """d2V/dF2 of an energy V(cof F) with that slope and the curvature d2V/d(cof F)2, (..., 3, 3, 3, 3)."""
    outer = cofactor_slope(matrices)
    nine = outer.reshape(*outer.shape[:-4], 9, 9)
    middle = curvature.reshape(*curvature.shape[:-4], 9, 9)
    turned = nine @ middle @ nine
    return np.asarray(turned.reshape(*turned.shape[:-2], 3, 3, 3, 3) + cofactor_slope(slope))
