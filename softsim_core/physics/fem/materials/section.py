r"""The law of rods: Hooke's without contraction across, with a factor on each stiffness.

.. math:: S_{ii} = E_Y E_{ii}, \quad S_{ij} = 2 G E_{ij} = \frac{E_Y}{1 + \nu} E_{ij}

in the axes of the section. Sections are held to their shape with a multiple of the same moduli. Strains that
change are resisted by c dE/dt as well, as by a strain c dE/dt more (Kelvin and Voigt), with the damping c.
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
"""How much stiffer a section is held to its shape than its material would hold it."""

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
    """See the module."""

    name = "rod"
    parameters = (YOUNG_MODULUS, POISSON_RATIO, *_FACTORS, DAMPING)

    def scales(self, p: Array) -> tuple[Array, Array]:
        """Moduli in [Pa] of values (m, k): stretch, shear (2), bending (2), twist; what holds sections.

        Returns:
            Of the strains along a rod, shape (m, 6), and of those of its sections, shape (m, 3).
        """
        young, shear = p[:, 0], p[:, 0] / (2.0 * (1.0 + p[:, 1]))
        stretching, shearing, first, second, twisting = p[:, 2:7].T
        line = (
            young * stretching,
            shear * shearing,
            shear * shearing,
            young * first,
            young * second,
            shear * twisting,
        )
        return np.stack(line, axis=1), HOLDING * np.stack([young, young, shear], axis=1)

    def refusal(self, values: Mapping[str, float]) -> Refusal | None:
        """See Material."""
        return Refusal(DAMPING.name, ">= 0 s") if values[DAMPING.name] < 0.0 else None

    def damping(self, p: Array) -> Array:
        """C in [s] of values (m, k), shape (m,)."""
        return p[:, 7]

    def energy(self, deformation: Array, p: Array) -> Array:
        """See Material."""
        strain = self.strain(deformation)
        return np.asarray(0.5 * np.einsum("...ij,...ij->...", self.second_piola(strain, p), strain))

    def second_piola(self, strain: Array, p: Array) -> Array:
        """See StrainMaterial."""
        young, twice_shear = p[..., 0, None, None], (p[..., 0] / (1.0 + p[..., 1]))[..., None, None]
        return np.asarray(np.where(np.eye(3, dtype=bool), young, twice_shear) * strain)

    def moduli(self, strain: Array, p: Array) -> Array:
        """See StrainMaterial."""
        moduli = np.zeros((*np.broadcast_shapes(strain.shape[:-2], p.shape[:-1]), 3, 3, 3, 3))
        half = 0.5 * p[..., 0] / (1.0 + p[..., 1])
        for i in range(3):
            moduli[..., i, i, i, i] = p[..., 0]
            for j in range(i):
                for k, l in ((i, j), (j, i)):  # noqa: E741 (an index of a tensor)
                    moduli[..., i, j, k, l] = moduli[..., j, i, k, l] = half
        return moduli


SECTION = Section()
