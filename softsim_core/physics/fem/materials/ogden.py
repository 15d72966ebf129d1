r"""Ogden rubber: two powers of the principal stretches, which fit a tension curve up to break.

.. math:: W = \sum_k \tfrac{m_k}{\alpha_k^2} \left(v_{k1}^{|\alpha_k|} + v_{k2}^{|\alpha_k|} +
    v_{k3}^{|\alpha_k|} - 3\right), \qquad \mu = \tfrac12 \sum_k m_k

v are the stretches of lines where alpha > 0. Where alpha < 0 they are the stretches of areas, the products of
two line stretches; at constant volume these give the same powers as the line stretches with alpha itself. A
flat element therefore has a finite energy, and an inverted one recovers. In the other notation
:math:`m_k = \mu_k \alpha_k`.

Sources: Ogden 1972, Large deformation isotropic elasticity; Ciarlet 1988, Mathematical elasticity I, section
4.9, for the powers of areas.
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
from softsim_core.physics.fem.materials.stretches import (
    Powers,
    cofactor,
    power_curvature,
    power_energy,
    power_slope,
    stress_of_cofactor,
    tangent_of_cofactor,
)

LEAST_EXPONENT = 0.25
LARGEST_EXPONENT = 30.0


class Ogden(Rubber):
    """Ogden rubber of one or two terms; without the second term m2 = 0."""

    name = "ogden"
    parameters = (
        MaterialParameter("m1", "Pa", "First term, twice its share of the shear modulus", 0.0),
        MaterialParameter("alpha1", "-", "Exponent of the first term"),
        MaterialParameter("m2", "Pa", "Second term, twice its share of the shear modulus", default=0.0),
        MaterialParameter("alpha2", "-", "Exponent of the second term", default=2.0),
        POISSON_RATIO,
        STIFFNESS_FACTOR,
    )

    def rest_moduli(self, p: Array) -> RestModuli:
        """Return the moduli at rest for parameter values p (..., k)."""
        m, alpha = _terms(p)
        shear, areas = 0.5 * m.sum(axis=-1), alpha < 0.0
        slope = (np.where(areas, 2.0, 1.0) * m / np.abs(alpha)).sum(axis=-1)
        return RestModuli(first_lame(shear, p[..., 4]), shear, slope, np.where(areas, m, 0.0).sum(axis=-1))

    def stretching_energy(self, deformation: Array, p: Array) -> Array:
        """Return W in [J/m^3], zero at rest, shape (...)."""
        lines, areas = _powers(p)
        result = power_energy(deformation, lines)
        return result if areas is None else result + power_energy(cofactor(deformation), areas)

    def stretching_stress(self, deformation: Array, p: Array) -> Array:
        """Return dW/dF in [Pa], shape (..., 3, 3)."""
        lines, areas = _powers(p)
        result = power_slope(deformation, lines)
        if areas is None:
            return result
        return result + stress_of_cofactor(deformation, power_slope(cofactor(deformation), areas))

    def stretching_tangent(self, deformation: Array, p: Array) -> Array:
        """Return d2W/dF2 in [Pa], shape (..., 3, 3, 3, 3)."""
        lines, areas = _powers(p)
        result = power_curvature(deformation, lines)
        if areas is None:
            return result
        sides = cofactor(deformation)
        slope, curvature = power_slope(sides, areas), power_curvature(sides, areas)
        return result + tangent_of_cofactor(deformation, slope, curvature)

    def refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """Refuse a negative second term, exponents out of range and too small Poisson ratios.

        A negative term would push where it should pull; an exponent near zero would make a term constant.
        """
        if values["m2"] < 0.0:
            return Refusal("m2", ">= 0 Pa, or the law gives way")
        for name in ("alpha1", "alpha2"):
            if not LEAST_EXPONENT <= abs(values[name]) <= LARGEST_EXPONENT:
                ends = f"{LEAST_EXPONENT:g} and {LARGEST_EXPONENT:g}"
                return Refusal(
                    name, f"between {ends} or between -{LARGEST_EXPONENT:g} and -{LEAST_EXPONENT:g}"
                )
        return self.volume_refusal(values)


def _terms(p: Array) -> tuple[Array, Array]:
    """Return the amplitudes m in [Pa] and exponents alpha of both terms, shapes (..., 2)."""
    return p[..., 5:6] * p[..., 0:3:2], p[..., 1:4:2]


def _powers(p: Array) -> tuple[Powers, Powers | None]:
    """Return the terms in line stretches, and those in area stretches or None if there are none."""
    m, alpha = _terms(p)
    is_area, size = alpha < 0.0, np.abs(alpha)
    lines = Powers(np.where(is_area, 0.0, m), size)
    in_areas = np.where(is_area, m, 0.0)
    return lines, Powers(in_areas, size) if in_areas.any() else None
