r"""Stable neo-Hookean rubber: a law of large strain that is free of stress at rest and survives inversion.

.. math:: W = \tfrac{\mu}{2} \left(I_C - 3 - \ln \tfrac{I_C + 1}{4}\right), \qquad \mu = \tfrac43 \mu_H

with Hooke's :math:`\mu_H`. With the terms of the volume it is
:math:`\tfrac{\mu}{2} (I_C - 3) + \tfrac{\lambda}{2} (J - \alpha)^2 - \tfrac{\mu}{2} \ln(I_C + 1)`,
shifted to zero at rest, with :math:`\lambda = \lambda_H + \tfrac56 \mu_H` and
:math:`\alpha = 1 + \tfrac{3 \mu}{4 \lambda}`.

Source: Smith, de Goes, Kim 2018, Stable neo-Hookean flesh simulation, equation 14 and section 3.4.
"""

from __future__ import annotations

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.fem.materials.law import HOOKE, lame
from softsim_core.physics.fem.materials.rubber import SeriesRubber


class StableNeoHookean(SeriesRubber):
    """Stable neo-Hookean rubber with Young modulus and Poisson ratio as parameters."""

    name = "stable_neo_hookean"
    parameters = HOOKE

    def series(self, p: Array) -> Array:
        """Return the coefficients c1 and l, both 2/3 mu_H, and c2 = c3 = 0 in [Pa], shape (..., 4)."""
        half = 2.0 / 3.0 * lame(p)[1]
        nothing = np.zeros_like(half)
        return np.stack([half, nothing, nothing, half], axis=-1)

    def first_lame(self, p: Array) -> Array:
        """Return Lame's lambda of Hooke's law in [Pa], shape (...)."""
        return lame(p)[0]
