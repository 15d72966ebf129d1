"""Constraint rows: what a unit of each force does to nodes, frames and joints.

Row r says: (its value's rate) = sum of coefficient . velocity over its entries, and its transpose spreads the
row's force. An entry below `nodes` is a node (three coefficients); one from `nodes` on is a border unknown
(the first coefficient counts), see Model.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softsim_core.arrays import Array, IndexArray


class Rows(NamedTuple):
    """Rows in compressed form.

    Attributes:
        start: Where the entries of row r begin; the last one ends them, shape (r + 1,).
        place: Node, or `nodes` + border unknown, of each entry, shape (k,).
        coefficient: Shape (k, 3).
    """

    start: IndexArray
    place: IndexArray
    coefficient: Array

    @property
    def height(self) -> int:
        """Number of rows."""
        return len(self.start) - 1


def joined(parts: list[Rows]) -> Rows:
    """Rows one behind the other."""
    if len(parts) == 1:
        return parts[0]
    ends = np.cumsum([0] + [len(part.place) for part in parts])
    return Rows(
        np.concatenate(
            [part.start[:-1] + end for part, end in zip(parts, ends[:-1], strict=True)] + [ends[-1:]]
        ),
        np.concatenate([np.zeros(0, np.int64)] + [part.place for part in parts]),
        np.concatenate([np.zeros((0, 3))] + [part.coefficient for part in parts]),
    )


def sparse_rows(rows: Rows, nodes: int, border: int) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """Rows as matrices on node coordinates (r, 3 nodes) and on border unknowns (r, border)."""
    owner = np.repeat(np.arange(rows.height), np.diff(rows.start))
    on_node = rows.place < nodes
    columns = 3 * rows.place[on_node, None] + np.arange(3)
    lines = np.repeat(owner[on_node], 3)
    values = rows.coefficient[on_node].ravel()
    first = sp.csr_matrix((values, (lines, columns.ravel())), shape=(rows.height, 3 * nodes))
    values, columns = rows.coefficient[~on_node, 0], rows.place[~on_node] - nodes
    return first, sp.csr_matrix((values, (owner[~on_node], columns)), shape=(rows.height, border))
