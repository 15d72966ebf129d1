r"""Laws of thin reinforcements: stress as a function of the Green strain along given axes.

With :math:`E = (F^T F - 1) / 2` and the second Piola stress :math:`S = \partial \Psi / \partial E`,

.. math:: P = F S, \qquad
    \frac{\partial P_{ij}}{\partial F_{kl}} = \delta_{ik} S_{lj} + F_{iI} \frac{\partial S_{Ij}}{\partial
        E_{lK}} F_{kK} .

Fibres and layers are stiff and thin, so a rotation within one step, linearised, strains them far more than
their loads do. As with nearly incompressible rubber, a step therefore takes the stress that its linear solve
found; see fem.cells.cell_stiffness.

Source: Bonet, Wood 2008, Nonlinear continuum mechanics for finite element analysis, 5.4 and 6.4.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from softsim_core.base import Array, FactorisationError
from softsim_core.physics.fem.materials.law import (
    POISSON_RATIO,
    YOUNG_MODULUS,
    Material,
    MaterialParameter,
)

SLACK = -1e-9
"""Green strain above which fibres have the stiffness of taut ones.

Negative, to allow for rounding at rest.
"""

_IDENTITY = np.eye(3)


class StrainMaterial(Material):
    """A law in axes of its own: the first axis is along fibres, the third is normal to layers."""

    in_cell_axes = True

    @abstractmethod
    def second_piola(self, strain: Array, p: Array) -> Array:
        """Return S in [Pa] at Green strains, symmetric, both of shape (..., 3, 3)."""

    @abstractmethod
    def moduli(self, strain: Array, p: Array) -> Array:
        """Return dS/dE in [Pa] with both minor symmetries, shape (..., 3, 3, 3, 3)."""

    def strain(self, deformation: Array) -> Array:
        """Return the Green strain, shape (..., 3, 3)."""
        return np.asarray(0.5 * (np.swapaxes(deformation, -1, -2) @ deformation - _IDENTITY))

    def energy(self, deformation: Array, p: Array) -> Array:
        """Return the energy density S : E / 2 of a law linear in E, in [J/m^3], shape (...)."""
        strain = self.strain(deformation)
        return np.asarray(0.5 * np.einsum("...ij,...ij->...", self.second_piola(strain, p), strain))

    def stress(self, deformation: Array, p: Array) -> Array:
        """Return the first Piola stress F S in [Pa], shape (..., 3, 3)."""
        return np.asarray(deformation @ self.second_piola(self.strain(deformation), p))

    def tangent(self, deformation: Array, p: Array) -> Array:
        """Return the exact tangent dP_ij / dF_kl in [Pa], shape (..., 3, 3, 3, 3)."""
        return self.tangent_at(deformation, p, self.second_piola(self.strain(deformation), p))

    def positive_tangent(self, deformation: Array, p: Array) -> Array:
        """Return the tangent for a time step in [Pa], shape (..., 3, 3, 3, 3).

        Its geometric part omits the compressive part of the stress, so it has no negative eigenvalues.
        """
        stress = self.second_piola(self.strain(deformation), p)
        return self.tangent_at(deformation, p, without_pressing(stress))

    def tangent_at(self, deformation: Array, p: Array, stress: Array) -> Array:
        """Return the tangent for a given second Piola stress (..., 3, 3) in [Pa], shape (..., 3, 3, 3, 3)."""
        moduli = self.moduli(self.strain(deformation), p)
        elastic = np.einsum("...ia,...ajlb,...kb->...ijkl", deformation, moduli, deformation, optimize=True)
        return np.asarray(elastic + np.einsum("ik,...lj->...ijkl", _IDENTITY, stress))

    def extrapolated_stress(self, before: Array, change: Array, p: Array) -> Array:
        """Return S in [Pa] after a `change` of the deformation `before`, to first order, each (..., 3, 3)."""
        strain = self.strain(before)
        stretching = np.swapaxes(before, -1, -2) @ change
        stretching = 0.5 * (stretching + np.swapaxes(stretching, -1, -2))
        moved = np.einsum("...abcd,...cd->...ab", self.moduli(strain, p), stretching)
        return np.asarray(self.second_piola(strain, p) + moved)


class Membrane(StrainMaterial):
    r"""A thin isotropic sheet in plane stress: paper, fabric, foil.

    .. math:: S = \frac{E_Y}{1 - \nu^2} \bigl((1 - \nu) E + \nu \operatorname{tr}(E)\bigr)

    in its plane, with Young modulus and Poisson ratio; it has no bending stiffness of its own.
    """

    name = "membrane"
    parameters = (YOUNG_MODULUS, POISSON_RATIO)

    def second_piola(self, strain: Array, p: Array) -> Array:
        """Return S in [Pa] at Green strains, zero normal to the sheet, both of shape (..., 3, 3)."""
        stiff, ratio = p[..., 0] / (1.0 - p[..., 1] ** 2), p[..., 1]
        stress = np.zeros(np.broadcast_shapes(strain.shape, (*p.shape[:-1], 3, 3)))
        plane = strain[..., :2, :2]
        stress[..., :2, :2] = (stiff * (1.0 - ratio))[..., None, None] * plane
        trace = stiff * ratio * (plane[..., 0, 0] + plane[..., 1, 1])
        stress[..., 0, 0] += trace
        stress[..., 1, 1] += trace
        return stress

    def moduli(self, strain: Array, p: Array) -> Array:
        """Return dS/dE in [Pa] with both minor symmetries, shape (..., 3, 3, 3, 3)."""
        stiff, ratio = p[..., 0] / (1.0 - p[..., 1] ** 2), p[..., 1]
        moduli = np.zeros((*np.broadcast_shapes(strain.shape[:-2], p.shape[:-1]), 3, 3, 3, 3))
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            half = 0.5 * stiff * (1.0 - ratio)
            moduli[..., i, j, i, j] += half
            moduli[..., i, j, j, i] += half
            moduli[..., i, i, j, j] += stiff * ratio
        return moduli


class Fibres(StrainMaterial):
    r"""Fibres along the first axis that carry tension only, smeared over the rubber between them.

    .. math:: \Psi = \tfrac{k}{2} (I_4 - 1)^2 \text{ where } I_4 = |F e_1|^2 > 1, \text{ else } 0

    At rest, their Young modulus times the share of the volume that they fill is 4 k.
    """

    name = "fibres"
    parameters = (MaterialParameter("stiffness", "Pa", "Stiffness in tension, k of k/2 (I4 - 1)^2", 0.0),)

    def energy(self, deformation: Array, p: Array) -> Array:
        """Return the energy density in [J/m^3], zero in compression, shape (...)."""
        return np.asarray(2.0 * p[..., 0] * np.maximum(self.strain(deformation)[..., 0, 0], 0.0) ** 2)

    def second_piola(self, strain: Array, p: Array) -> Array:
        """Return S in [Pa] at Green strains, zero in compression, both of shape (..., 3, 3)."""
        stress = np.zeros(np.broadcast_shapes(strain.shape, (*p.shape[:-1], 3, 3)))
        stress[..., 0, 0] = 4.0 * p[..., 0] * np.maximum(strain[..., 0, 0], 0.0)
        return stress

    def moduli(self, strain: Array, p: Array) -> Array:
        """Return dS/dE in [Pa], zero below the strain SLACK, shape (..., 3, 3, 3, 3)."""
        moduli = np.zeros((*np.broadcast_shapes(strain.shape[:-2], p.shape[:-1]), 3, 3, 3, 3))
        moduli[..., 0, 0, 0, 0] = 4.0 * p[..., 0] * (strain[..., 0, 0] > SLACK)
        return moduli


def without_pressing(stress: Array) -> Array:
    """Return symmetric stresses (..., 3, 3) with negative principal values set to zero.

    Raises:
        FactorisationError: a stress is not finite.
    """
    if not np.isfinite(stress).all():
        raise FactorisationError("the deformation of a layer or of fibres is not finite")
    values, vectors = np.linalg.eigh(stress)
    return np.asarray((vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2))


MEMBRANE, FIBRES = Membrane(), Fibres()
