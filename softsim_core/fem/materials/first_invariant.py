r"""Laws of rubber whose resistance to stretching is a function of I_C = F : F alone.

.. math:: W(F) = \psi(t), \quad t = I_C - 3, \qquad dW/dF = 2 \psi' F, \qquad
    d^2W = 2 \psi' dF + 4 \psi'' (F : dF) F
"""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.fem.materials.rubber import RestModuli, Rubber


class Slopes(NamedTuple):
    """psi, its first and its second derivative by t at some t, in [Pa]."""

    value: Array
    first: Array
    second: Array


class FirstInvariantRubber(Rubber):
    """See the module; a new law gives `psi`, with psi'(0) > 0, and `first_lame`."""

    @abstractmethod
    def psi(self, t: Array, p: Array) -> Slopes:
        """Values, 0 at rest, and derivatives at t = I_C - 3 (...) and values p (..., k)."""

    @abstractmethod
    def first_lame(self, p: Array) -> Array:
        """Lame's lambda of Hooke's law in [Pa], shape (...)."""

    def rest_moduli(self, p: Array) -> RestModuli:
        """See Rubber."""
        at_rest = self.psi(np.zeros(p.shape[:-1]), p)
        shear = 2.0 * at_rest.first
        return RestModuli(self.first_lame(p), shear, shear, 4.0 * at_rest.second)

    def stretching_energy(self, deformation: Array, p: Array) -> Array:
        """See Rubber."""
        return self.psi(_t(deformation), p).value

    def stretching_stress(self, deformation: Array, p: Array) -> Array:
        """See Rubber."""
        return np.asarray(2.0 * self.psi(_t(deformation), p).first[..., None, None] * deformation)

    def stretching_tangent(self, deformation: Array, p: Array) -> Array:
        """See Rubber."""
        at = self.psi(_t(deformation), p)
        first, second = at.first[..., None, None, None, None], at.second[..., None, None, None, None]
        result = 4.0 * second * np.einsum("...ij,...kl->...ijkl", deformation, deformation)
        return np.asarray(result + 2.0 * first * np.eye(9).reshape(3, 3, 3, 3))


class SeriesRubber(FirstInvariantRubber):
    r"""Laws with :math:`\psi = c_1 t + c_2 t^2 + c_3 t^3 - l \ln (1 + t/4)`."""

    @abstractmethod
    def series(self, p: Array) -> Array:
        """The coefficients c1, c2, c3 and l in [Pa], shape (..., 4)."""

    def psi(self, t: Array, p: Array) -> Slopes:
        """See FirstInvariantRubber."""
        c1, c2, c3, log = np.moveaxis(self.series(p), -1, 0)
        over = 1.0 / (t + 4.0)
        return Slopes(
            t * (c1 + t * (c2 + t * c3)) - log * np.log1p(0.25 * t),
            c1 + t * (2.0 * c2 + 3.0 * t * c3) - log * over,
            2.0 * c2 + 6.0 * t * c3 + log * over**2,
        )


def _t(deformation: Array) -> Array:
    """I_C - 3, shape (...)."""
    return np.asarray((deformation**2).sum(axis=(-2, -1)) - 3.0)
