"""Groups of cells that share an element and a law, at rest: locking, volume shares, consistent mass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.fem.elements import Element, cell_axes, rest_quadrature, surface_quadrature
from softsim_core.physics.fem.materials import Material

LOCKING_RATIO = 0.49
"""From this Poisson ratio on, linear tetrahedra are much too stiff because they lock."""


def locking_warning(element: Element, values: Mapping[str, float]) -> str | None:
    """Return a warning if cells of this element lock with these parameters of a law, else None."""
    ratio = values.get("poisson_ratio", 0.0)
    if len(element.reference) != 4 or ratio < LOCKING_RATIO:
        return None
    return (
        f"poisson_ratio {ratio:g} is too stiff: nearly incompressible linear tetrahedra lock; "
        f"take less than {LOCKING_RATIO:g}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class ElementGroup:
    """Cells of all bodies that share an element and a law.

    Attributes:
        element: Element of the cells.
        material: Law of the cells.
        cells: Node indices, shape (m, a).
        weights: Rest volume at each quadrature point in [m^3], shape (m, q).
        gradients: Shape gradients at rest in [1/m], in the axes that the law requires, shape (m, q, a, 3).
        body: Index of each cell's body, shape (m,).
        numbers: Number of each cell, shape (m,): first the cells of all bodies in order, then reinforcements.
        parameter_set: Index in Parameters.materials of each cell's values, shape (m,): that of its body, its
            layer or its fibres.
        fills: Whether the cells fill their bodies. Fibres and layers do not: they add no mass and no volume.
    """

    element: Element
    material: Material
    cells: IndexArray
    weights: Array
    gradients: Array
    body: IndexArray
    numbers: IndexArray
    parameter_set: IndexArray
    fills: bool = True

    per_cell: ClassVar[Sequence[str]] = ("cells", "weights", "gradients", "body", "numbers", "parameter_set")

    @property
    def volumes(self) -> Array:
        """Rest volume of each cell in [m^3], shape (m,)."""
        return np.asarray(self.weights.sum(axis=1))

    @property
    def short(self) -> BoolArray:
        """Which cells are far shorter than they are thick, such as clamps of rods, shape (m,)."""
        return np.zeros(len(self.cells), dtype=np.bool_)

    def part(self, chosen: IndexArray) -> ElementGroup:
        """Return the group with the chosen cells (k,) only."""
        return replace(self, **{name: getattr(self, name)[chosen] for name in self.per_cell})

    def with_node_order(self, inside: IndexArray) -> ElementGroup:
        """Return the group with the nodes of each cell in another order, `inside`, shape (m, a)."""
        return replace(self, **self.of_nodes(inside))

    def of_nodes(self, inside: IndexArray) -> dict[str, Any]:
        """Return the arrays that `with_node_order` changes, by name."""
        return {
            "cells": np.take_along_axis(self.cells, inside, axis=1),
            "gradients": np.take_along_axis(self.gradients, inside[:, None, :, None], axis=2),
        }

    def values(self, parameters: Sequence[Mapping[str, float]]) -> Array:
        """Return the values of the law's parameters for each cell, shape (m, k).

        Args:
            parameters: Values of each set by name; see Parameters.materials.
        """
        table = np.zeros((max(len(parameters), 1), len(self.material.parameters)))
        for s in np.unique(self.parameter_set).tolist():
            table[s] = [parameters[s][name] for name in self.material.names]
        return np.asarray(table[self.parameter_set])


def element_group(
    element: Element,
    material: Material,
    points: Array,
    cells: IndexArray,
    body: IndexArray,
    numbers: IndexArray,
) -> ElementGroup:
    """Return a group of cells (m, a) on rest positions `points` (n, 3) in [m].

    The other arguments are those of ElementGroup.
    """
    corners = points[cells]
    weights, gradients = rest_quadrature(element, corners)
    if material.in_cell_axes:
        gradients = np.ascontiguousarray(gradients @ cell_axes(corners)[:, None])
    return ElementGroup(element, material, cells, weights, gradients, body, numbers, body)


def fibre_group(
    cells: ElementGroup, material: Material, points: Array, axes: Array, parameter_set: IndexArray
) -> ElementGroup:
    """Return a group of fibres that run through the cells of bodies.

    Args:
        cells: The cells that they run through.
        material: Law of the fibres.
        points: Rest positions in [m], shape (n, 3).
        axes: Rotation at each point; its first column is the direction of the fibres, shape (m, q, 3, 3).
        parameter_set: See ElementGroup.
    """
    gradients = np.ascontiguousarray(rest_quadrature(cells.element, points[cells.cells])[1] @ axes)
    return replace(cells, material=material, gradients=gradients, parameter_set=parameter_set, fills=False)


def layer_group(
    element: Element,
    material: Material,
    points: Array,
    faces: IndexArray,
    thickness: Array,
    body: IndexArray,
    numbers: IndexArray,
    parameter_set: IndexArray,
) -> ElementGroup:
    """Return a group of thin layers on faces (m, a) of bodies, with a thickness in [m], shape (m,).

    The other arguments are those of `element_group` and ElementGroup.
    """
    weights, gradients = surface_quadrature(element, points[faces], thickness)
    return ElementGroup(element, material, faces, weights, gradients, body, numbers, parameter_set, False)


def empty_group(element: Element, material: Material) -> ElementGroup:
    """Return a group without cells."""
    none = np.zeros(0, dtype=np.int64)
    nodes = len(element.reference)
    return element_group(element, material, np.zeros((nodes, 3)), np.zeros((0, nodes), np.int64), none, none)


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
