"""Constraint rows: the effect of a unit of each force on nodes, frames and joints.

Row r means: (the rate of its value) = sum of coefficient . velocity over its entries, and its transpose
distributes the row's force. An entry below `nodes` is a node (three coefficients); one from `nodes` on is a
reduced coordinate (only the first coefficient counts), see Model.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array, IndexArray, float_array


class Rows(NamedTuple):
    """Rows in compressed form.

    Attributes:
        start: First entry of each row, and the end of the last row, shape (r + 1,).
        place: Node, or `nodes` + reduced coordinate, of each entry, shape (k,).
        coefficient: Coefficients of each entry, shape (k, 3).
    """

    start: IndexArray
    place: IndexArray
    coefficient: Array

    @property
    def height(self) -> int:
        """Number of rows."""
        return len(self.start) - 1

    def with_kernel_types(self) -> Rows:
        """Return the same rows with the types that compiled kernels expect.

        Raises:
            ArrayError: shapes do not fit together.
        """
        start, place = (np.ascontiguousarray(each, dtype=np.int64) for each in (self.start, self.place))
        return Rows(start, place, float_array(self.coefficient, (len(place), 3), "coefficient"))


def join_rows(parts: list[Rows]) -> Rows:
    """Return several sets of rows joined into one, in order."""
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


def sparse_rows(rows: Rows, nodes: int, reduced: int) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """Return rows as matrices on node coordinates (r, 3 nodes) and on reduced coordinates (r, reduced)."""
    on_node = rows.place < nodes
    start = np.concatenate([[0], np.cumsum(on_node)])[rows.start]
    columns = (3 * rows.place[on_node, None] + np.arange(3)).ravel()
    entries = rows.coefficient[on_node].ravel(), columns, 3 * start
    others = rows.coefficient[~on_node, 0], rows.place[~on_node] - nodes, rows.start - start
    return (
        sp.csr_matrix(entries, shape=(rows.height, 3 * nodes)),
        sp.csr_matrix(others, shape=(rows.height, reduced)),
    )


def distribute(rows: Rows, forces: Array, nodes: int, reduced: int) -> tuple[Array, Array]:
    """Return the forces of the rows (r,) on nodes (n, 3) and on reduced coordinates (b,)."""
    acting = rows.coefficient * np.repeat(forces, np.diff(rows.start))[:, None]
    on_node = rows.place < nodes
    places = (3 * rows.place[on_node, None] + np.arange(3)).ravel()
    return (
        np.bincount(places, acting[on_node].ravel(), 3 * nodes).reshape(-1, 3),
        np.bincount(rows.place[~on_node] - nodes, acting[~on_node, 0], reduced),
    )


def no_rows() -> Rows:
    """Return an empty set of constraint rows."""
    return Rows(np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)))
