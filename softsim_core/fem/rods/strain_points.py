"""Where cells of rods strain, and how: functions of products of a cell's vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray

R, D1, D2, B1, B2 = range(5)
"""Vectors of a cell at a point: r', d_1, d_2, d_1', d_2'."""


def _forms(*entries: tuple[int, int, int, float], strains: int, vectors: int) -> Array:
    """Matrices Q of products v^T Q_k v / 2, shape (strains, vectors, vectors)."""
    forms = np.zeros((strains, vectors, vectors))
    for k, f, g, value in entries:
        forms[k, f, g] = forms[k, g, f] = value
    return forms


LINE_FORMS: Final = _forms(
    (0, R, R, 1.0),
    (1, R, D1, 1.0),
    (2, R, D2, 1.0),
    (3, R, B1, 1.0),
    (4, R, B2, 1.0),
    (5, B1, D2, 0.5),
    (5, D1, B2, -0.5),
    strains=6,
    vectors=5,
)
SECTION_FORMS: Final = _forms((0, 0, 0, 1.0), (1, 1, 1, 1.0), (2, 0, 1, 1.0), strains=3, vectors=2)

SHORTEST: Final = 0.05
"""|r'| below which a rod is no longer told from a shorter one: it has been crushed."""

BENDING: Final = (3, 4)
"""Which of the strains along a rod are bending."""


class Strains(NamedTuple):
    """Strains at points.

    Attributes:
        values: Shape (m, q, k).
        slopes: Their derivatives by the products, shape (m, q, k, k).
    """

    values: Array
    slopes: Array


@dataclass(frozen=True, slots=True, eq=False)
class StrainPoints:
    """Where a cell strains: the same number of points in each.

    Attributes:
        maps: From the nodes of a cell to its vectors, shape (m, q, f, a).
        forms: Products of the vectors, shape (k, f, f); see `LINE_FORMS`.
        natural: Strains without load, shape (m, q, k).
        lengths: What the energy is integrated over, in [m], shape (m, q).
        stiffness: Of strains, over the values of the law that `scales` names, shape (m, q, k, k).
        along: Whether the strains are those along a rod; else they are the products themselves.
    """

    maps: Array
    forms: Array
    natural: Array
    lengths: Array
    stiffness: Array
    along: bool

    def part(self, chosen: IndexArray) -> StrainPoints:
        """Of the chosen cells (k,) alone."""
        each: dict[str, Any] = {
            name: getattr(self, name)[chosen] for name in ("maps", "natural", "lengths", "stiffness")
        }
        return replace(self, **each)

    def ordered(self, inside: IndexArray) -> StrainPoints:
        """With the nodes of each cell in another order, shape (m, a)."""
        return replace(self, maps=np.take_along_axis(self.maps, inside[:, None, None, :], axis=3))

    @staticmethod
    def joined(parts: Sequence[StrainPoints]) -> StrainPoints:
        """Those of all cells of several; their strains are of one kind."""
        names = ("maps", "natural", "lengths", "stiffness")
        each: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in names
        }
        return replace(parts[0], **each)

    def vectors(self, nodal: Array, cells: IndexArray) -> Array:
        """The vectors of nodal values (n, 3), shape (m, q, f, 3)."""
        return np.asarray(self.maps @ nodal[cells][:, None])

    def products(self, vectors: Array) -> Array:
        """v^T Q_k v / 2 of vectors (m, q, f, 3), shape (m, q, k)."""
        return np.asarray(0.5 * np.einsum("mqfi,kfg,mqgi->mqk", vectors, self.forms, vectors))

    def strains(self, products: Array) -> Strains:
        """Of products (m, q, k)."""
        count = products.shape[-1]
        slopes = np.broadcast_to(np.eye(count), (*products.shape, count))
        if not self.along:
            return Strains(products - self.natural, slopes)
        values, slopes, by_length = products.copy(), slopes.copy(), 1.0 / _stretched(products)
        values[..., 0] = 1.0 / by_length
        slopes[..., 0, 0] = by_length
        for k in BENDING:
            values[..., k] *= by_length
            slopes[..., k, k] = by_length
            slopes[..., k, 0] = -products[..., k] * by_length**3
        return Strains(values - self.natural, slopes)

    def bent(self, products: Array, resultants: Array) -> Array:
        """Second derivatives of the strains by products (m, q, k), times resultants, (m, q, k, k)."""
        result = np.zeros((*products.shape, products.shape[-1]))
        if self.along:
            by_length = 1.0 / _stretched(products)
            result[..., 0, 0] = -resultants[..., 0] * by_length**3
            for k in BENDING:
                result[..., 0, 0] += 3.0 * resultants[..., k] * products[..., k] * by_length**5
                result[..., 0, k] = result[..., k, 0] = -resultants[..., k] * by_length**3
        return result

    def slopes(self, vectors: Array) -> Array:
        """Derivatives of the products by the nodes, shape (m, q, k, a, 3)."""
        by_vectors = np.einsum("kfg,mqgi->mqkfi", self.forms, vectors)
        return np.asarray(np.swapaxes(self.maps, -1, -2)[:, :, None] @ by_vectors)


def _stretched(products: Array) -> Array:
    """|r'| of products (m, q, 6), shape (m, q)."""
    return np.maximum(np.sqrt(2.0 * products[..., 0]), SHORTEST)
