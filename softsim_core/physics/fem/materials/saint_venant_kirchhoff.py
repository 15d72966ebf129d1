r"""Saint Venant-Kirchhoff elasticity: Hooke's law between the Green strain and the second Piola stress.

.. math:: \Psi = \mu |E|^2 + \tfrac{\lambda}{2} tr(E)^2, \qquad E = \tfrac12 (F^T F - I), \qquad P = F S,
    \qquad S = 2 \mu E + \lambda tr(E) I

MuJoCo's flexes use this law; it is here for comparison with them. It stiffens in tension and softens in
compression: a cell compressed to less than about half its length snaps through, and a crushed cell does not
recover.

Source: Bonet and Wood 2008, Nonlinear continuum mechanics for finite element analysis, section 6.4.2.
"""

from __future__ import annotations

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.fem.materials.law import HOOKE, Material, lame

_UNIT = np.eye(3)


class SaintVenantKirchhoff(Material):
    """Saint Venant-Kirchhoff elasticity, for comparison with MuJoCo's flexes."""

    name = "saint_venant_kirchhoff"
    parameters = HOOKE

    def energy(self, deformation: Array, p: Array) -> Array:
        """Return the energy density mu |E|^2 + lambda/2 tr(E)^2 in [J/m^3], shape (...)."""
        strain = _green(deformation)
        lam, mu = lame(p)
        return np.asarray(mu * (strain**2).sum(axis=(-2, -1)) + 0.5 * lam * _trace(strain) ** 2)

    def stress(self, deformation: Array, p: Array) -> Array:
        """Return the first Piola stress F S in [Pa], shape (..., 3, 3)."""
        return np.asarray(deformation @ _second(deformation, p))

    def tangent(self, deformation: Array, p: Array) -> Array:
        """Return the exact tangent dP_ij / dF_kl in [Pa], shape (..., 3, 3, 3, 3)."""
        lam, mu = (each[..., None, None, None, None] for each in lame(p))
        result = lam * np.einsum("...ij,...kl->...ijkl", deformation, deformation)
        left = deformation @ np.swapaxes(deformation, -1, -2)
        result = result + mu * np.einsum("...ik,jl->...ijkl", left, _UNIT)
        result = result + mu * np.einsum("...il,...kj->...ijkl", deformation, deformation)
        return np.asarray(result + np.einsum("ik,...jl->...ijkl", _UNIT, _second(deformation, p)))

    @staticmethod
    def stress_and_tangent(f: Array, p: Array, stress: Array, tangent: Array) -> None:
        """Set stress and tangent at one point, see Material."""
        mu = p[0] / (2.0 * (1.0 + p[1]))
        lam = 2.0 * mu * p[1] / (1.0 - 2.0 * p[1])
        left, second = np.zeros((3, 3)), np.zeros((3, 3))
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    left[i, j] += f[i, k] * f[j, k]
                    second[i, j] += mu * f[k, i] * f[k, j]
        for i in range(3):
            second[i, i] += 0.5 * lam * (left[0, 0] + left[1, 1] + left[2, 2] - 3.0) - mu
        for i in range(3):
            for j in range(3):
                stress[i, j] = f[i, 0] * second[0, j] + f[i, 1] * second[1, j] + f[i, 2] * second[2, j]
                for k in range(3):
                    for n in range(3):
                        tangent[i, j, k, n] = lam * f[i, j] * f[k, n] + mu * f[i, n] * f[k, j]
                    tangent[i, j, k, j] += mu * left[i, k]
                for n in range(3):
                    tangent[i, j, i, n] += second[j, n]


def _green(deformation: Array) -> Array:
    """Return the Green strain E, shape (..., 3, 3)."""
    return np.asarray(0.5 * (np.swapaxes(deformation, -1, -2) @ deformation - _UNIT))


def _trace(strain: Array) -> Array:
    return np.asarray(np.trace(strain, axis1=-2, axis2=-1))


def _second(deformation: Array, p: Array) -> Array:
    """Return the second Piola stress S in [Pa], symmetric, shape (..., 3, 3)."""
    strain = _green(deformation)
    lam, mu = (each[..., None, None] for each in lame(p))
    return np.asarray(2.0 * mu * strain + lam * _trace(strain)[..., None, None] * _UNIT)
