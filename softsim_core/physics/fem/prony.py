r"""Memory of cells with a relaxing law, and the stress that it adds to a step.

With the second Piola stress :math:`S = F^{-1} \partial \Psi_s / \partial F` of the inner law, for one step h
and a term of share g and time tau, at each point:

.. math:: s^+ = e^{-h/\tau} s + g e^{-h/2\tau} (S^+ - S), \quad
    P = \Bigl(1 - \sum g (1 - e^{-h/2\tau})\Bigr) \frac{\partial \Psi_s}{\partial F} + F H
        + p \frac{\partial \theta}{\partial F}, \quad
    H = \sum \bigl(e^{-h/\tau} s - g e^{-h/2\tau} S\bigr)

H is known at the start of the step. Its forces on the nodes of a cell are linear in the positions, by a
matrix that does not depend on them. The rest is the relaxing law itself with other shares.

Source: Taylor, Pister, Goudreau 1970, Thermomechanical analysis of viscoelastic solids; Simo 1987.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.fem.cells import deformation_gradients
from softsim_core.physics.fem.group import ElementGroup
from softsim_core.physics.fem.materials import SHARE, TIME, Material, Relaxing

FLATTEST: Final = 0.05
"""Where det F is smaller, a point retains its previous stress, because F^-1 is meaningless there."""


def memory_shape(group: ElementGroup) -> tuple[int, ...]:
    """Return the shape of the cells' memory: s of each term, then S, at all points, as matrices (3, 3)."""
    assert isinstance(group.material, Relaxing)
    return (*group.weights.shape, group.material.terms + 1, 3, 3)


def during_step(law: Material, values: Mapping[str, float], h: float) -> dict[str, float]:
    """Return the values of a law with the shares that it loses within half a step of h [s].

    Values of laws that do not relax are returned unchanged.
    """
    changed = dict(values)
    if isinstance(law, Relaxing):
        for i in range(1, law.terms + 1):
            changed[f"{SHARE}_{i}"] = -values[f"{SHARE}_{i}"] * math.expm1(-0.5 * h / values[f"{TIME}_{i}"])
    return changed


def step_stress(group: ElementGroup, p: Array, memory: Array, h: float) -> Array:
    """Return the stress H at all points in [Pa], shape (m, q, 3, 3), for a step of h [s].

    `p` (m, k) are the scene's values, before `during_step`.
    """
    shares, fades, halves = _of_points(group, p, h)
    faded = (fades[..., None, None] * memory[..., :-1, :, :]).sum(axis=-3)
    return np.asarray(faded - (shares * halves).sum(axis=-1)[..., None, None] * memory[..., -1, :, :])


def remember(group: ElementGroup, p: Array, memory: Array, positions: Array, h: float) -> None:
    """Advance `memory` in place after a step of h [s] to positions (n, 3)."""
    shares, fades, halves = _of_points(group, p, h)
    stress = law_stress(group, p, positions, memory[..., -1, :, :])
    gained = (stress - memory[..., -1, :, :])[..., None, :, :]
    memory[..., :-1, :, :] *= fades[..., None, None]
    memory[..., :-1, :, :] += (shares * halves)[..., None, None] * gained
    memory[..., -1, :, :] = stress


def forget(group: ElementGroup, p: Array, memory: Array, positions: Array) -> None:
    """Reset `memory` in place to the fully relaxed state at positions (n, 3)."""
    memory[..., -1, :, :] = law_stress(group, p, positions, memory[..., -1, :, :])
    memory[..., :-1, :, :] = 0.0


def law_stress(group: ElementGroup, p: Array, positions: Array, otherwise: Array) -> Array:
    """Return S at all points in [Pa], shape (m, q, 3, 3); crushed points take `otherwise`."""
    law, gradients = group.material, deformation_gradients(group, positions)
    assert isinstance(law, Relaxing)
    crushed = ~(np.linalg.det(gradients) > FLATTEST)
    gradients[crushed] = np.eye(3)
    result = np.linalg.solve(gradients, law.law.shear_stress(gradients, law.own(p)[:, None]))
    result[crushed] = otherwise[crushed]
    return np.asarray(0.5 * (result + np.swapaxes(result, -1, -2)))


def step_stress_stiffness(group: ElementGroup, stress: Array) -> Array:
    """Return the stiffness of the stress H (m, q, 3, 3): k_ab of blocks k_ab I in [N/m], shape (m, a, a).

    The force on node a is - sum k_ab x_b.
    """
    weighted = group.weights[..., None, None] * (group.gradients @ stress)
    return np.asarray((weighted @ np.swapaxes(group.gradients, -1, -2)).sum(axis=1))


def step_stress_forces(stiffness: Array, cells: IndexArray, positions: Array) -> Array:
    """Return the forces of the stress H on the nodes of the cells in [N], shape (m, a, 3)."""
    return np.asarray(-(stiffness @ positions[cells]))


def fading(group: ElementGroup, p: Array, h: float) -> tuple[Array, Array, Array]:
    """Return the shares, and the decay of a term over h [s] and over half of it, each (m, t)."""
    law = group.material
    assert isinstance(law, Relaxing)
    shares, times = law.prony(p)
    return shares, np.exp(-h / times), np.exp(-0.5 * h / times)


def _of_points(group: ElementGroup, p: Array, h: float) -> tuple[Array, Array, Array]:
    """Return the arrays of `fading` for all points, each (m, 1, t)."""
    shares, fades, halves = fading(group, p, h)
    return shares[:, None], fades[:, None], halves[:, None]
