"""Compiled cells of any element and any law with vector code for its stress at a point, and their memory.

The formulas are those of fem.cells. With stress P and tangent C at a point of weight w, and g the gradients
of the shape functions, the block of nodes m and n is the sum over the points of

    w g_m . C . g_n,    and of cells with a mean volume (a - a_p) / V g_m' g_n'^T,   g' = sum w theta' g

For each batch, `deform` computes gradients, the law computes theta, `press` the pressures, the law stress and
tangent, and `finish` forces and blocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend import kernel
from softsim_core.physics.dynamics.numba_backend.cells.batches import (
    CellBatches,
    CellPlaces,
    add_blocks,
    allocate_aligned,
    gather,
    put_gradient,
)
from softsim_core.physics.dynamics.numba_backend.cells.lanes import (
    LEFT_ROWS,
    POINT_ROWS,
    put_answer,
    put_block,
    put_left,
    put_node,
)
from softsim_core.physics.fem import FLATTEST
from softsim_core.physics.linalg import LANES


class BatchBuffers(NamedTuple):
    """Buffers for one batch, each a multiple of LANES numbers; see `allocate_buffers`.

    Attributes:
        values: Values of the nodes, rows 3 a + i.
        points: Rows of points, see lanes.
        steps: Gradient of the last solve's displacement at each point, rows 9 q + k.
        step_stress: H at each point, its upper triangle, rows 6 q + k.
        means: Means over the cells of rows 27 to 30 of their points, and their volumes.
        bulk: One row, see put_answer and put_block.
        volumes, pulls: Sums of put_node, rows 3 a + i.
        left: See put_left, LEFT_ROWS rows per point.
        blocks: See put_block, shape (3 a (a + 1) / 2, LANES, 4).
    """

    values: Array
    points: Array
    steps: Array
    step_stress: Array
    means: Array
    bulk: Array
    volumes: Array
    pulls: Array
    left: Array
    blocks: Array


def allocate_buffers(a: int, count: int) -> BatchBuffers:
    """Return buffers for batches of cells with a nodes and `count` points."""
    rows = (3 * a, POINT_ROWS * count, 9 * count, 6 * count, 4, 1, 3 * a, 3 * a, LEFT_ROWS * count)
    values, points, steps, stress, means, bulk, volumes, pulls, left = (
        allocate_aligned((each, LANES)) for each in rows
    )
    blocks = allocate_aligned((3 * a * (a + 1) // 2, LANES, 4))
    return BatchBuffers(values, points, steps, stress, means, bulk, volumes, pulls, left, blocks)


class PointCells(NamedTuple):
    """Cells of one element and one law, in B batches of LANES, with a nodes and q points.

    Attributes:
        cells: Nodes and gradients of the cells.
        weights: Rest volume at each point in [m^3], shape (B q, LANES).
        moduli: For each batch, the bulk coefficients at the points and on the mean in [Pa], then the law's
            moduli, k numbers in all, shape (B k, LANES).
        memory: Place of each cell in its group's memory, shape (m,); see fem.prony.
        buffers: Buffers.
    """

    cells: CellBatches
    weights: Array
    moduli: Array
    memory: IndexArray
    buffers: BatchBuffers


class CellInputs(NamedTuple):
    """Inputs for the forces and stiffness of cells.

    Attributes:
        x: Positions in [m], shape (n, 3).
        moved: See fem.cells.cell_stiffness, shape (n, 3); no rows: the pressure in K is that at x.
        velocities: Velocities in [m/s], shape (n, 3).
        step_stress: Viscoelastic stress H in [Pa], shape (., q, 3, 3), see fem.prony; no rows: none.
        positive: Whether K must have no negative eigenvalues; see fem.cells.cell_stiffness.
        lag: Time lag in [s].
        mean_share: See fem.cells.cell_stiffness.
        scale: Factor on the stiffness in the matrix.
    """

    x: Array
    moved: Array
    velocities: Array
    step_stress: Array
    positive: bool
    lag: float
    mean_share: float
    scale: float


class CellOutputs(NamedTuple):
    """Outputs for the forces and stiffness of cells.

    Attributes:
        places: Places of the blocks.
        forces: f - lag K v is added, in [N], shape (n, 3).
        panels: Panels of the factor; the stiffness is added.
        pair_blocks: See Pairs.blocks.
    """

    places: CellPlaces
    forces: Array
    panels: Array
    pair_blocks: Array


@kernel
def deform(batch: int, inputs: CellInputs, cells: PointCells) -> None:
    """Compute rows 0 to 18 of all points, and the gradients of `moved`, which are zero if it has no rows."""
    nodes, gradients = cells.cells.nodes, cells.cells.gradients
    buffers = cells.buffers
    values, points, steps = buffers.values, buffers.points, buffers.steps
    batches, a, _ = nodes.shape
    count = len(cells.weights) // batches
    place, pitch = batch * a * 3 * count, 3 * count
    gather(inputs.x, nodes, batch, values)
    for q in range(count):
        put_gradient(values, gradients, place + 3 * q, pitch, a, points, POINT_ROWS * q)
    gather(inputs.velocities, nodes, batch, values)
    for q in range(count):
        put_gradient(values, gradients, place + 3 * q, pitch, a, points, POINT_ROWS * q + 9)
    if len(inputs.moved):
        gather(inputs.moved, nodes, batch, values)
        for q in range(count):
            put_gradient(values, gradients, place + 3 * q, pitch, a, steps, 9 * q)
    else:
        steps[:] = 0.0


@kernel
def press(batch: int, cells: PointCells) -> None:
    """Compute means over the cells, and the pressures at their points, a_p theta + (a - a_p) mean(theta)."""
    points, means, weights, moduli = cells.buffers.points, cells.buffers.means, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, row = len(weights) // batches, batch * (len(moduli) // batches)
    means[:] = 0.0
    for q in range(count):
        for lane in range(LANES):
            w = weights[count * batch + q, lane]
            means[3, lane] += w
            for k in range(3):
                means[k, lane] += w * points[POINT_ROWS * q + 27 + k, lane]
    for lane in range(LANES):
        for k in range(3):
            means[k, lane] /= means[3, lane]
    for q in range(count):
        for k in range(2):
            for lane in range(LANES):
                at_point, on_mean = moduli[row, lane], moduli[row + 1, lane]
                dilatation = points[POINT_ROWS * q + 27 + k, lane]
                points[POINT_ROWS * q + 84 + k, lane] = at_point * dilatation + on_mean * means[k, lane]


@kernel
def gather_stress(batch: int, stress: Array, cells: PointCells, out: Array) -> None:
    """Write H at the points of a batch to rows 6 q + k of `out`."""
    size = cells.cells.size[0]
    for lane in range(LANES):
        e = cells.memory[min(batch * LANES + lane, size - 1)]
        for q in range(stress.shape[1]):
            k = 6 * q
            for i in range(3):
                for j in range(i, 3):
                    out[k, lane] = stress[e, q, i, j]
                    k += 1


@kernel
def finish(batch: int, inputs: CellInputs, cells: PointCells, into: CellOutputs) -> None:
    """Compute forces and blocks of a batch from stress and tangent at its points."""
    nodes, gradients, weights, moduli = cells.cells.nodes, cells.cells.gradients, cells.weights, cells.moduli
    buffers = cells.buffers
    points, means, stress, scale = buffers.points, buffers.means, buffers.step_stress, inputs.scale
    batches, a, _ = nodes.shape
    count, row = len(weights) // batches, batch * (len(moduli) // batches)
    place, pitch, weight = batch * a * 3 * count, 3 * count, batch * count
    volumes, pulls, left, bulk, blocks = (
        buffers.volumes,
        buffers.pulls,
        buffers.left,
        buffers.bulk,
        buffers.blocks,
    )
    volumes[:] = 0.0
    pulls[:] = 0.0
    if len(inputs.step_stress):
        gather_stress(batch, inputs.step_stress, cells, stress)
    for lane in range(LANES):
        bulk[0, lane] = inputs.mean_share * moduli[row + 1, lane] * means[2, lane]
    for q in range(count):
        put_answer(points, POINT_ROWS * q, stress, 6 * q, weights, weight + q, bulk, inputs.lag)
        for n in range(a):
            slope = place + n * pitch + 3 * q
            put_node(points, POINT_ROWS * q, gradients, slope, weights, weight + q, n, volumes, pulls)
    for lane in range(LANES):
        bulk[0, lane] = scale * inputs.mean_share * moduli[row + 1, lane] / means[3, lane]
    pair = 0
    for m in range(a):
        for q in range(count):
            slope = place + m * pitch + 3 * q
            put_left(points, POINT_ROWS * q, gradients, slope, scale, left, LEFT_ROWS * q)
        for n in range(m, a):
            put_block(left, gradients, place + n * pitch, count, volumes, m, n, bulk, blocks, pair)
            pair += 1
    forces, places, panels, pair_blocks = into.forces, into.places, into.panels, into.pair_blocks
    first = batch * LANES
    for lane in range(min(LANES, cells.cells.size[0] - first)):
        for n in range(a):
            for i in range(3):
                forces[nodes[batch, n, lane], i] += pulls[3 * n + i, lane]
        add_blocks(blocks, 4 * lane, 4 * LANES, first + lane, places, panels, pair_blocks)


LEAST_VOLUME = FLATTEST


class Memory(NamedTuple):
    """Memory of m cells with q points and t terms, see fem.prony.memory_shape, and its decay in a step.

    Attributes:
        stresses: s of each term and then S in [Pa], shape (m, q, t + 1, 3, 3).
        fades: exp(-h / tau), shape (m, t).
        gains: g exp(-h / 2 tau), shape (m, t).
    """

    stresses: Array
    fades: Array
    gains: Array


@kernel
def hold(memory: Memory, stress: Array) -> None:
    """Write H of a step into `step_stress` (m, q, 3, 3)."""
    stresses, fades, gains = memory.stresses, memory.fades, memory.gains
    terms = fades.shape[1]
    for e in range(len(stresses)):
        gain = 0.0
        for t in range(terms):
            gain += gains[e, t]
        for q in range(stresses.shape[1]):
            for i in range(3):
                for j in range(3):
                    total = -gain * stresses[e, q, terms, i, j]
                    for t in range(terms):
                        total += fades[e, t] * stresses[e, q, t, i, j]
                    stress[e, q, i, j] = total


@kernel
def remember(batch: int, cells: PointCells, memory: Memory) -> None:
    """Advance the memory of a batch with S, from the stress at its points without pressure."""
    points, weights, size = cells.buffers.points, cells.weights, cells.cells.size[0]
    stresses, fades, gains = memory.stresses, memory.fades, memory.gains
    count, terms = len(weights) // len(cells.cells.nodes), fades.shape[1]
    f, p, inverse, s = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for lane in range(min(LANES, size - batch * LANES)):
        e = cells.memory[batch * LANES + lane]
        for q in range(count):
            row, over = POINT_ROWS * q, 1.0 / weights[count * batch + q, lane]
            for i in range(3):
                for j in range(3):
                    f[i, j] = points[row + 3 * i + j, lane]
                    p[i, j] = over * points[row + 30 + 3 * i + j, lane]
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                for j in range(3):
                    c, d = (j + 1) % 3, (j + 2) % 3
                    inverse[j, i] = f[a, c] * f[b, d] - f[a, d] * f[b, c]
            volume = f[0, 0] * inverse[0, 0] + f[0, 1] * inverse[1, 0] + f[0, 2] * inverse[2, 0]
            if volume > LEAST_VOLUME:
                for i in range(3):
                    for j in range(3):
                        s[i, j] = 0.0
                        for k in range(3):
                            s[i, j] += inverse[i, k] * p[k, j]
                        s[i, j] /= volume
            else:
                s[:] = stresses[e, q, terms]
            for i in range(3):
                for j in range(3):
                    now = 0.5 * (s[i, j] + s[j, i])
                    gained = now - stresses[e, q, terms, i, j]
                    for t in range(terms):
                        past = fades[e, t] * stresses[e, q, t, i, j]
                        stresses[e, q, t, i, j] = past + gains[e, t] * gained
                    stresses[e, q, terms, i, j] = now
