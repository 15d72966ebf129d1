"""A grid of cells over a patch of a surface, seen in a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from softsim_core.arrays import Array, IndexArray

_FINE = 4
"""Triangles are cut into parts of at most a cell's edge by this, for the integrals."""
_MOST_CUTS = 512
_FLAT = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Cells of equal size.

    Attributes:
        low: Its corner of smallest coordinates in [m], shape (2,).
        edge: Edges of a cell in [m], shape (2,).
        rows: Cells along the second axis.
        columns: Cells along the first one.
    """

    low: Array
    edge: Array
    rows: int
    columns: int

    @property
    def area(self) -> float:
        """Of a cell in [m^2]."""
        return float(self.edge.prod())

    def cell(self, places: Array) -> IndexArray:
        """Number of the cell, row by row, that each place (..., 2) is in, or nearest to, shape (...)."""
        column, row = np.moveaxis(np.floor((places - self.low) / self.edge).astype(np.int64), -1, 0)
        return np.asarray(row.clip(0, self.rows - 1) * self.columns + column.clip(0, self.columns - 1))


def grid_over(patch: IndexArray, seen: Array, rows: int, columns: int) -> Grid | None:
    """A grid that covers a patch; None: the patch has no area in this plane.

    Args:
        patch: Triangles, shape (m, 3).
        seen: Where all vertices are in the plane in [m], shape (v, 2).
        rows: Of the grid, along the second axis.
        columns: Along the first axis.
    """
    corners = seen[patch]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    if not _areas(corners).max() > _FLAT * float(np.linalg.norm(high - low)) ** 2:
        return None
    return Grid(low, (high - low) / (columns, rows), rows, columns)


def spread_over(patch: IndexArray, seen: Array, grid: Grid) -> csr_array:
    """Share of a force on each vertex that falls on each cell, by the cell's area.

    It is spread as the vertex's shape function on the triangles of the patch around it.

    Args:
        patch: Triangles, shape (m, 3).
        seen: Where all vertices are in the plane of the grid in [m], shape (v, 2).
        grid: Covers the patch.

    Returns:
        In [1/m^2], shape (rows columns, v).
    """
    corners = seen[patch]
    sides = np.abs(np.roll(corners, -1, axis=1) - corners)
    cuts = np.ceil(_FINE * (sides / grid.edge).max(axis=(1, 2))).astype(int).clip(1, _MOST_CUTS)
    cells, vertices, values = [], [], []
    for count in np.unique(cuts).tolist():
        chosen, middles = np.flatnonzero(cuts == count), _middles(count)
        cell = grid.cell(np.einsum("qa,mai->mqi", middles, corners[chosen]))
        share = _areas(corners[chosen])[:, None, None] / len(middles) * middles[None]
        cells.append(np.repeat(cell[:, :, None], 3, axis=2).ravel())
        vertices.append(np.repeat(patch[chosen][:, None], len(middles), axis=1).ravel())
        values.append(share.ravel())
    entries = (np.concatenate(values), (np.concatenate(cells), np.concatenate(vertices)))
    spread = csr_array(entries, shape=(grid.rows * grid.columns, len(seen)))
    whole = np.asarray(spread.sum(axis=0)).ravel() * grid.area
    spread.data /= np.where(whole > 0.0, whole, 1.0)[spread.indices]
    return spread


def _areas(corners: Array) -> Array:
    """Areas of triangles (m, 3, 2) in a plane, shape (m,)."""
    (x, y), (u, v) = (np.moveaxis(corners[:, k] - corners[:, 0], 1, 0) for k in (1, 2))
    return np.asarray(0.5 * np.abs(x * v - y * u))


def _middles(count: int) -> Array:
    """Centres of the `count` squared equal parts of a triangle, as shares of its corners, shape (q, 3)."""
    i, j = (each.ravel() for each in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    upward, downward = i + j < count, i + j < count - 1
    first = np.concatenate([i[upward] + 1.0 / 3.0, i[downward] + 2.0 / 3.0]) / count
    second = np.concatenate([j[upward] + 1.0 / 3.0, j[downward] + 2.0 / 3.0]) / count
    return np.column_stack([1.0 - first - second, first, second])
