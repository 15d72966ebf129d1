r"""A law whose stress relaxes: a Prony series around any law that tells shear from volume.

The constants of the law within are those of the first moment. Of its answer to shear, each term i takes the
share g_i, which fades with the time tau_i; volume is resisted as before. At rest

.. math:: \Psi = (1 - \sum g_i) \Psi_s(F) + \tfrac{a}{2} \theta(F)^2

is left, and that is what this law is: for statics, and the elastic part of a step. What a step adds is in
fem.prony.

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
"""Beginnings of the names of a term's parameters; its number follows, from 1."""


class Relaxing(VolumetricMaterial):
    """See the module.

    Args:
        law: The law within.
        terms: How many fade.

    Raises:
        MaterialError: the law does not tell shear from volume.
    """

    # what is one of a class elsewhere is one of each object here
    name: str  # type: ignore[misc]
    parameters: tuple[MaterialParameter, ...]  # type: ignore[misc]

    def __init__(self, law: Material, terms: int) -> None:
        if not isinstance(law, VolumetricMaterial):
            raise MaterialError("prony", terms, f"cannot be: {law.name} does not tell shear from volume")
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
        """The values of the law within, of values p (..., k)."""
        return p[..., : self._own]

    def prony(self, p: Array) -> tuple[Array, Array]:
        """Shares and times in [s] of the terms, each (..., t), of values p (..., k)."""
        return p[..., self._own :: 2], p[..., self._own + 1 :: 2]

    def left(self, p: Array) -> Array:
        """What is left of the answer to shear, 1 - sum of the shares, shape (...)."""
        return np.asarray(1.0 - self.prony(p)[0].sum(axis=-1))

    def refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """See Material."""
        shares = [values[f"{SHARE}_{i}"] for i in range(1, self.terms + 1)]
        if sum(shares) >= 1.0:
            others = sum(shares[:-1])
            return Refusal(f"{SHARE}_{self.terms}", f"< {1.0 - others:g}, so that something is left at rest")
        return self.law.refusal({name: values[name] for name in self.law.names})

    def bulk(self, p: Array) -> Array:
        """See VolumetricMaterial."""
        return self.law.bulk(self.own(p))

    def point_bulk(self, p: Array) -> Array:
        """See VolumetricMaterial."""
        return self.law.point_bulk(self.own(p))

    def dilatation(self, deformation: Array) -> Array:
        """See VolumetricMaterial."""
        return self.law.dilatation(deformation)

    def dilatation_slope(self, deformation: Array) -> Array:
        """See VolumetricMaterial."""
        return self.law.dilatation_slope(deformation)

    def shear_energy(self, deformation: Array, p: Array) -> Array:
        """See VolumetricMaterial."""
        return np.asarray(self.left(p) * self.law.shear_energy(deformation, self.own(p)))

    def shear_stress(self, deformation: Array, p: Array) -> Array:
        """See VolumetricMaterial."""
        left = self.left(p)[..., None, None]
        return np.asarray(left * self.law.shear_stress(deformation, self.own(p)))

    def tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """See VolumetricMaterial; it is linear in bulk and pressure."""
        left = self.left(p)
        within = self.law.tangent_at(deformation, self.own(p), bulk / left, pressure / left)
        return np.asarray(left[..., None, None, None, None] * within)

    def positive_tangent_at(self, deformation: Array, p: Array, bulk: Array, pressure: Array) -> Array:
        """See VolumetricMaterial."""
        left = self.left(p)
        within = self.law.positive_tangent_at(deformation, self.own(p), bulk / left, pressure / left)
        return np.asarray(left[..., None, None, None, None] * within)


def law_within(law: Material) -> Material:
    """The law without its Prony terms."""
    return law.law if isinstance(law, Relaxing) else law


@cache
def relaxing(law: Material, terms: int) -> Relaxing:
    """The law with so many Prony terms; the same object for the same arguments."""
    return Relaxing(law, terms)
