r"""Mooney-Rivlin rubber, restricted to stable constants.

.. math:: W = C_{10} (I_C - 3) + C_{01} (II_C - 3), \qquad II_C = |cof F|^2, \qquad \mu = 2 (C_{10} + C_{01})

A fit to a uniaxial tension curve alone often gives C01 < 0. Beyond some equibiaxial stretch, the tension of
such a law decreases, so a membrane of it has no equilibrium; strong compression is equivalent to such a
stretch. Negative C01 are therefore refused.

Sources: Mooney 1940, A theory of large elastic deformation; Rivlin 1948.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.fem.materials.law import (
    POISSON_RATIO,
    STIFFNESS_FACTOR,
    MaterialParameter,
    Refusal,
    first_lame,
)
from softsim_core.physics.fem.materials.rubber import RestModuli, Rubber
from softsim_core.physics.fem.materials.stretches import cofactor, stress_of_cofactor, tangent_of_cofactor


class MooneyRivlin(Rubber):
    """Mooney-Rivlin rubber with the constants C10 > 0 and C01 >= 0."""

    name = "mooney_rivlin"
    parameters = (
        MaterialParameter("c10", "Pa", "C10, resists the stretching of lines", 0.0),
        MaterialParameter("c01", "Pa", "C01, resists the stretching of areas"),
        POISSON_RATIO,
        STIFFNESS_FACTOR,
    )

    def rest_moduli(self, p: Array) -> RestModuli:
        """Return the moduli at rest for parameter values p (..., k)."""
        c10, c01 = _constants(p)
        shear = 2.0 * (c10 + c01)
        return RestModuli(first_lame(shear, p[..., 2]), shear, 2.0 * c10 + 4.0 * c01, 4.0 * c01)

    def stretching_energy(self, deformation: Array, p: Array) -> Array:
        """Return W = C10 (|F|^2 - 3) + C01 (|cof F|^2 - 3) in [J/m^3], shape (...)."""
        c10, c01 = _constants(p)
        lines, areas = ((each**2).sum(axis=(-2, -1)) - 3.0 for each in (deformation, cofactor(deformation)))
        return np.asarray(c10 * lines + c01 * areas)

    def stretching_stress(self, deformation: Array, p: Array) -> Array:
        """Return dW/dF in [Pa], shape (..., 3, 3)."""
        c10, c01 = (2.0 * each[..., None, None] for each in _constants(p))
        return c10 * deformation + stress_of_cofactor(deformation, c01 * cofactor(deformation))

    def stretching_tangent(self, deformation: Array, p: Array) -> Array:
        """Return d2W/dF2 in [Pa], shape (..., 3, 3, 3, 3)."""
        c10, c01 = (2.0 * each[..., None, None] for each in _constants(p))
        identity = np.eye(9).reshape(3, 3, 3, 3)
        curvature = c01[..., None, None] * identity
        areas = tangent_of_cofactor(deformation, c01 * cofactor(deformation), curvature)
        return np.asarray(c10[..., None, None] * identity + areas)

    def refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """Refuse C01 < 0, for which the law is not stable at every stretch, and too small Poisson ratios."""
        c10, c01 = values["c10"], values["c01"]
        if c01 <= -c10:
            return Refusal("c01", f">= 0 Pa; below {-c10:g} Pa the law has no stiffness at all")
        if c01 < 0.0:
            most = f"{stable_stretch(c10, c01):.3g}"
            return Refusal(
                "c01", f">= 0 Pa; with it the law gives way when stretched to {most} along two axes"
            )
        return self.volume_refusal(values)


def stable_stretch(c10: float, c01: float) -> float:
    """Return the equibiaxial stretch beyond which the tension of a law with C01 < 0 decreases, in [-], > 1.

    There :math:`P = 2 (l - l^{-5}) (C_{10} + C_{01} l^2)` has its maximum.

    Args:
        c10: C10 in [Pa], > 0.
        c01: C01 in [Pa], between -c10 and 0.
    """

    def rise(stretch: float) -> float:
        pull = (1.0 + 5.0 * stretch**-6) * (c10 + c01 * stretch**2)
        return pull + (stretch - stretch**-5) * 2.0 * c01 * stretch

    low, high = 1.0, np.sqrt(-c10 / c01)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rise(middle) > 0.0 else (low, middle)
    return float(low)


def _constants(p: Array) -> tuple[Array, Array]:
    """Return C10 and C01 in [Pa], shapes (...), scaled by the stiffness factor."""
    return p[..., 3] * p[..., 0], p[..., 3] * p[..., 1]
