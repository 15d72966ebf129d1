"""Laws that are written as a function of one point: what is checked when one is registered."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softsim_core.base import Array, SceneError
from softsim_core.physics.fem.materials import MaterialParameter, PointLaw, material, register_material


class Springs(PointLaw):
    """A spring between F and the identity, with a wrong factor on energy, stress or tangent."""

    name = "springs"
    parameters = (MaterialParameter("stiffness", "Pa", "of each entry of F", 0.0),)

    def energy(self, deformation: Array, p: Array) -> Array:
        """Return k |F - I|^2 / 2, shape (...)."""
        return np.asarray(0.5 * p[..., 0] * ((deformation - np.eye(3)) ** 2).sum(axis=(-2, -1)))

    @staticmethod
    def stress_and_tangent(f: Array, p: Array, stress: Array, tangent: Array) -> None:
        """Set k (F - I) and k times the identity; the other entries are zero."""
        for i in range(3):
            for j in range(3):
                stress[i, j] = p[0] * (f[i, j] - (1.0 if i == j else 0.0))
                tangent[i, j, i, j] = p[0]


class StifferTangent(Springs):
    """Its tangent has one entry too many."""

    @staticmethod
    def stress_and_tangent(f: Array, p: Array, stress: Array, tangent: Array) -> None:
        """Set a tangent that is no derivative of the stress."""
        tangent[:] = 0.0
        tangent[0, 1, 1, 0] = p[0]
        for i in range(3):
            for j in range(3):
                stress[i, j] = p[0] * (f[i, j] - (1.0 if i == j else 0.0))
                tangent[i, j, i, j] = p[0]


class OtherEnergy(Springs):
    """Its energy is twice that of its stress."""

    def energy(self, deformation: Array, p: Array) -> Array:
        """Return k |F - I|^2, shape (...)."""
        return 2.0 * super().energy(deformation, p)


class OtherMethod(Springs):
    """Its method `stress` is not that of the function."""

    def stress(self, deformation: Array, p: Array) -> Array:
        """Return k F, shape (..., 3, 3)."""
        return np.asarray(p[..., 0, None, None] * deformation)


class NotCompiled(Springs):
    """Its function uses what Numba does not know."""

    @staticmethod
    def stress_and_tangent(f: Array, p: Array, stress: Array, tangent: Array) -> None:
        """Set the stress by an unknown function."""
        stress[:] = np.einsum("ij->ji", f)


def test_a_right_law_is_registered_and_known_by_its_name() -> None:
    register_material(Springs())
    law, p, f = material("springs"), np.array([3.0]), np.diag([1.2, 1.0, 0.9])
    np.testing.assert_allclose(law.stress(f, p), np.diag([0.6, 0.0, -0.3]), atol=1e-15)
    many = law.tangent(np.stack([[f, f]] * 4), np.full((2, 1), 3.0))
    np.testing.assert_allclose(many, np.broadcast_to(3.0 * np.eye(9).reshape(3, 3, 3, 3), (4, 2, 3, 3, 3, 3)))


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (StifferTangent(), "its tangent is not the derivative of its stress"),
        (OtherEnergy(), "its stress is not the derivative of its energy"),
        (OtherMethod(), "the stress of stress_and_tangent is not that of its method"),
    ],
)
def test_a_contradiction_is_refused_with_where_it_was_found(law: Any, message: str) -> None:
    with pytest.raises(SceneError, match=f"law springs: {message}: they differ by .* Pa at F = .*stiffness"):
        register_material(law)
    with pytest.raises(SceneError):
        material("springs")


@pytest.mark.numba
def test_what_numba_does_not_compile_is_refused_with_its_reason() -> None:
    pytest.importorskip("numba")
    with pytest.raises(
        SceneError, match=r"of the law springs must be Python that Numba compiles: [^\x1b]*einsum[^\x1b]*$"
    ):
        register_material(NotCompiled())
