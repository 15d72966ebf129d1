r"""Base classes of rubber laws: resistance to stretching and to a change of volume.

.. math:: \Psi(F) = W(F) - s (J - 1) + \tfrac{a}{2} (J - 1)^2, \qquad J = \det F

s is the slope of W by each principal stretch at rest, so that the rest shape is free of stress, and
a = lambda + s - c makes the law equal Hooke's at small strain; c is the mixed second derivative of W by two
principal stretches at rest. W uses the whole F, not its isochoric part, and never its inverse, so an inverted
element is no special case.

Source: Smith, de Goes, Kim 2018, Stable neo-Hookean flesh simulation, for W of I_C alone.

.. math:: W(F) = \psi(t), \quad t = I_C - 3, \qquad dW/dF = 2 \psi' F, \qquad
    d^2W = 2 \psi' dF + 4 \psi'' (F : dF) F
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.fem.materials.law import Refusal, VolumetricMaterial
from softsim_core.physics.fem.materials.stretches import cofactor, cofactor_slope


class RestModuli(NamedTuple):
    """Moduli of a rubber law at rest, each in [Pa], shape (...).

    Attributes:
        first_lame: lambda of Hooke's law.
        shear: mu of Hooke's law.
        slope: dW/dl of each principal stretch l.
        cross: d2W/dl dm of two principal stretches l and m.
    """

    first_lame: Array
    shear: Array
    slope: Array
    cross: Array


class Rubber(VolumetricMaterial):
    """Base class of rubber laws, with theta = J - 1.

    A new law implements `rest_moduli` and the energy, stress and tangent of W.
    """

    @abstractmethod
    def rest_moduli(self, p: Array) -> RestModuli:
        """Return the moduli at rest for parameter values p (..., k)."""

    @abstractmethod
    def stretching_energy(self, deformation: Array, p: Array) -> Array:
        """Return W in [J/m^3], zero at rest, shape (...)."""

    @abstractmethod
    def stretching_stress(self, deformation: Array, p: Array) -> Array:
        """Return dW/dF in [Pa], shape (..., 3, 3)."""

    @abstractmethod
    def stretching_tangent(self, deformation: Array, p: Array) -> Array:
        """Return d2W/dF2 in [Pa], shape (..., 3, 3, 3, 3)."""

    def bulk(self, p: Array) -> Array:
        """Return the bulk coefficient a = lambda + s - c in [Pa], shape (...)."""
        return rest_bulk(self.rest_moduli(p))

    def point_bulk(self, p: Array, ratio: float = 1.0) -> Array:
        """Return the bulk coefficient with lambda limited to `ratio` mu in [Pa], shape (...)."""
        at_rest = self.rest_moduli(p)
        return rest_bulk(at_rest._replace(first_lame=np.minimum(at_rest.first_lame, ratio * at_rest.shear)))

    def dilatation(self, deformation: Array) -> Array:
        """Return theta = J - 1, shape (...)."""
        return np.asarray(np.linalg.det(deformation) - 1.0)

    def dilatation_slope(self, deformation: Array) -> Array:
        """Return d theta / dF, the cofactor of F, shape (..., 3, 3)."""
        return cofactor(deformation)

    def shear_energy(self, deformation: Array, p: Array) -> Array:
        """Return W - s (J - 1) in [J/m^3], shape (...)."""
        volume = self.rest_moduli(p).slope * self.dilatation(deformation)
        return np.asarray(self.stretching_energy(deformation, p) - volume)

    def shear_stress(self, deformation: Array, p: Array) -> Array:
        """Return dW/dF - s cof F in [Pa], shape (..., 3, 3)."""
        slope = self.rest_moduli(p).slope[..., None, None]
        return np.asarray(self.stretching_stress(deformation, p) - slope * cofactor(deformation))

    def tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """Return W'' + bulk J' J' + (pressure - s) J'' in [Pa], shape (..., 3, 3, 3, 3)."""
        sides, tension = cofactor(deformation), pressure - self.rest_moduli(p).slope
        result = self.stretching_tangent(deformation, p)
        across = np.einsum("...ij,...kl->...ijkl", sides, sides)
        result = result + bulk[..., None, None, None, None] * across
        return np.asarray(result + tension[..., None, None, None, None] * cofactor_slope(deformation))

    def volume_refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """Refuse a Poisson ratio for which a is not > 0.

        Far from rest, nothing would resist a change of volume.
        """
        moduli = self.rest_moduli(np.array([values[name] for name in self.names]))
        if rest_bulk(moduli) > 0.0:
            return None
        excess = float(moduli.cross - moduli.slope)
        least = excess / (2.0 * (float(moduli.shear) + excess))
        return Refusal("poisson_ratio", f"> {least:.4g} with these constants, or its volume is not kept")


def rest_bulk(at_rest: RestModuli) -> Array:
    """Return the coefficient a for which the law equals Hooke's at small strain, in [Pa]."""
    return np.asarray(at_rest.first_lame + at_rest.slope - at_rest.cross)


class Slopes(NamedTuple):
    """Value, first and second derivative of psi by t, in [Pa]."""

    value: Array
    first: Array
    second: Array


class SeriesRubber(Rubber):
    r"""Rubber laws with W = :math:`\psi(t) = c_1 t + c_2 t^2 + c_3 t^3 - l \ln (1 + t/4)`, t = I_C - 3."""

    @abstractmethod
    def series(self, p: Array) -> Array:
        """Return the coefficients c1, c2, c3 and l in [Pa], shape (..., 4), with psi'(0) > 0."""

    @abstractmethod
    def first_lame(self, p: Array) -> Array:
        """Return Lame's lambda of Hooke's law in [Pa], shape (...)."""

    def psi(self, t: Array, p: Array) -> Slopes:
        """Return psi, zero at rest, and its first two derivatives at t (...) for values p (..., k)."""
        c1, c2, c3, log = np.moveaxis(self.series(p), -1, 0)
        over = 1.0 / (t + 4.0)
        return Slopes(
            t * (c1 + t * (c2 + t * c3)) - log * np.log1p(0.25 * t),
            c1 + t * (2.0 * c2 + 3.0 * t * c3) - log * over,
            2.0 * c2 + 6.0 * t * c3 + log * over**2,
        )

    def rest_moduli(self, p: Array) -> RestModuli:
        """Return the moduli at rest, from psi'(0) and psi''(0)."""
        at_rest = self.psi(np.zeros(p.shape[:-1]), p)
        shear = 2.0 * at_rest.first
        return RestModuli(self.first_lame(p), shear, shear, 4.0 * at_rest.second)

    def stretching_energy(self, deformation: Array, p: Array) -> Array:
        """Return psi(t) in [J/m^3], shape (...)."""
        return self.psi(_t(deformation), p).value

    def stretching_stress(self, deformation: Array, p: Array) -> Array:
        """Return 2 psi' F in [Pa], shape (..., 3, 3)."""
        return np.asarray(2.0 * self.psi(_t(deformation), p).first[..., None, None] * deformation)

    def stretching_tangent(self, deformation: Array, p: Array) -> Array:
        """Return 2 psi' I + 4 psi'' F F in [Pa], shape (..., 3, 3, 3, 3)."""
        at = self.psi(_t(deformation), p)
        first, second = at.first[..., None, None, None, None], at.second[..., None, None, None, None]
        result = 4.0 * second * np.einsum("...ij,...kl->...ijkl", deformation, deformation)
        return np.asarray(result + 2.0 * first * np.eye(9).reshape(3, 3, 3, 3))


def _t(deformation: Array) -> Array:
    """Return I_C - 3, shape (...)."""
    return np.asarray((deformation**2).sum(axis=(-2, -1)) - 3.0)
