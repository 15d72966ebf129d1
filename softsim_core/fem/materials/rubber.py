r"""What all laws of rubber share: a part that resists stretching, and one that resists a change of volume.

.. math:: \Psi(F) = W(F) - s (J - 1) + \tfrac{a}{2} (J - 1)^2, \qquad J = \det F

s is the slope of W by each principal stretch at rest, so that nothing is stressed there, and
a = lambda + s - c makes the law Hooke's at small strain, c being the mixed second derivative of W by two
principal stretches at rest. W uses the whole F, not F freed of its change of volume, and never its inverse:
an element that is inside out is no special case.

Source: Smith, de Goes, Kim 2018, Stable neo-Hookean flesh simulation, for W of I_C alone.
"""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Mapping
from typing import NamedTuple, TypeVar

import numpy as np

from softsim_core.arrays import Array
from softsim_core.fem.materials.cofactors import cofactor, cofactor_slope
from softsim_core.fem.materials.material import Material, Refusal

R = TypeVar("R", bound="Rubber")


class RestModuli(NamedTuple):
    """What a law of rubber is at rest, each in [Pa], shape (...).

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


class Rubber(Material):
    """See the module; a new law gives `rest_moduli` and the energy, stress and tangent of W."""

    _other_bulk: Array | None = None

    @abstractmethod
    def rest_moduli(self, p: Array) -> RestModuli:
        """The moduli at rest of parameter values p (..., k)."""

    @abstractmethod
    def stretching_energy(self, deformation: Array, p: Array) -> Array:
        """W in [J/m^3], 0 at rest, shape (...)."""

    @abstractmethod
    def stretching_stress(self, deformation: Array, p: Array) -> Array:
        """DW/dF in [Pa], shape (..., 3, 3)."""

    @abstractmethod
    def stretching_tangent(self, deformation: Array, p: Array) -> Array:
        """D2W/dF2 in [Pa], shape (..., 3, 3, 3, 3)."""

    def bulk(self, p: Array) -> Array:
        """The coefficient a of (J - 1)^2 / 2 in [Pa], shape (...)."""
        if self._other_bulk is not None:
            return self._other_bulk
        return rest_bulk(self.rest_moduli(p))

    def with_bulk(self: R, bulk: Array) -> R:
        """The same law with another a in [Pa], which broadcasts with (...); W and s stay as they are.

        So an element can take a part of the volume's resistance at its points, and the rest elsewhere.
        """
        changed = copy.copy(self)
        changed._other_bulk = np.asarray(bulk, dtype=float)
        return changed

    def shear(self, p: Array) -> Array:
        """Shear modulus at rest in [Pa], shape (...)."""
        return self.rest_moduli(p).shear

    def energy(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        change = np.linalg.det(deformation) - 1.0
        slope = self.rest_moduli(p).slope
        volume = (0.5 * self.bulk(p) * change - slope) * change
        return np.asarray(self.stretching_energy(deformation, p) + volume)

    def stress(self, deformation: Array, p: Array) -> Array:
        """DW/dF + (a (J - 1) - s) cof F; see Material."""
        stretching = self.stretching_stress(deformation, p)
        return np.asarray(
            stretching + self._pressure(deformation, p)[..., None, None] * cofactor(deformation)
        )

    def tangent(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        sides, bulk = cofactor(deformation), self.bulk(p)[..., None, None, None, None]
        pressure = self._pressure(deformation, p)[..., None, None, None, None]
        result = self.stretching_tangent(deformation, p)
        result = result + bulk * np.einsum("...ij,...kl->...ijkl", sides, sides)
        return np.asarray(result + pressure * cofactor_slope(deformation))

    def volume_refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """Refuses a Poisson ratio with which a is not > 0: volume would not be resisted far from rest."""
        moduli = self.rest_moduli(np.array([values[name] for name in self.names]))
        if rest_bulk(moduli) > 0.0:
            return None
        excess = float(moduli.cross - moduli.slope)
        least = excess / (2.0 * (float(moduli.shear) + excess))
        return Refusal("poisson_ratio", f"> {least:.4g} with these constants, or its volume is not kept")

    def _pressure(self, deformation: Array, p: Array) -> Array:
        return np.asarray(self.bulk(p) * (np.linalg.det(deformation) - 1.0) - self.rest_moduli(p).slope)


def rest_bulk(at_rest: RestModuli) -> Array:
    """The a with which the law is Hooke's at small strain, in [Pa]."""
    return np.asarray(at_rest.first_lame + at_rest.slope - at_rest.cross)
