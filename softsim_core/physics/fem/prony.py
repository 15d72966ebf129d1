r"""What cells of a relaxing law remember, and the stress that this adds to a step.

With the second Piola stress :math:`S = F^{-1} \partial \Psi_s / \partial F` of the law within, of one step h
and a term of share g and time tau, at each point:

.. math:: s^+ = e^{-h/\tau} s + g e^{-h/2\tau} (S^+ - S), \quad
    P = \Bigl(1 - \sum g (1 - e^{-h/2\tau})\Bigr) \frac{\partial \Psi_s}{\partial F} + F H
        + p \frac{\partial \theta}{\partial F}, \quad
    H = \sum \bigl(e^{-h/\tau} s - g e^{-h/2\tau} S\bigr)

H is known when the step begins: it pulls on the nodes of a cell by a matrix that does not depend on where
they are. What is left of the law is itself with other shares.

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
"""Where det F is smaller, a point keeps the stress that it had: F^-1 means nothing there."""


def memory_shape(group: ElementGroup) -> tuple[int, ...]:
    """Shape of what the cells remember: s of each term and then S, at all points, as matrices (3, 3)."""
    assert isinstance(group.material, Relaxing)
    return (*group.weights.shape, group.material.terms + 1, 3, 3)


def during_step(law: Material, values: Mapping[str, float], h: float) -> dict[str, float]:
    """Values of a law with the shares that it loses within half a step of h [s]; of others as they are."""
    changed = dict(values)
    if isinstance(law, Relaxing):
        for i in range(1, law.terms + 1):
            changed[f"{SHARE}_{i}"] = -values[f"{SHARE}_{i}"] * math.expm1(-0.5 * h / values[f"{TIME}_{i}"])
    return changed


def held_stress(group: ElementGroup, p: Array, memory: Array, h: float) -> Array:
    """H at all points in [Pa], shape (m, q, 3, 3), of a step of h [s]; p (m, k) as the scene has them."""
    shares, fades, halves = _of_points(group, p, h)
    held = (fades[..., None, None] * memory[..., :-1, :, :]).sum(axis=-3)
    return np.asarray(held - (shares * halves).sum(axis=-1)[..., None, None] * memory[..., -1, :, :])


def remember(group: ElementGroup, p: Array, memory: Array, positions: Array, h: float) -> None:
    """Take over in `memory` what a step of h [s] to positions (n, 3) has done."""
    shares, fades, halves = _of_points(group, p, h)
    stress = law_stress(group, p, positions, memory[..., -1, :, :])
    gained = (stress - memory[..., -1, :, :])[..., None, :, :]
    memory[..., :-1, :, :] *= fades[..., None, None]
    memory[..., :-1, :, :] += (shares * halves)[..., None, None] * gained
    memory[..., -1, :, :] = stress


def forget(group: ElementGroup, p: Array, memory: Array, positions: Array) -> None:
    """Let all that fades have faded, at positions (n, 3)."""
    memory[..., -1, :, :] = law_stress(group, p, positions, memory[..., -1, :, :])
    memory[..., :-1, :, :] = 0.0


def law_stress(group: ElementGroup, p: Array, positions: Array, otherwise: Array) -> Array:
    """S at all points in [Pa], shape (m, q, 3, 3); where a cell is crushed what `otherwise` says."""
    law, gradients = group.material, deformation_gradients(group, positions)
    assert isinstance(law, Relaxing)
    crushed = ~(np.linalg.det(gradients) > FLATTEST)
    gradients[crushed] = np.eye(3)
    result = np.linalg.solve(gradients, law.law.shear_stress(gradients, law.own(p)[:, None]))
    result[crushed] = otherwise[crushed]
    return np.asarray(0.5 * (result + np.swapaxes(result, -1, -2)))


def held_stiffness(group: ElementGroup, held: Array) -> Array:
    """What H (m, q, 3, 3) pulls: the numbers k_ab of blocks k_ab I in [N/m], shape (m, a, a).

    The force on node a is - sum k_ab x_b.
    """
    weighted = group.weights[..., None, None] * (group.gradients @ held)
    return np.asarray((weighted @ np.swapaxes(group.gradients, -1, -2)).sum(axis=1))


def held_forces(stiffness: Array, cells: IndexArray, positions: Array) -> Array:
    """Forces on the nodes of the cells in [N], shape (m, a, 3)."""
    return np.asarray(-(stiffness @ positions[cells]))


def fading(group: ElementGroup, p: Array, h: float) -> tuple[Array, Array, Array]:
    """Shares, and what is left of a term after h [s] and after half of it, each (m, t)."""
    law = group.material
    assert isinstance(law, Relaxing)
    shares, times = law.prony(p)
    return shares, np.exp(-h / times), np.exp(-0.5 * h / times)


def _of_points(group: ElementGroup, p: Array, h: float) -> tuple[Array, Array, Array]:
    """The same for all points, each (m, 1, t)."""
    shares, fades, halves = fading(group, p, h)
    return shares[:, None], fades[:, None], halves[:, None]
