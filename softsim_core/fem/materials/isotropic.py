"""The parameters of isotropic elasticity."""

from __future__ import annotations

from math import inf

import numpy as np

from softsim_core.arrays import Array
from softsim_core.fem.materials.material import MaterialParameter

YOUNG_MODULUS = MaterialParameter("young_modulus", "Pa", "Young modulus", 0.0, inf)
POISSON_RATIO = MaterialParameter("poisson_ratio", "-", "Poisson ratio", -1.0, 0.5)
HOOKE = (YOUNG_MODULUS, POISSON_RATIO)
"""Parameters of a law that is Hooke's at small strain."""
STIFFNESS_FACTOR = MaterialParameter(
    "stiffness_factor", "-", "Factor on the stiffness, from a test of your own", 0.0, inf, default=1.0
)
"""Scales all constants of a curve whose shape is known better than its height."""


def lame(p: Array) -> tuple[Array, Array]:
    """Lame parameters (lambda, mu) in [Pa], shapes (...), of values (..., 2) of HOOKE."""
    young, poisson = p[..., 0], p[..., 1]
    return young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)), young / (2.0 * (1.0 + poisson))


def first_lame(shear: Array, poisson: Array) -> Array:
    """Lame's lambda in [Pa] of a shear modulus in [Pa] and a Poisson ratio, shapes (...)."""
    return np.asarray(2.0 * shear * poisson / (1.0 - 2.0 * poisson))
