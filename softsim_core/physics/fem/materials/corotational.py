r"""Corotational linear elasticity: Hooke's law on the deformation without its rotation R.

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
"""Lower limit of det(tr(S) I - S), which is 8 at rest. Without it, the tangent of a crumpled element that
expands again has no bound.
"""

FLAT = 1e-3
"""Share of its rest volume below which a cell's stress is no longer related to its deformed area."""

_WELL_SHAPED = 0.02
"""Least determinant of a gradient, relative to its size, for which Newton's iteration converges fast."""

_NEWTON_STEPS = 12
_NEARLY_THERE = 1e-8
"""The error after a Newton step is the square of its change, so the next step would change nothing."""

_AXIAL = np.zeros((9, 3))
"""Row 3 m + k, column i: the sign of the permutation (m, i, k).

Times R, it is the derivative of [w]x R by w.
"""
_AXIAL[[5, 6, 1], [0, 1, 2]] = -1.0
_AXIAL[[7, 2, 3], [0, 1, 2]] = 1.0


class RotatedHooke(Material):
    """Base class of the laws that apply Hooke's law in a frame with a rotation R of their own."""

    parameters = HOOKE

    @abstractmethod
    def rotations(self, deformation: Array) -> Array:
        """Return a proper rotation R for each deformation gradient, shape (..., 3, 3)."""

    def energy(self, deformation: Array, p: Array) -> Array:
        """Return the energy density mu |S - I|^2 + lambda/2 tr(S - I)^2 in [J/m^3], shape (...)."""
        lam, mu = lame(p)
        strain = _stretch(deformation, self.rotations(deformation)) - np.eye(3)
        trace = np.trace(strain, axis1=-2, axis2=-1)
        return np.asarray(mu * (strain**2).sum(axis=(-2, -1)) + 0.5 * lam * trace**2)

    def stress(self, deformation: Array, p: Array) -> Array:
        """Return the first Piola stress sigma R in [Pa], shape (..., 3, 3)."""
        rotation = self.rotations(deformation)
        return np.asarray(hooke_stress(_stretch(deformation, rotation) - np.eye(3), p) @ rotation)

    def distant_tangent(self, deformation: Array, p: Array) -> Array:
        """Return the tangent with rotations frozen, mu (dF + R dF^T R) + lambda (R : dF) R, in [Pa]."""
        rotation = self.rotations(deformation)
        lam, mu = (each[..., None, None, None, None] for each in lame(p))
        result = lam * np.einsum("...ij,...kl->...ijkl", rotation, rotation)
        result = result + mu * np.eye(9).reshape(3, 3, 3, 3)
        return np.asarray(result + mu * np.einsum("...il,...kj->...ijkl", rotation, rotation))

    def cauchy_stress(self, deformation: Array, stress: Array) -> Array:
        """Return the stress in world axes in [Pa], shape (..., 3, 3), finite in flat cells.

        It is the symmetric part, because R need not be the nearest rotation.
        """
        found = stress @ np.swapaxes(deformation, -1, -2)
        volume = np.linalg.det(deformation)[..., None, None]
        volume = np.copysign(np.maximum(np.abs(volume), FLAT), volume)
        return np.asarray(0.5 * (found + np.swapaxes(found, -1, -2)) / volume)


class Corotational(RotatedHooke, VolumetricMaterial):
    """Corotational law with R from the polar decomposition, the rotation nearest to F.

    Inverted elements recover.
    """

    name = "corotational"

    def rotations(self, deformation: Array) -> Array:
        """Return the rotation of the polar decomposition of each deformation gradient, shape (..., 3, 3)."""
        return polar_rotations(deformation)

    def bulk(self, p: Array) -> Array:
        """Return the coefficient of the volumetric energy in [Pa]: lambda, on theta = tr(S - I)."""
        return lame(p)[0]

    def point_bulk(self, p: Array, ratio: float = 1.0) -> Array:
        """Return the part of the bulk that acts at each point in [Pa]: lambda, but at most `ratio` mu."""
        first_lame, shear = lame(p)
        return np.asarray(np.minimum(first_lame, ratio * shear))

    def dilatation(self, deformation: Array) -> Array:
        """Return theta = tr(S - I), shape (...)."""
        return np.asarray((deformation * self.rotations(deformation)).sum(axis=(-2, -1)) - 3.0)

    def dilatation_slope(self, deformation: Array) -> Array:
        """Return d theta / dF, which is R, shape (..., 3, 3)."""
        return self.rotations(deformation)

    def shear_energy(self, deformation: Array, p: Array) -> Array:
        """Return the shear energy mu |S - I|^2 in [J/m^3], shape (...)."""
        strain = _stretch(deformation, self.rotations(deformation)) - np.eye(3)
        return np.asarray(lame(p)[1] * (strain**2).sum(axis=(-2, -1)))

    def shear_stress(self, deformation: Array, p: Array) -> Array:
        """Return the shear stress 2 mu (S - I) R in [Pa], shape (..., 3, 3)."""
        rotation = self.rotations(deformation)
        strain = _stretch(deformation, rotation) - np.eye(3)
        return np.asarray(2.0 * lame(p)[1][..., None, None] * (strain @ rotation))

    def tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """Return the tangent in [Pa], shape (..., 3, 3, 3, 3).

        Singular where two principal stretches cancel.
        """
        return self._modes(deformation, self.rotations(deformation), p, bulk, pressure, clamped=False).dense()

    def positive_tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """Return the tangent without negative eigenvalues in [Pa], shape (..., 3, 3, 3, 3).

        Only the modes dF = [w]x R, which turn an element, can have a negative eigenvalue, 2 mu - 2 g with g
        those of gamma (tr(S) I - S)^-1 and gamma = 2 mu - p. Therefore each g is limited to mu.
        """
        return self._modes(deformation, self.rotations(deformation), p, bulk, pressure, clamped=True).dense()

    def positive_modes(self, deformation: Array, p: Array) -> TangentModes:
        """Return the positive tangent as four modes: a change of volume and three rotations."""
        rotation, bulk = self.rotations(deformation), self.bulk(p)
        pressure = bulk * ((deformation * rotation).sum(axis=(-2, -1)) - 3.0)
        return self._modes(deformation, rotation, p, bulk, pressure, clamped=True)

    def _modes(
        self, deformation: Array, rotation: Array, p: Array, bulk: Array, pressure: Array, clamped: bool
    ) -> TangentModes:
        """Return 2 mu I + bulk R R^T - E^T G E, where E dF is the axial vector of dF R^T.

        G is gamma (tr(S) I - S)^-1.
        """
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
    """Return the stress of Hooke's law in [Pa] for strains (..., 3, 3)."""
    lam, mu = lame(p)
    trace = np.trace(strain, axis1=-2, axis2=-1)
    return np.asarray((lam * trace)[..., None, None] * np.eye(3) + 2.0 * mu[..., None, None] * strain)


def polar_rotations(deformation: Array) -> Array:
    """Return the proper rotation nearest to each deformation gradient (..., 3, 3), also if inverted.

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
    """Return the symmetric part of F R^T, shape (..., 3, 3)."""
    stretch = deformation @ np.swapaxes(rotation, -1, -2)
    return np.asarray(0.5 * (stretch + np.swapaxes(stretch, -1, -2)))
