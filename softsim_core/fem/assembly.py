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


class BlockPattern:
    """Where the blocks of all pairs of nodes of cells stand in a sparse matrix; whoever keeps it sums faster.

    Args:
        count: Number of nodes n.
        cells: Nodes of the cells of several kinds, shapes (m, a).
    """

    def __init__(self, count: int, cells: Sequence[IndexArray]) -> None:
        pairs = [(count * nodes[:, :, None] + nodes[:, None, :]).ravel() for nodes in cells]
        blocks = np.concatenate([np.zeros(0, dtype=np.int64), *pairs])
        places, place = np.unique(blocks, return_inverse=True)
        put = (np.ones(len(blocks)), (place.ravel(), np.arange(len(blocks))))
        self._sum = sp.csr_matrix(put, shape=(len(places), len(blocks)))
        rows, columns = np.divmod(places, count)
        ends = np.searchsorted(rows, np.arange(count + 1))
        numbers = np.arange(9 * len(places)).reshape(-1, 3, 3)
        entries = sp.bsr_matrix((numbers, columns, ends), shape=(3 * count, 3 * count)).tocsr()
        self._entry, self._columns, self._starts = entries.data, entries.indices, entries.indptr

    def matrix(self, blocks: Sequence[Array]) -> sp.csr_matrix:
        """Blocks of these cells (m, a, a, 3, 3), added up, sparse, shape (3 n, 3 n)."""
        values = np.concatenate([np.zeros((0, 9)), *(each.reshape(-1, 9) for each in blocks)])
        size = len(self._starts) - 1
        sums = (self._sum @ values).ravel()[self._entry]
        return sp.csr_matrix((sums, self._columns, self._starts), shape=(size, size))


def stiffness_matrix(
    groups: Sequence[ElementGroup],
    positions: Array,
    materials: Sequence[Mapping[str, float]],
    positive: bool = False,
    distant: bool = False,
    moved: Array | None = None,
    mean_share: float = 1.0,
    pattern: BlockPattern | None = None,
) -> sp.csr_matrix:
    """Stiffness of all cells on the nodes in [N/m], sparse, shape (3 n, 3 n).

    Arguments as above, and as for `cell_stiffness`; `pattern`, where it is kept, is that of the groups.
    """
    if pattern is None:
        pattern = BlockPattern(len(positions), [group.cells for group in groups])
    return pattern.matrix(
        [
            cell_stiffness(group, positions, group.values(materials), positive, distant, moved, mean_share)
            for group in groups
        ]
    )


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
