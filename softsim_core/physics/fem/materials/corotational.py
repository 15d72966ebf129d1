r"""Corotational linear elasticity: Hooke's law on what is left when the rotation R of F is taken out.

.. math:: \Psi = \mu |S - I|^2 + \tfrac{\lambda}{2} tr(S - I)^2, \qquad P = \sigma R, \qquad
    \sigma = 2 \mu (S - I) + \lambda tr(S - I) I, \qquad S = sym(F R^T)

Sources: Mueller and Gross 2004; McAdams et al. 2011; Kim and Eberle 2022, Dynamic deformables (its tangent).
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from softsim_core.base import Array, FactorisationError
from softsim_core.physics.fem.materials.law import (
    HOOKE,
    Material,
    TangentModes,
    VolumetricMaterial,
    lame,
)
from softsim_core.physics.fem.materials.stretches import cofactor_first

SMALLEST_VOLUME = 1e-6
"""det(tr(S) I - S), 8 at rest, is taken no smaller than this: a crumpled element that is blown up has no
bounded tangent."""

FLAT = 1e-3
"""Share of its volume at rest, below which a cell's stress is no more taken per area as deformed."""

_WELL_SHAPED = 0.02
"""With a determinant above this, for its size, a gradient is near enough to a rotation for Newton's steps."""

_NEWTON_STEPS = 12
_NEARLY_THERE = 1e-8
"""Newton's error is the square of the last change, so the next step would change nothing."""

_AXIAL = np.zeros((9, 3))
"""Row 3 m + k, column i: the sign of the permutation (m, i, k); times R, the derivative of [w]x R by w."""
_AXIAL[[5, 6, 1], [0, 1, 2]] = -1.0
_AXIAL[[7, 2, 3], [0, 1, 2]] = 1.0


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
        """See Material; the symmetric part, for R that is not the nearest rotation, finite in flat cells."""
        found = stress @ np.swapaxes(deformation, -1, -2)
        volume = np.linalg.det(deformation)[..., None, None]
        volume = np.copysign(np.maximum(np.abs(volume), FLAT), volume)
        return np.asarray(0.5 * (found + np.swapaxes(found, -1, -2)) / volume)


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
        return self._modes(deformation, self.rotations(deformation), p, bulk, pressure, clamped=False).dense()

    def positive_tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """See VolumetricMaterial.

        Only the modes dF = [w]x R that turn an element can have a negative eigenvalue, 2 mu - 2 g with g
        those of gamma (tr(S) I - S)^-1 and gamma = 2 mu - p: no g is taken larger than mu.
        """
        return self._modes(deformation, self.rotations(deformation), p, bulk, pressure, clamped=True).dense()

    def positive_modes(self, deformation: Array, p: Array) -> TangentModes:
        """See Material: a change of volume and three that turn."""
        rotation, bulk = self.rotations(deformation), self.bulk(p)
        pressure = bulk * ((deformation * rotation).sum(axis=(-2, -1)) - 3.0)
        return self._modes(deformation, rotation, p, bulk, pressure, clamped=True)

    def _modes(
        self, deformation: Array, rotation: Array, p: Array, bulk: Array, pressure: Array, clamped: bool
    ) -> TangentModes:
        """2 mu I + bulk R R^T - E^T G E, E the axial vector of dF R^T, G = gamma (tr(S) I - S)^-1."""
        principal, axes = np.linalg.eigh(_stretch(deformation, rotation))
        mu = lame(p)[1]
        sums = principal.sum(axis=-1, keepdims=True) - principal
        gamma = (2.0 * mu - pressure)[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            if clamped:
                within = mu[..., None] * sums > gamma
                floor = np.where(within.all(axis=-1, keepdims=True), SMALLEST_VOLUME, 0.0)
                others = np.roll(sums, 1, axis=-1) * np.roll(sums, 2, axis=-1)
                volume = np.maximum(np.prod(sums, axis=-1, keepdims=True), floor)
                turning = np.where(within, gamma * others / volume, mu[..., None])
            else:
                turning = gamma / sums
        shape = rotation.shape[:-2]
        turnings = np.swapaxes(axes, -1, -2) @ (_AXIAL @ rotation).reshape(*shape, 3, 9)
        modes = np.concatenate([rotation.reshape(*shape, 1, 9), turnings], axis=-2)
        weights = np.concatenate(
            [np.broadcast_to(bulk[..., None], (*turning.shape[:-1], 1)), -turning], axis=-1
        )
        return TangentModes(2.0 * mu, weights, modes.reshape(*shape, 4, 3, 3))


def hooke_stress(strain: Array, p: Array) -> Array:
    """Stress of Hooke's law in [Pa] of strains (..., 3, 3)."""
    lam, mu = lame(p)
    trace = np.trace(strain, axis1=-2, axis2=-1)
    return np.asarray((lam * trace)[..., None, None] * np.eye(3) + 2.0 * mu[..., None, None] * strain)


def polar_rotations(deformation: Array) -> Array:
    """Nearest proper rotation to each deformation gradient (..., 3, 3); inverted elements included.

    Newton's iteration R <- (R + R^-T) / 2 where it converges fast, which costs a fifth of the singular values
    that the others take. Source: Higham 1986, Computing the polar decomposition.

    Raises:
        FactorisationError: a gradient is not finite.
    """
    rotation = np.array(np.moveaxis(deformation, (-2, -1), (0, 1)), order="C")  # a copy, rows first
    minors = cofactor_first(rotation)
    volume = (rotation[0] * minors[0]).sum(axis=0)
    size = (rotation**2).sum(axis=(0, 1)) / 3.0
    good = volume > _WELL_SHAPED * size * np.sqrt(size)
    rotation[:, :, ~good] = np.eye(3)[:, :, None]
    for _ in range(_NEWTON_STEPS):
        minors = cofactor_first(rotation)
        change = 0.5 * (minors / (rotation[0] * minors[0]).sum(axis=0) - rotation)
        rotation += change
        if np.abs(change).max(initial=0.0) < _NEARLY_THERE:
            break
    else:
        good &= np.abs(change).max(axis=(0, 1)) < _NEARLY_THERE
    result = np.moveaxis(rotation, (0, 1), (-2, -1))
    if not good.all():
        result[~good] = _rotations_by_singular_values(deformation[~good])
    return np.ascontiguousarray(result)


def _rotations_by_singular_values(deformation: Array) -> Array:
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
