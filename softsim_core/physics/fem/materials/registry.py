"""Registry of material laws by name."""

from __future__ import annotations

from math import inf

import numpy as np

from softsim_core.base import Registry, SceneError
from softsim_core.physics.fem.materials.corotational import Corotational
from softsim_core.physics.fem.materials.corotational_qr import CorotationalQr
from softsim_core.physics.fem.materials.law import Material, MaterialParameter, compile_points
from softsim_core.physics.fem.materials.mooney_rivlin import MooneyRivlin
from softsim_core.physics.fem.materials.ogden import Ogden
from softsim_core.physics.fem.materials.saint_venant_kirchhoff import SaintVenantKirchhoff
from softsim_core.physics.fem.materials.section import SECTION
from softsim_core.physics.fem.materials.stable_neo_hookean import StableNeoHookean
from softsim_core.physics.fem.materials.yeoh import Yeoh

_MATERIALS: Registry[Material] = Registry(
    "material law",
    Corotational(),
    CorotationalQr(),
    StableNeoHookean(),
    Yeoh(),
    Ogden(),
    MooneyRivlin(),
    SaintVenantKirchhoff(),
    SECTION,
)


def register_material(law: Material) -> None:
    """Make a law known to scenes by its name.

    The functions of a law with `stress_and_tangent` are compared with each other at a few points first.

    Raises:
        SceneError: the name is one of the package's own, or stress and tangent are not the derivatives of
            energy and stress.
    """
    if law.stress_and_tangent is not None:
        _check_derivatives(law)
    _MATERIALS.register(law)


def _check_derivatives(law: Material) -> None:
    """Compare energy, stress and tangent of a law by central differences.

    Raises:
        SceneError: one of them contradicts the one before.
    """
    at_points, rng, h = compile_points(law), np.random.default_rng(1), 1e-6
    p = np.array([_value_of(parameter) for parameter in law.parameters])
    turns, changes = rng.normal(size=(2, 6, 3, 3))
    f = np.eye(3) + 0.1 * changes
    both = np.concatenate([f - h * turns, f + h * turns])
    stress, tangent = np.zeros((12, 3, 3)), np.zeros((12, 3, 3, 3, 3))
    at_points(both, np.tile(p, (12, 1)), stress, tangent)
    before, after = law.energy(both, p).reshape(2, 6)
    change = np.einsum("mijkl,mkl->mij", 0.5 * (tangent[:6] + tangent[6:]), turns)
    along = 0.5 * ((stress[:6] + stress[6:]) * turns).sum(axis=(1, 2))
    for name, found, expected in (
        ("its stress is not the derivative of its energy", along, (after - before) / (2 * h)),
        ("its tangent is not the derivative of its stress", change, (stress[6:] - stress[:6]) / (2 * h)),
        ("the stress of stress_and_tangent is not that of its method", stress, law.stress(both, p)),
    ):
        error = np.abs(found - expected)
        worst = int(error.reshape(len(error), -1).max(axis=1).argmax())
        if not error.max() <= 1e-4 * np.abs(change).max():
            values = dict(zip(law.names, p.tolist(), strict=True))
            raise SceneError(
                f"law {law.name}: {name}: they differ by {error.max():.3g} Pa at "
                f"F = {both[worst].round(3).tolist()} with {values}"
            )


def _value_of(parameter: MaterialParameter) -> float:
    """Return the default of a parameter, or a value in its interval."""
    low, high = parameter.lower, parameter.upper
    if parameter.default is not None:
        return parameter.default
    if low > -inf and high < inf:
        return 0.5 * (low + high)
    return low + 1.0 if low > -inf else high - 1.0 if high < inf else 1.0


def material(name: str) -> Material:
    """Return the law of that name.

    Raises:
        SceneError: there is none; the message lists the known ones.
    """
    return _MATERIALS.get(name)


def material_names() -> tuple[str, ...]:
    """Return the names of all known laws."""
    return _MATERIALS.names()
