r"""Stable neo-Hookean rubber: a law of large strain that rests where it should and survives inversion.

.. math:: \Psi = \tfrac{\mu}{2} (I_C - 3) + \tfrac{\lambda}{2} (J - \alpha)^2 - \tfrac{\mu}{2} \ln(I_C + 1) ,
    \qquad I_C = F : F, \quad J = \det F, \quad \alpha = 1 + \tfrac{3 \mu}{4 \lambda}

(shifted to zero at rest). Its parameters come from the Lame parameters of Hooke's law by
:math:`\mu = \tfrac43 \mu_H`, :math:`\lambda = \lambda_H + \tfrac56 \mu_H`: both agree at small
strain.

Source: Smith, de Goes, Kim 2018, Stable neo-Hookean flesh simulation, equation 14 and section 3.4.
"""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array
from softsim_core.fem.materials.isotropic import HOOKE, lame
from softsim_core.fem.materials.material import Material


class StableNeoHookean(Material):
    """See the module."""

    name = "stable_neo_hookean"
    parameters = HOOKE

    def energy(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        lam, mu, alpha = _moduli(p)
        stretch, volume = _stretch(deformation), np.linalg.det(deformation)
        at_rest = 0.5 * lam * (1.0 - alpha) ** 2 - 0.5 * mu * np.log(4.0)
        log = np.log(stretch + 1.0)
        return np.asarray(0.5 * mu * (stretch - 3.0 - log) + 0.5 * lam * (volume - alpha) ** 2 - at_rest)

    def stress(self, deformation: Array, p: Array) -> Array:
        """Mu (1 - 1 / (I_C + 1)) F + lambda (J - alpha) cof F; see Material."""
        lam, mu, alpha = _moduli(p)
        shear = mu * (1.0 - 1.0 / (_stretch(deformation) + 1.0))
        pressure = lam * (np.linalg.det(deformation) - alpha)
        return np.asarray(
            shear[..., None, None] * deformation + pressure[..., None, None] * cofactor(deformation)
        )

    def tangent(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        lam, mu, alpha = (each[..., None, None, None, None] for each in _moduli(p))
        stretch = _stretch(deformation)[..., None, None, None, None] + 1.0
        pressure = lam * (np.linalg.det(deformation)[..., None, None, None, None] - alpha)
        sides = cofactor(deformation)
        result = mu * (1.0 - 1.0 / stretch) * np.eye(9).reshape(3, 3, 3, 3)
        result = result + 2.0 * mu / stretch**2 * np.einsum("...ij,...kl->...ijkl", deformation, deformation)
        result = result + lam * np.einsum("...ij,...kl->...ijkl", sides, sides)
        return np.asarray(result + pressure * cofactor_slope(deformation))


def cofactor(matrices: Array) -> Array:
    """D det F / dF: the cofactors of matrices (..., 3, 3), also of singular ones."""
    a, b, c = matrices[..., 0, :], matrices[..., 1, :], matrices[..., 2, :]
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)


def cofactor_slope(matrices: Array) -> Array:
    """D cof F_ij / dF_kl = e_ikm e_jln F_mn, shape (..., 3, 3, 3, 3)."""
    return np.asarray(
        np.einsum("ikm,jln,...mn->...ijkl", _LEVI_CIVITA, _LEVI_CIVITA, matrices, optimize=True)
    )


_LEVI_CIVITA = np.zeros((3, 3, 3))
_LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


def _stretch(deformation: Array) -> Array:
    """I_C = F : F, shape (...)."""
    return np.asarray((deformation**2).sum(axis=(-2, -1)))


def _moduli(p: Array) -> tuple[Array, Array, Array]:
    """The law's own lambda, mu in [Pa] and alpha."""
    lam, mu = lame(p)
    own_lam, own_mu = lam + 5.0 / 6.0 * mu, 4.0 / 3.0 * mu
    return own_lam, own_mu, 1.0 + 0.75 * own_mu / own_lam
