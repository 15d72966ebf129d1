r"""Relaxing laws: a Prony series around any law that separates shear from volume.

The constants of the inner law are those of the instantaneous response. Each term i takes the share g_i of the
shear response, which decays with the time tau_i; the volumetric response does not relax. At rest

.. math:: \Psi = (1 - \sum g_i) \Psi_s(F) + \tfrac{a}{2} \theta(F)^2

remains. This long-term response is the law defined here: it serves statics and the elastic part of a step.
The part that a step adds is in fem.prony.

Source: Simo 1987, On a fully three-dimensional finite-strain viscoelastic damage model.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from softsim_core.base import Array, MaterialError
from softsim_core.physics.fem.materials.law import (
    Material,
    MaterialParameter,
    Refusal,
    VolumetricMaterial,
)

SHARE, TIME = "prony_share", "prony_time"
"""Prefixes of the names of a term's parameters; the number of the term follows, from 1."""


class Relaxing(VolumetricMaterial):
    """Long-term response of a law with a Prony series of shear relaxation.

    Args:
        law: The inner law.
        terms: Number of terms of the series.

    Raises:
        MaterialError: the inner law does not separate shear from volume.
    """

    # class attributes of Material, but here they depend on the inner law of each object
    name: str  # type: ignore[misc]
    parameters: tuple[MaterialParameter, ...]  # type: ignore[misc]

    def __init__(self, law: Material, terms: int) -> None:
        if not isinstance(law, VolumetricMaterial):
            raise MaterialError("prony", terms, f"cannot be: {law.name} does not separate shear from volume")
        self.law: VolumetricMaterial = law
        self.terms, self._own = terms, len(law.parameters)
        self.name = f"{law.name} with {terms} Prony terms"
        self.parameters = law.parameters + tuple(
            parameter
            for i in range(1, terms + 1)
            for parameter in (
                MaterialParameter(
                    f"{SHARE}_{i}", "-", f"share of the answer to shear that term {i} loses", 0.0, 1.0
                ),
                MaterialParameter(f"{TIME}_{i}", "s", f"time in which term {i} fades to 1/e", 0.0),
            )
        )

    def own(self, p: Array) -> Array:
        """Return the inner law's values of parameter values p (..., k)."""
        return p[..., : self._own]

    def prony(self, p: Array) -> tuple[Array, Array]:
        """Return the shares and times in [s] of the terms, each (..., t), of values p (..., k)."""
        return p[..., self._own :: 2], p[..., self._own + 1 :: 2]

    def compute_equilibrium_fraction(self, p: Array) -> Array:
        """Return the share of the shear response that does not relax, 1 - sum of the shares, shape (...)."""
        return np.asarray(1.0 - self.prony(p)[0].sum(axis=-1))

    def refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """Refuse shares whose sum is not below 1, and what the inner law refuses."""
        shares = [values[f"{SHARE}_{i}"] for i in range(1, self.terms + 1)]
        if sum(shares) >= 1.0:
            others = sum(shares[:-1])
            return Refusal(f"{SHARE}_{self.terms}", f"< {1.0 - others:g}, so that something is left at rest")
        return self.law.refusal({name: values[name] for name in self.law.names})

    def bulk(self, p: Array) -> Array:
        """Return the bulk coefficient of the inner law in [Pa], shape (...)."""
        return self.law.bulk(self.own(p))

    def point_bulk(self, p: Array, ratio: float = 1.0) -> Array:
        """Return the inner law's part of the bulk that acts at each point in [Pa], shape (...)."""
        return self.law.point_bulk(self.own(p), ratio)

    def dilatation(self, deformation: Array) -> Array:
        """Return theta of the inner law, shape (...)."""
        return self.law.dilatation(deformation)

    def dilatation_slope(self, deformation: Array) -> Array:
        """Return d theta / dF of the inner law, shape (..., 3, 3)."""
        return self.law.dilatation_slope(deformation)

    def shear_energy(self, deformation: Array, p: Array) -> Array:
        """Return the long-term share of the inner law's shear energy in [J/m^3], shape (...)."""
        return np.asarray(
            self.compute_equilibrium_fraction(p) * self.law.shear_energy(deformation, self.own(p))
        )

    def shear_stress(self, deformation: Array, p: Array) -> Array:
        """Return the long-term share of the inner law's shear stress in [Pa], shape (..., 3, 3)."""
        left = self.compute_equilibrium_fraction(p)[..., None, None]
        return np.asarray(left * self.law.shear_stress(deformation, self.own(p)))

    def tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """Return the tangent with the long-term share of shear in [Pa], shape (..., 3, 3, 3, 3).

        The inner tangent is linear in bulk and pressure, so these are divided by the share before it scales
        all.
        """
        left = self.compute_equilibrium_fraction(p)
        within = self.law.tangent_at(deformation, self.own(p), bulk / left, pressure / left)
        return np.asarray(left[..., None, None, None, None] * within)

    def positive_tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """Return the positive tangent with the long-term share of shear in [Pa], shape (..., 3, 3, 3, 3)."""
        left = self.compute_equilibrium_fraction(p)
        within = self.law.positive_tangent_at(deformation, self.own(p), bulk / left, pressure / left)
        return np.asarray(left[..., None, None, None, None] * within)


def law_within(law: Material) -> Material:
    """Return the law without its Prony terms."""
    return law.law if isinstance(law, Relaxing) else law


@cache
def relaxing(law: Material, terms: int) -> Relaxing:
    """Return the law with that number of Prony terms; equal arguments give the same object."""
    return Relaxing(law, terms)
