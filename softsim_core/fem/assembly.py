r"""Energy, forces, stiffness and stress of the cells of any group, in NumPy.

.. math:: F = \sum_a x_a g_a^T, \quad f_a = -\sum_q w_q P g_a, \quad
    K_{ab} = -\partial f_a / \partial x_b = \sum_q w_q \, g_a \cdot (\partial P / \partial F) \cdot g_b
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.sparse as sp

from softsim_core.arrays import Array
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.materials.material import von_mises


def deformation_gradients(group: ElementGroup, positions: Array) -> Array:
    """F at the quadrature points, shape (m, q, 3, 3), at node positions (n, 3) in [m]."""
    return np.asarray(np.swapaxes(positions[group.cells], 1, 2)[:, None] @ group.gradients)


def cell_energy(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Elastic energy of each cell in [J], shape (m,).

    Args:
        group: The cells.
        positions: Node positions in [m], shape (n, 3).
        p: Parameters of each cell, shape (m, k); see ElementGroup.values.
    """
    density = group.material.energy(deformation_gradients(group, positions), p[:, None])
    return np.asarray((group.weights * density).sum(axis=1))


def cell_forces(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Forces of the cells on their nodes in [N], shape (m, a, 3); arguments as for `cell_energy`."""
    stress = group.material.stress(deformation_gradients(group, positions), p[:, None])
    weighted = group.weights[..., None, None] * stress
    return np.asarray(-(group.gradients @ np.swapaxes(weighted, -1, -2)).sum(axis=1))


def cell_stiffness(
    group: ElementGroup, positions: Array, p: Array, positive: bool = False, distant: bool = False
) -> Array:
    """-df_a/dx_b of each cell in [N/m], shape (m, a, a, 3, 3).

    Exact, or `positive` for a time step, or for statics `distant` from an equilibrium; see Material.
    """
    law = group.material
    of = law.distant_tangent if distant else law.positive_tangent if positive else law.tangent
    tangent = of(deformation_gradients(group, positions), p[:, None])
    m, q, a = group.gradients.shape[:3]
    weighted = (group.weights[..., None, None] * tangent.reshape(m, q, 9, 9)).reshape(m, q, 27, 3)
    right = weighted @ np.swapaxes(group.gradients, -1, -2)  # (i J k), b
    right = right.reshape(m, q, 3, 3, 3 * a).swapaxes(2, 3).reshape(m, q, 3, 9 * a)  # J, (i k b)
    blocks = (group.gradients @ right).sum(axis=1).reshape(m, a, 3, 3, a)
    return np.ascontiguousarray(blocks.transpose(0, 1, 4, 2, 3))


def cell_von_mises(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Von Mises stress of each cell in [Pa], the mean over its volume, shape (m,)."""
    stress = von_mises(group.material.cauchy_stress(deformation_gradients(group, positions), p[:, None]))
    return np.asarray((group.weights * stress).sum(axis=1) / group.volumes)


def inverted_cells(group: ElementGroup, positions: Array) -> Array:
    """Which cells are flat or inside out somewhere, det F <= 0, shape (m,)."""
    return np.asarray((np.linalg.det(deformation_gradients(group, positions)) <= 0.0).any(axis=1))


def elastic_forces(
    groups: Sequence[ElementGroup], positions: Array, materials: Sequence[Mapping[str, float]]
) -> Array:
    """Forces of all cells on the nodes in [N], shape (n, 3).

    Args:
        groups: All cells.
        positions: Node positions in [m], shape (n, 3).
        materials: Parameters of each body's law by name.
    """
    forces = np.zeros_like(positions)
    for group in groups:
        np.add.at(forces, group.cells, cell_forces(group, positions, group.values(materials)))
    return forces


def stiffness_matrix(
    groups: Sequence[ElementGroup],
    positions: Array,
    materials: Sequence[Mapping[str, float]],
    positive: bool = False,
    distant: bool = False,
) -> sp.csr_matrix:
    """Stiffness of all cells on the nodes in [N/m], sparse, shape (3 n, 3 n); arguments as above."""
    size = 3 * len(positions)
    rows, columns, values = [], [], []
    for group in groups:
        blocks = cell_stiffness(group, positions, group.values(materials), positive, distant)
        unknowns = 3 * group.cells[:, :, None] + np.arange(3)
        rows.append(np.broadcast_to(unknowns[:, :, None, :, None], blocks.shape).ravel())
        columns.append(np.broadcast_to(unknowns[:, None, :, None, :], blocks.shape).ravel())
        values.append(blocks.ravel())
    if not values:
        return sp.csr_matrix((size, size))
    places = (np.concatenate(rows), np.concatenate(columns))
    return sp.coo_matrix((np.concatenate(values), places), shape=(size, size)).tocsr()


def von_mises_stress(
    groups: Sequence[ElementGroup], positions: Array, materials: Sequence[Mapping[str, float]]
) -> Array:
    """Von Mises stress of every cell in [Pa], in the order of their numbers; arguments as above."""
    result = np.zeros(sum(len(group.cells) for group in groups))
    for group in groups:
        result[group.numbers] = cell_von_mises(group, positions, group.values(materials))
    return result
