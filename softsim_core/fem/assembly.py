"""Forces, stiffness and stress of the cells of all groups together, added up on the nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.sparse as sp

from softsim_core.arrays import Array, IndexArray
from softsim_core.fem.cells import cell_forces, cell_stiffness, cell_von_mises
from softsim_core.fem.group import ElementGroup


def elastic_forces(
    groups: Sequence[ElementGroup], positions: Array, materials: Sequence[Mapping[str, float]]
) -> Array:
    """Forces of all cells on the nodes in [N], shape (n, 3).

    Args:
        groups: All cells.
        positions: Node positions in [m], shape (n, 3).
        materials: Parameters of each body's law by name, behind them those of layers and fibres.
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
    moved: Array | None = None,
    mean_share: float = 1.0,
) -> sp.csr_matrix:
    """Stiffness of all cells on the nodes in [N/m], sparse, shape (3 n, 3 n); arguments as above."""
    cells = [group.cells for group in groups]
    blocks = [
        cell_stiffness(group, positions, group.values(materials), positive, distant, moved, mean_share)
        for group in groups
    ]
    return matrix_of_blocks(len(positions), cells, blocks)


def matrix_of_blocks(count: int, cells: Sequence[IndexArray], blocks: Sequence[Array]) -> sp.csr_matrix:
    """Blocks of all pairs of nodes of cells, added up, sparse, shape (3 n, 3 n).

    Args:
        count: Number of nodes n.
        cells: Nodes of the cells of several kinds, shapes (m, a).
        blocks: Of these cells, shapes (m, a, a, 3, 3).
    """
    pairs = [(count * nodes[:, :, None] + nodes[:, None, :]).ravel() for nodes in cells]
    if not pairs:
        return sp.csr_matrix((3 * count, 3 * count))
    places, values = np.concatenate(pairs), np.concatenate([each.reshape(-1, 3, 3) for each in blocks])
    order = np.argsort(places, kind="stable")
    places = places[order]
    first = np.flatnonzero(np.diff(places, prepend=-1))
    sums, (rows, columns) = np.add.reduceat(values[order], first), np.divmod(places[first], count)
    ends = np.searchsorted(rows, np.arange(count + 1))
    return sp.bsr_matrix((sums, columns, ends), shape=(3 * count, 3 * count)).tocsr()


def von_mises_stress(
    groups: Sequence[ElementGroup], positions: Array, materials: Sequence[Mapping[str, float]]
) -> Array:
    """Von Mises stress of every cell in [Pa], in the order of their numbers; arguments as above.

    Layers and fibres have none.
    """
    filling = [group for group in groups if group.fills]
    result = np.zeros(sum(len(group.cells) for group in filling))
    for group in filling:
        result[group.numbers] = cell_von_mises(group, positions, group.values(materials))
    return result
