"""Mass: the lumped mass of each node, and the coupling of nodes by a consistent mass matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array, IndexArray
from softsim_core.physics.fem.group import ElementGroup


def volume_shares(group: ElementGroup, count: int) -> Array:
    """Return the volume in [m^3] that belongs to each of `count` nodes, shape (count,).

    Mass is density times it.

    Each node has its element's share of the cell's volume. For linear tetrahedra these are the row sums of
    the consistent mass matrix: total mass and centre of mass are exact, and the inertia is too large by a
    part that falls with the square of the element size (22 % of a cube of 3x3x3 cells).

    Source: Hinton, Rock, Zienkiewicz 1976, A note on mass lumping.
    """
    parts = group.volumes[:, None] * group.element.mass_shares
    return np.bincount(group.cells.ravel(), parts.ravel(), minlength=count).astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class MassCoupling:
    """Difference between the consistent and the lumped mass matrix, per direction of space.

    Its entries sum to zero.

    Attributes:
        cells: Node indices of cells of several kinds, shapes (m, a).
        blocks: Difference for each of these cells in [kg], symmetric, shapes (m, a, a).
        matrix: Sum over all cells, sparse, shape (n, n).
    """

    cells: tuple[IndexArray, ...]
    blocks: tuple[Array, ...]
    matrix: sp.csr_matrix

    def scale(self, factor: float) -> MassCoupling:
        """Return this coupling times a factor."""
        return MassCoupling(
            self.cells, tuple(factor * each for each in self.blocks), (factor * self.matrix).tocsr()
        )


def mass_coupling(groups: Sequence[ElementGroup], densities: Sequence[Array], count: int) -> MassCoupling:
    """Return the mass coupling of cells of several kinds on `count` nodes, with densities (m,) in [kg/m^3].

    It is exact for cells with straight edges. A cell with curved edges gets the matrix of a straight one of
    the same volume.

    Raises:
        ValueError: the mass matrix of an element is not known.
    """
    cells, blocks, matrix = [], [], sp.csr_matrix((count, count))
    for group, density in zip(groups, densities, strict=True):
        whole = group.element.mass_matrix
        if whole is None:
            raise ValueError(f"element {group.element.name} has no mass_matrix")
        beyond = whole - np.diag(group.element.mass_shares)
        cells.append(group.cells)
        blocks.append((density * group.volumes)[:, None, None] * beyond)
        nodes = np.broadcast_to(group.cells[:, :, None], blocks[-1].shape)
        places = (nodes.ravel(), np.swapaxes(nodes, 1, 2).ravel())
        matrix = matrix + sp.coo_matrix((blocks[-1].ravel(), places), shape=matrix.shape)
    return MassCoupling(tuple(cells), tuple(blocks), matrix.tocsr())
