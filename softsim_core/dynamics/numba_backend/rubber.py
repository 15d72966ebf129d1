"""Compiled cells of rubber: laws that are a function of I_C = F : F, in elements of any nodes and points.

The formulas are those of fem.assembly with fem.materials.first_invariant. With the stress
P = 2 psi' F + (p - s) cof F at a point of weight w, and g the gradients of the shape functions, the block of
nodes m and n is

    w [2 psi' (g_m . g_n) I + 4 psi'' (F g_m)(F g_n)^T + (p - s) [F (g_m x g_n)]x + a_p (C g_m)(C g_n)^T]

with C = cof F, and of cells with a mean volume (a - a_p) / V g_m' g_n'^T, g' = sum w C g.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array
from softsim_core.dynamics.numba_backend.batches import CellBatches, gather, in_lanes, put_gradient
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.rubber_lanes import (
    LEFT_ROWS,
    MODULI,
    NODE_ROWS,
    POINT_ROWS,
    put_block,
    put_left,
    put_node,
    put_stress,
    put_volume,
)
from softsim_core.dynamics.numba_backend.scatter import CellPlaces, add_blocks
from softsim_core.fem.assembly import mean_volume_law, split_bulk
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.materials.first_invariant import SeriesRubber
from softsim_core.fem.materials.relaxing import Relaxing, law_within
from softsim_core.linalg.simd import LANES


class RubberCells(NamedTuple):
    """Cells of one element and one law, in B batches of LANES, with a nodes and q points.

    Attributes:
        cells: Their nodes and gradients.
        weights: Rest volume at each point in [m^3], shape (B q, LANES).
        moduli: In [Pa], see `tune`, shape (B MODULI, LANES).
    """

    cells: CellBatches
    weights: Array
    moduli: Array


def rubber_cells(group: ElementGroup, cells: CellBatches) -> RubberCells:
    """The cells of a group of a SeriesRubber; `tune` gives them the values of their law."""
    weights = in_lanes(group.weights)
    return RubberCells(cells, weights.reshape(-1, LANES), np.zeros((len(weights) * MODULI, LANES)))


def tune(cells: RubberCells, group: ElementGroup, p: Array) -> None:
    """Take over the values p (m, k) of the law's parameters.

    The moduli are the coefficients of psi, see SeriesRubber, s, the slope of psi's part by a principal
    stretch at rest, and the bulk coefficients at the points and on the mean.
    """
    law, left = law_within(group.material), np.ones(len(p))
    if isinstance(group.material, Relaxing):
        left, p = group.material.left(p), group.material.own(p)
    assert isinstance(law, SeriesRubber)  # see PairedCells
    bulk = (law.bulk(p), np.zeros(len(p))) if mean_volume_law(group) is None else split_bulk(law, p)
    series = left[:, None] * law.series(p)
    moduli = np.column_stack([series, left * law.rest_moduli(p).slope, *bulk])
    cells.moduli[:] = in_lanes(moduli).reshape(-1, LANES)


@kernel
def put_means(points: Array, weights: Array, first: int, count: int, means: Array) -> None:
    """Means over each cell's `count` points of their rows 27 to 30, then its volume, into `means`."""
    means[:] = 0.0
    for q in range(count):
        for lane in range(LANES):
            w = weights[first + q, lane]
            means[3, lane] += w
            for k in range(3):
                means[k, lane] += w * points[POINT_ROWS * q + 27 + k, lane]
    for lane in range(LANES):
        for k in range(3):
            means[k, lane] /= means[3, lane]


@kernel
def fill_rubber(
    x: Array, moved: Array, velocities: Array, lag: float, mean_share: float, scale: float,
    rubber: RubberCells, places: CellPlaces, forces: Array, panels: Array, kept: Array,
) -> None:  # fmt: skip
    """Add f - lag K v of the cells to the forces (n, 3), and `scale` times their stiffness to the matrix.

    Args:
        x: Positions in [m], shape (n, 3).
        moved: See fem.assembly.cell_stiffness, shape (n, 3); no rows: the pressure of K is that at x.
        velocities: In [m/s], shape (n, 3).
        mean_share: See fem.assembly.cell_stiffness.
        lag: In [s].
        scale: Of the stiffness.
        rubber: The cells.
        places: Where their blocks go.
        forces: In [N], shape (n, 3).
        panels: Of the factor.
        kept: See Pairs.blocks.
    """
    nodes, gradients, weights = rubber.cells.nodes, rubber.cells.gradients, rubber.weights
    batches, a, _ = nodes.shape
    count = len(weights) // batches
    values, states = np.zeros((3 * a, LANES)), np.empty((POINT_ROWS * count, LANES))
    step, means, bulk = np.empty((9, LANES)), np.empty((4, LANES)), np.empty((1, LANES))
    right, left = np.empty((NODE_ROWS * a * count, LANES)), np.empty((LEFT_ROWS * count, LANES))
    volumes, pulls = np.empty((3 * a, LANES)), np.empty((3 * a, LANES))
    blocks, pitch = np.empty((3 * a * (a + 1) // 2, LANES, 4)), 3 * count
    for batch in range(batches):
        place, weight = batch * a * pitch, batch * count
        gather(x, nodes, batch, values)
        for q in range(count):
            put_gradient(values, gradients, place + 3 * q, pitch, a, states, POINT_ROWS * q)
        gather(velocities, nodes, batch, values)
        for q in range(count):
            put_gradient(values, gradients, place + 3 * q, pitch, a, states, POINT_ROWS * q + 18)
        if len(moved):
            gather(moved, nodes, batch, values)
        else:
            values[:] = 0.0
        for q in range(count):
            put_gradient(values, gradients, place + 3 * q, pitch, a, step, 0)
            put_volume(states, POINT_ROWS * q, step)
        put_means(states, weights, weight, count, means)
        volumes[:] = 0.0
        pulls[:] = 0.0
        for q in range(count):
            point = POINT_ROWS * q
            put_stress(
                states, point, weights, weight + q, rubber.moduli, batch, means, lag, mean_share, scale
            )
            for n in range(a):
                slope, row = place + n * pitch + 3 * q, NODE_ROWS * (n * count + q)
                put_node(states, point, gradients, slope, weights, weight + q, n, right, row, volumes, pulls)
        for lane in range(LANES):
            bulk[0, lane] = scale * mean_share * rubber.moduli[MODULI * batch + 6, lane] / means[3, lane]
        pair = 0
        for m in range(a):
            for q in range(count):
                slope, row = place + m * pitch + 3 * q, NODE_ROWS * (m * count + q)
                put_left(states, POINT_ROWS * q, gradients, slope, right, row, left, LEFT_ROWS * q)
            for n in range(m, a):
                row, slope = NODE_ROWS * n * count, place + n * pitch
                put_block(left, right, row, gradients, slope, count, volumes, m, n, bulk, blocks, pair)
                pair += 1
        first = batch * LANES
        for lane in range(min(LANES, len(places.strides) - first)):
            for n in range(a):
                for i in range(3):
                    forces[nodes[batch, n, lane], i] += pulls[3 * n + i, lane]
            add_blocks(blocks, 4 * lane, 4 * LANES, first + lane, places, panels, kept)
