r"""Law of rods: Hooke's law without lateral contraction, with a factor on each stiffness.

.. math:: S_{ii} = E_Y E_{ii}, \quad S_{ij} = 2 G E_{ij} = \frac{E_Y}{1 + \nu} E_{ij}

in the axes of the section. A multiple of the same moduli keeps the shape of the sections. The damping c adds
c dE/dt to the strain (Kelvin and Voigt).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Final

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.fem.materials.law import (
    POISSON_RATIO,
    YOUNG_MODULUS,
    MaterialParameter,
    Refusal,
)
from softsim_core.physics.fem.materials.strain import StrainMaterial

HOLDING: Final = 10.0
"""Factor on the material's moduli for the stiffness of a section's shape."""

_FACTORS = tuple(
    MaterialParameter(f"{name}_factor", "-", f"Factor on the stiffness {against}", 0.0, inf, 1.0)
    for name, against in (
        ("stretch", "against stretch"),
        ("shear", "against shear"),
        ("bend_1", "against bending along the first axis of the section"),
        ("bend_2", "against bending along the second axis of the section"),
        ("twist", "against twist"),
    )
)

DAMPING: Final = MaterialParameter(
    "damping", "s", "Damping of this rod beside rayleigh_stiffness, >= 0", default=0.0
)


class Section(StrainMaterial):
    """Law of rods: an isotropic material and factors on the stiffness against each strain of a rod."""

    name = "rod"
    parameters = (YOUNG_MODULUS, POISSON_RATIO, *_FACTORS, DAMPING)

    def scales(self, p: Array) -> tuple[Array, Array]:
        """Return the moduli in [Pa] that scale the strains of a rod, for values (m, k).

        Returns:
            Those of the strains along a rod (stretch, two of shear, two of bending, twist), shape (m, 6), and
            those of the shape of its sections, shape (m, 3).
        """
        young, shear = p[:, 0], p[:, 0] / (2.0 * (1.0 + p[:, 1]))
        stretching, shearing, first, second, twisting = p[:, 2:7].T
        stretch, slip, twist = young * stretching, shear * shearing, shear * twisting
        line = np.stack([stretch, slip, slip, young * first, young * second, twist], axis=1)
        return line, HOLDING * np.stack([young, young, shear], axis=1)

    def refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """Refuse a negative damping."""
        return Refusal(DAMPING.name, ">= 0 s") if values[DAMPING.name] < 0.0 else None

    def damping(self, p: Array) -> Array:
        """Return the damping c in [s] of values (m, k), shape (m,)."""
        return p[:, 7]

    def second_piola(self, strain: Array, p: Array) -> Array:
        """Return S in [Pa] at Green strains, symmetric, both of shape (..., 3, 3)."""
        young, twice_shear = p[..., 0, None, None], (p[..., 0] / (1.0 + p[..., 1]))[..., None, None]
        return np.asarray(np.where(np.eye(3, dtype=bool), young, twice_shear) * strain)

    def moduli(self, strain: Array, p: Array) -> Array:
        """Return dS/dE in [Pa] with both minor symmetries, shape (..., 3, 3, 3, 3)."""
        moduli = np.zeros((*np.broadcast_shapes(strain.shape[:-2], p.shape[:-1]), 3, 3, 3, 3))
        half = 0.5 * p[..., 0] / (1.0 + p[..., 1])
        for i in range(3):
            moduli[..., i, i, i, i] = p[..., 0]
            for j in range(i):
                for k, l in ((i, j), (j, i)):  # noqa: E741 (an index of a tensor)
                    moduli[..., i, j, k, l] = moduli[..., j, i, k, l] = half
        return moduli


SECTION = Section()
