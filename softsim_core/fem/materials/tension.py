"""What a law says of a bar that is pulled: its curve of tension, its stiffness at rest, its waves."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.fem.materials.material import Material

_HALVINGS = 60


def tension(law: Material, p: Array, stretches: Array) -> tuple[Array, Array]:
    """Stretches across in [-] and nominal stresses along in [Pa] of a bar pulled or pressed, shape (k,).

    Args:
        law: An isotropic law.
        p: Values of its parameters, shape (parameters,).
        stretches: Along the bar in [-], > 0, shape (k,).
    """
    low, high = np.full(stretches.shape, 1e-3), np.maximum(3.0, 2.0 / np.sqrt(stretches))
    for _ in range(_HALVINGS):
        across = 0.5 * (low + high)
        is_thin = law.stress(_bar(stretches, across), p)[..., 1, 1] < 0.0
        low, high = np.where(is_thin, across, low), np.where(is_thin, high, across)
    return across, np.asarray(law.stress(_bar(stretches, across), p)[..., 0, 0])


def _bar(along: Array, across: Array) -> Array:
    deformation = np.zeros((*along.shape, 3, 3))
    deformation[..., 0, 0], deformation[..., 1, 1], deformation[..., 2, 2] = along, across, across
    return deformation


class RestStiffness(NamedTuple):
    """An isotropic law at rest: Young, shear and bulk modulus in [Pa], Poisson ratio in [-]."""

    young: float
    shear: float
    bulk: float
    poisson: float

    def bar_speed(self, density: float) -> float:
        """Speed in [m/s] of a wave that stretches a slender bar of that density in [kg/m^3]."""
        return math.sqrt(self.young / density)

    def shear_speed(self, density: float) -> float:
        """Speed in [m/s] of a wave of shear."""
        return math.sqrt(self.shear / density)

    def pressure_speed(self, density: float) -> float:
        """Speed in [m/s] of a wave of pressure, far above the others where volume is kept."""
        return math.sqrt((self.bulk + 4.0 / 3.0 * self.shear) / density)


def rest_stiffness(law: Material, p: Array) -> RestStiffness:
    """The moduli of a law with parameter values p, from its tangent at rest."""
    tangent = law.tangent(np.eye(3), p)
    shear, along = float(tangent[0, 1, 0, 1]), float(tangent[0, 0, 0, 0])
    bulk = along - 4.0 / 3.0 * shear
    young = 9.0 * bulk * shear / (3.0 * bulk + shear)
    return RestStiffness(young, shear, bulk, (3.0 * bulk - 2.0 * shear) / (6.0 * bulk + 2.0 * shear))
