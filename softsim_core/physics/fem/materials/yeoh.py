r"""Yeoh rubber: a polynomial of one to three terms in I_C - 3, fitted to a tension curve.

.. math:: W = C_1 t + C_2 t^2 + C_3 t^3, \qquad t = I_C - 3, \qquad \mu = 2 C_1

Source: Yeoh 1993, Some forms of the strain energy function for rubber.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.fem.materials.law import (
    POISSON_RATIO,
    STIFFNESS_FACTOR,
    MaterialParameter,
    Refusal,
    first_lame,
)
from softsim_core.physics.fem.materials.rubber import SeriesRubber


class Yeoh(SeriesRubber):
    """Yeoh rubber; with C2 = C3 = 0 it is neo-Hookean."""

    name = "yeoh"
    parameters = (
        MaterialParameter("c1", "Pa", "C1, half the shear modulus at rest", 0.0),
        MaterialParameter("c2", "Pa", "C2, how much stiffer it gets when stretched", default=0.0),
        MaterialParameter("c3", "Pa", "C3, how much stiffer it gets at large stretch", default=0.0),
        POISSON_RATIO,
        STIFFNESS_FACTOR,
    )

    def series(self, p: Array) -> Array:
        """Return C1, C2 and C3 times the stiffness factor, and l = 0, in [Pa], shape (..., 4)."""
        return np.asarray(np.concatenate([p[..., :3], np.zeros_like(p[..., :1])], axis=-1) * p[..., 4:5])

    def first_lame(self, p: Array) -> Array:
        """Return Lame's lambda of Hooke's law in [Pa], shape (...)."""
        return first_lame(2.0 * p[..., 4] * p[..., 0], p[..., 3])

    def refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """Refuse constants for which the shear stress does not always rise, and small Poisson ratios.

        The shear stress rises for every shear where C1 + 6 C2 t + 15 C3 t^2 > 0.
        """
        c1, c2, c3 = (values[name] for name in ("c1", "c2", "c3"))
        if c3 < 0.0:
            return Refusal("c3", ">= 0 Pa, or the law gives way at large stretch")
        least = -sqrt(5.0 / 3.0 * c1 * c3)
        if c2 < least or (c2 < 0.0 and c3 == 0.0):
            return Refusal("c2", f">= {least:g} Pa with these c1 and c3, or the law gives way when stretched")
        return self.volume_refusal(values)
