r"""Corotational linear elasticity: Hooke's law on what is left when the rotation R of F is taken out.

.. math:: \Psi = \mu |S - I|^2 + \tfrac{\lambda}{2} tr(S - I)^2, \qquad P = \sigma R, \qquad
    \sigma = 2 \mu (S - I) + \lambda tr(S - I) I, \qquad S = sym(F R^T)

Sources: Mueller and Gross 2004; McAdams et al. 2011; Kim and Eberle 2022, Dynamic deformables (its tangent).
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import FactorisationError
from softsim_core.fem.materials.isotropic import HOOKE, lame
from softsim_core.fem.materials.material import Material, VolumetricMaterial

SMALLEST_VOLUME = 1e-6
"""det(tr(S) I - S), 8 at rest, is taken no smaller than this: a crumpled element that is blown up has no
bounded tangent."""

_LEVI_CIVITA = np.zeros((3, 3, 3))
_LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_LEVI_CIVITA[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0


class RotatedHooke(Material):
    """What the laws with a rotation R of their own have in common."""

    parameters = HOOKE

    @abstractmethod
    def rotations(self, deformation: Array) -> Array:
        """Proper rotation R of each deformation gradient, shape (..., 3, 3)."""

    def energy(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        lam, mu = lame(p)
        strain = _stretch(deformation, self.rotations(deformation)) - np.eye(3)
        trace = np.trace(strain, axis1=-2, axis2=-1)
        return np.asarray(mu * (strain**2).sum(axis=(-2, -1)) + 0.5 * lam * trace**2)

    def stress(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        rotation = self.rotations(deformation)
        return np.asarray(hooke_stress(_stretch(deformation, rotation) - np.eye(3), p) @ rotation)

    def distant_tangent(self, deformation: Array, p: Array) -> Array:
        """The tangent with rotations frozen, mu (dF + R dF^T R) + lambda (R : dF) R; see Material."""
        rotation = self.rotations(deformation)
        lam, mu = (each[..., None, None, None, None] for each in lame(p))
        result = lam * np.einsum("...ij,...kl->...ijkl", rotation, rotation)
        result = result + mu * np.eye(9).reshape(3, 3, 3, 3)
        return np.asarray(result + mu * np.einsum("...il,...kj->...ijkl", rotation, rotation))

    def cauchy_stress(self, deformation: Array, stress: Array) -> Array:
        """The rotated stress sigma, which does not count the change of area; see Material."""
        return np.asarray(stress @ np.swapaxes(self.rotations(deformation), -1, -2))


class Corotational(RotatedHooke, VolumetricMaterial):
    """R is the rotation of the polar decomposition, the nearest one to F; inverted elements come back."""

    name = "corotational"

    def rotations(self, deformation: Array) -> Array:
        """See RotatedHooke."""
        return polar_rotations(deformation)

    def bulk(self, p: Array) -> Array:
        """Lambda, on theta = tr(S - I); see VolumetricMaterial."""
        return lame(p)[0]

    def point_bulk(self, p: Array) -> Array:
        """Mu at most; see VolumetricMaterial."""
        return np.asarray(np.minimum(*lame(p)))

    def dilatation(self, deformation: Array) -> Array:
        """tr(S - I); see VolumetricMaterial."""
        return np.asarray((deformation * self.rotations(deformation)).sum(axis=(-2, -1)) - 3.0)

    def dilatation_slope(self, deformation: Array) -> Array:
        """R; see VolumetricMaterial."""
        return self.rotations(deformation)

    def shear_energy(self, deformation: Array, p: Array) -> Array:
        """Mu |S - I|^2; see VolumetricMaterial."""
        strain = _stretch(deformation, self.rotations(deformation)) - np.eye(3)
        return np.asarray(lame(p)[1] * (strain**2).sum(axis=(-2, -1)))

    def shear_stress(self, deformation: Array, p: Array) -> Array:
        """2 mu (S - I) R; see VolumetricMaterial."""
        rotation = self.rotations(deformation)
        strain = _stretch(deformation, rotation) - np.eye(3)
        return np.asarray(2.0 * lame(p)[1][..., None, None] * (strain @ rotation))

    def tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """See VolumetricMaterial; singular where two principal stretches cancel."""
        return self._tangent(deformation, p, bulk, pressure, clamped=False)

    def positive_tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """See VolumetricMaterial.

        Only the modes dF = [w]x R that turn an element can have a negative eigenvalue, 2 mu - 2 g with g
        those of gamma (tr(S) I - S)^-1 and gamma = 2 mu - p: no g is taken larger than mu.
        """
        return self._tangent(deformation, p, bulk, pressure, clamped=True)

    def _tangent(self, deformation: Array, p: Array, bulk: Array, pressure: Array, clamped: bool) -> Array:
        """2 mu I + bulk R R^T - E^T G E, E the axial vector of dF R^T, G = gamma (tr(S) I - S)^-1."""
        rotation = self.rotations(deformation)
        principal, axes = np.linalg.eigh(_stretch(deformation, rotation))
        mu, bulk = lame(p)[1][..., None], bulk[..., None]
        trace = principal.sum(axis=-1, keepdims=True)
        sums, gamma = trace - principal, 2.0 * mu - pressure[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            if clamped:
                within = mu * sums > gamma
                floor = np.where(within.all(axis=-1, keepdims=True), SMALLEST_VOLUME, 0.0)
                others = np.roll(sums, 1, axis=-1) * np.roll(sums, 2, axis=-1)
                volume = np.maximum(np.prod(sums, axis=-1, keepdims=True), floor)
                turning = np.where(within, gamma * others / volume, mu)
            else:
                turning = gamma / sums
        modes = np.einsum(
            "...mn,...mkl->...nkl", axes, np.einsum("mik,...il->...mkl", _LEVI_CIVITA, rotation)
        )
        identity = np.eye(9).reshape(3, 3, 3, 3)
        result = 2.0 * mu[..., None, None, None] * identity
        result = result + bulk[..., None, None, None] * np.einsum("...ij,...kl->...ijkl", rotation, rotation)
        turned = np.einsum("...n,...nij->...nij", turning, modes)
        return np.asarray(result - np.einsum("...nij,...nkl->...ijkl", turned, modes))


def hooke_stress(strain: Array, p: Array) -> Array:
    """Stress of Hooke's law in [Pa] of strains (..., 3, 3)."""
    lam, mu = lame(p)
    trace = np.trace(strain, axis1=-2, axis2=-1)
    return np.asarray((lam * trace)[..., None, None] * np.eye(3) + 2.0 * mu[..., None, None] * strain)


def polar_rotations(deformation: Array) -> Array:
    """Nearest proper rotation to each deformation gradient (..., 3, 3); inverted elements included.

    Raises:
        FactorisationError: a gradient is not finite.
    """
    try:
        u, _, vt = np.linalg.svd(deformation)
    except np.linalg.LinAlgError as error:
        raise FactorisationError("the deformation of an element is not finite") from error
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]  # flip the direction of least stretch, never mirror
    return np.asarray(u @ vt)


def _stretch(deformation: Array, rotation: Array) -> Array:
    """The symmetric part of F R^T, shape (..., 3, 3)."""
    stretch = deformation @ np.swapaxes(rotation, -1, -2)
    return np.asarray(0.5 * (stretch + np.swapaxes(stretch, -1, -2)))
