"""Cells of one element and one material law, at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.fem.elements.element import Element, cell_axes, rest_quadrature
from softsim_core.fem.materials.material import Material


@dataclass(frozen=True, slots=True, eq=False)
class ElementGroup:
    """Cells of all bodies that share an element and a law.

    Attributes:
        element: What a cell is.
        material: Their law.
        cells: Node indices, shape (m, a).
        weights: Rest volume at each quadrature point in [m^3], shape (m, q).
        gradients: Shape gradients at rest in [1/m], in the axes that the law asks for, shape (m, q, a, 3).
        body: Index of each cell's body, shape (m,).
        numbers: Number of each cell among those of all bodies in order, shape (m,).
    """

    element: Element
    material: Material
    cells: IndexArray
    weights: Array
    gradients: Array
    body: IndexArray
    numbers: IndexArray

    @property
    def volumes(self) -> Array:
        """Rest volume of each cell in [m^3], shape (m,)."""
        return np.asarray(self.weights.sum(axis=1))

    def part(self, chosen: IndexArray) -> ElementGroup:
        """The group of the chosen cells (k,) alone."""
        arrays = {
            name: getattr(self, name)[chosen] for name in ("cells", "weights", "gradients", "body", "numbers")
        }
        return replace(self, **arrays)

    def values(self, parameters: Sequence[Mapping[str, float]]) -> Array:
        """Values of the law's parameters for each cell, shape (m, k).

        Args:
            parameters: Those of each body by name.
        """
        bodies = np.unique(self.body)
        table = np.zeros((max(len(parameters), 1), len(self.material.parameters)))
        for b in bodies.tolist():
            table[b] = [parameters[b][name] for name in self.material.names]
        return np.asarray(table[self.body])


def element_group(
    element: Element,
    material: Material,
    points: Array,
    cells: IndexArray,
    body: IndexArray,
    numbers: IndexArray,
) -> ElementGroup:
    """A group of cells (m, a) on rest positions `points` (n, 3) in [m]; the rest as in ElementGroup."""
    corners = points[cells]
    weights, gradients = rest_quadrature(element, corners)
    if material.in_cell_axes:
        gradients = np.ascontiguousarray(gradients @ cell_axes(corners)[:, None])
    return ElementGroup(element, material, cells, weights, gradients, body, numbers)


def empty_group(element: Element, material: Material) -> ElementGroup:
    """A group without cells."""
    none = np.zeros(0, dtype=np.int64)
    nodes = len(element.reference)
    return element_group(element, material, np.zeros((nodes, 3)), np.zeros((0, nodes), np.int64), none, none)
