"""Isotropic linear elasticity."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_core.errors import MaterialError


@dataclass(frozen=True, slots=True)
class LinearMaterial:
    """Isotropic linear elasticity.

    Attributes:
        young_modulus: Young modulus in [Pa], > 0. On linear tetrahedra this is a mesh-bound, effective value.
        poisson_ratio: Poisson ratio in [-], in (-1, 0.5).

    Raises:
        MaterialError: a value lies outside its interval; the error carries the name and the value.
    """

    young_modulus: float
    poisson_ratio: float

    def __post_init__(self) -> None:
        if not 0.0 < self.young_modulus < float("inf"):  # also rejects NaN
            raise MaterialError("young_modulus", self.young_modulus, "must be > 0 Pa")
        if not -1.0 < self.poisson_ratio < 0.5:
            raise MaterialError("poisson_ratio", self.poisson_ratio, "must lie in (-1, 0.5)")

    @property
    def lame(self) -> tuple[float, float]:
        """Lame parameters (lambda, mu) in [Pa]."""
        e, nu = self.young_modulus, self.poisson_ratio
        return e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))
