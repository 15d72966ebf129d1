"""Stress at nodes from that at the quadrature points of the cells around them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from softsim_core.arrays import Array
from softsim_core.fem.cells import cauchy_stress
from softsim_core.fem.elements.element import Element
from softsim_core.fem.group import ElementGroup


def to_nodes(element: Element) -> Array:
    """Values at the nodes of a cell from those at its points, shape (a, q): the linear field nearest to them.

    With fewer than four points it is their mean.
    """
    if len(element.points) < 4:
        return np.full((len(element.reference), len(element.points)), 1.0 / len(element.points))
    at_points, at_nodes = (
        np.column_stack([np.ones(len(each)), each]) for each in (element.points, element.reference)
    )
    return np.asarray(at_nodes @ np.linalg.pinv(at_points))


def stress_at_nodes(
    groups: Sequence[ElementGroup],
    positions: Array,
    materials: Sequence[Mapping[str, float]],
) -> Array:
    """Stress in world axes in [Pa], shape (n, 3, 3): the mean over the cells around each node; zero without.

    A stress that is linear in space comes out exactly at the nodes of quadratic cells; at their corners it
    is one order more accurate than a mean over the points.

    Args:
        groups: The cells, without layers and fibres.
        positions: Node positions in [m], shape (n, 3).
        materials: See fem.assembly.elastic_forces.

    Source: Hinton and Campbell 1974, Local and global smoothing of discontinuous finite element functions.
    """
    total, around = np.zeros((len(positions), 3, 3)), np.zeros(len(positions))
    for group in groups:
        at_points = cauchy_stress(group, positions, group.values(materials))
        of_nodes = np.einsum("aq,mqij->maij", to_nodes(group.element), at_points)
        np.add.at(total, group.cells, of_nodes)
        np.add.at(around, group.cells, 1.0)
    return np.asarray(total / np.maximum(around, 1.0)[:, None, None])
