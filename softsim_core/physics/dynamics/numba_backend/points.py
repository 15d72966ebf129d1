"""Compiled cells of any element and any law with vector code for its stress at a point, and their memory.

The formulas are those of fem.cells. With stress P and tangent C at a point of weight w, and g the gradients
of the shape functions, the block of nodes m and n is the sum over the points of

    w g_m . C . g_n,    and of cells with a mean volume (a - a_p) / V g_m' g_n'^T,   g' = sum w theta' g

For each batch, `deform` computes gradients, the law computes theta, `press` the pressures, the law stress and
tangent, and `finish_batch` forces and blocks, or the memory. The numbers of a point are in POINT_ROWS rows of
one buffer, by the names below; stress and tangent are multiplied by the weight of the point.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend.batches import (
    CellBatches,
    allocate_aligned,
    cofactors,
    contraction,
    difference,
    dot,
    gather_nodes,
    matrix_at,
    minus,
    plus,
    put_gradient,
    put_matrix,
    put_triple,
    scaled,
    times,
    transposed,
    triple_at,
)
from softsim_core.physics.dynamics.numba_backend.layout import CellPlaces, add_blocks, kernel
from softsim_core.physics.fem import FLATTEST
from softsim_core.physics.linalg import LANES, part, put, put_quads, row

DEFORMATION, RATE, DILATATION_SLOPE = 0, 9, 18
"""Rows of F, of the gradient of the velocities, and of the slope of theta by F, each 3 x 3."""

DILATATION, FOUND_DILATATION, DILATATION_RATE = 27, 28, 29
"""Rows of theta, of theta as the last solve found it, and of its rate."""

STRESS, TANGENT = 30, 39
"""Rows of the stress, 3 x 3, and of the tangent: the upper triangle of 9 x 9, ij before kl."""

PRESSURE = 84
"""Rows of the pressure at theta, and at theta as the last solve found it."""

LAW = 86
"""First of the rows that belong to the law."""

POINT_ROWS = 128
"""Number of rows of a point."""

LEFT_ROWS = 27
"""Number of rows of a pair's first node at a point: sum over J of g_J times the tangent (i J)(k l)."""

_FIRST, _SECOND = np.triu_indices(9)
UPPER = np.zeros((9, 9), np.int64)
"""Row of the tangent from TANGENT on for two entries of F."""
UPPER[_FIRST, _SECOND] = UPPER[_SECOND, _FIRST] = np.arange(45)

_OF_STRESS = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Row of a symmetric stress for two axes."""


class BatchBuffers(NamedTuple):
    """Buffers for one batch, each a multiple of LANES numbers; see `allocate_buffers`.

    Attributes:
        values: Values of the nodes, rows 3 a + i.
        points: Rows of points, see the module.
        steps: Gradient of the last solve's displacement at each point, rows 9 q + k.
        step_stress: H at each point, its upper triangle, rows 6 q + k.
        means: Means over the cells of theta at their points, as found, and of its rate; and their volumes.
        bulk: One row, see put_answer and put_block.
        volumes, pulls: Sums of put_node, rows 3 a + i.
        left: See put_left, LEFT_ROWS rows per point.
        blocks: Row 3 pair + i of every lane, four numbers, shape (3 a (a + 1) / 2, LANES, 4).
        modes: See stretches.put_modes.
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
    modes: Array


def allocate_buffers(a: int, count: int) -> BatchBuffers:
    """Return buffers for batches of cells with a nodes and `count` points."""
    rows = (3 * a, POINT_ROWS * count, 9 * count, 6 * count, 4, 1, 3 * a, 3 * a, LEFT_ROWS * count)
    values, points, steps, stress, means, bulk, volumes, pulls, left = (
        allocate_aligned((each, LANES)) for each in rows
    )
    blocks, modes = allocate_aligned((3 * a * (a + 1) // 2, LANES, 4)), allocate_aligned((162, LANES))
    return BatchBuffers(values, points, steps, stress, means, bulk, volumes, pulls, left, blocks, modes)


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
        moved: See fem.cells.LinearMove, shape (n, 3); no rows: the pressure in K is that at x.
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
    """Compute F and the gradients of velocities and of `moved` at all points; no rows: that is zero."""
    nodes, gradients = cells.cells.nodes, cells.cells.gradients
    buffers = cells.buffers
    values, points, steps = buffers.values, buffers.points, buffers.steps
    batches, a, _ = nodes.shape
    count = len(cells.weights) // batches
    place, pitch = batch * a * 3 * count, 3 * count
    gather_nodes(inputs.x, nodes, batch, values)
    for q in range(count):
        put_gradient(values, gradients, place + 3 * q, pitch, a, points, POINT_ROWS * q + DEFORMATION)
    gather_nodes(inputs.velocities, nodes, batch, values)
    for q in range(count):
        put_gradient(values, gradients, place + 3 * q, pitch, a, points, POINT_ROWS * q + RATE)
    if len(inputs.moved):
        gather_nodes(inputs.moved, nodes, batch, values)
        for q in range(count):
            put_gradient(values, gradients, place + 3 * q, pitch, a, steps, 9 * q)
    else:
        steps[:] = 0.0


@part
def put_cofactors(points: Array, point: int, moved: Array, place: int) -> None:
    """Write theta = det F - 1 of a point, its slope and rate, and theta as the last solve found it.

    `moved` has the gradient of the last solve's displacement from row `place` on.
    """
    f, step = matrix_at(points, point + DEFORMATION), matrix_at(moved, place)
    before = difference(f, step)
    cofactor, turned = cofactors(f), cofactors(before)
    put_matrix(points, point + DILATATION_SLOPE, cofactor)
    put(points, point + DILATATION, dot(f[0], cofactor[0]) - 1.0)
    found = dot(before[0], turned[0]) - 1.0 + contraction(turned, step)
    put(points, point + FOUND_DILATATION, found)
    put(points, point + DILATATION_RATE, contraction(cofactor, matrix_at(points, point + RATE)))


@part
def put_answer(points: Array, point: int, stress: Array, place: int, w: Any, mean: Any, lag: float) -> None:
    """Add the viscoelastic stress H to stress and tangent of a point, and the response to velocities.

    `stress` has six rows from `place` on, H of fem.prony as its upper triangle. w is the weight of the point,
    `mean` w times the change of pressure by that of the mean volume, `lag` in [s].
    """
    for i in range(3):
        for j in range(3):
            for k in range(j, 3):
                entry = point + TANGENT + UPPER[3 * i + j, 3 * i + k]
                put(points, entry, row(points, entry) + w * row(stress, place + _OF_STRESS[j, k]))
    for i in range(3):
        f, response = triple_at(points, point + DEFORMATION + 3 * i), point + DILATATION_SLOPE + 3 * i
        for j in range(3):
            answer = mean * row(points, response + j)
            for k in range(9):
                slope = row(points, point + TANGENT + UPPER[3 * i + j, k])
                answer = answer + slope * row(points, point + RATE + k)
            h0, h1 = row(stress, place + _OF_STRESS[0, j]), row(stress, place + _OF_STRESS[1, j])
            viscous = f[0] * (w * h0) + f[1] * (w * h1) + f[2] * (w * row(stress, place + _OF_STRESS[2, j]))
            own = point + STRESS + 3 * i + j
            put(points, own, row(points, own) + viscous + lag * answer)


@part
def put_node(points: Array, point: int, g: Any, w: Any, node: int, volumes: Array, forces: Array) -> None:
    """Add a point's contribution to a node: w theta' g to its volumes, -P g to its forces.

    g is the gradient of the node, w the weight of the point; volumes and forces are in rows 3 node + i.
    """
    turned = times(matrix_at(points, point + DILATATION_SLOPE), g)
    pull = times(matrix_at(points, point + STRESS), g)
    put_triple(volumes, 3 * node, plus(triple_at(volumes, 3 * node), scaled(w, turned)))
    put_triple(forces, 3 * node, minus(triple_at(forces, 3 * node), pull))


@part
def put_left(points: Array, point: int, g: Any, out: Array, place: int) -> None:
    """Write LEFT_ROWS rows of `out` from row `place` on for a node with the gradient g at a point."""
    for i in range(3):
        for other in range(9):
            first = row(points, point + TANGENT + UPPER[3 * i, other])
            second = row(points, point + TANGENT + UPPER[3 * i + 1, other])
            third = row(points, point + TANGENT + UPPER[3 * i + 2, other])
            put(out, place + 9 * i + other, first * g[0] + second * g[1] + third * g[2])


@part
def put_block(
    left: Array, gradients: Array, place: int, points: int, volumes: Array, first: int, second: int,
    bulk: Array, blocks: Array, pair: int,
) -> None:  # fmt: skip
    """Write the block of nodes `first` and `second` to `blocks`, see BatchBuffers, in the place of the pair.

    `left` has LEFT_ROWS rows per point, for `points` points. `gradients` has those of the second node, three
    rows per point from `place` on. `volumes` has rows 3 n + i of node n. `bulk` is one row, the factor on the
    product of two volumes.
    """
    mine, other = scaled(row(bulk, 0), triple_at(volumes, 3 * first)), triple_at(volumes, 3 * second)
    x, y, z = scaled(mine[0], other), scaled(mine[1], other), scaled(mine[2], other)
    for q in range(points):
        g, line = triple_at(gradients, place + 3 * q), LEFT_ROWS * q
        x = plus(x, times(matrix_at(left, line), g))
        y = plus(y, times(matrix_at(left, line + 9), g))
        z = plus(z, times(matrix_at(left, line + 18), g))
    put_quads(blocks, 12 * pair, x)
    put_quads(blocks, 12 * pair + 4, y)
    put_quads(blocks, 12 * pair + 8, z)


@kernel
def press(batch: int, cells: PointCells) -> None:
    """Compute means over the cells, and the pressures at their points, a_p theta + (a - a_p) mean(theta)."""
    points, means, weights, moduli = cells.buffers.points, cells.buffers.means, cells.weights, cells.moduli
    batches = len(cells.cells.nodes)
    count, own = len(weights) // batches, batch * (len(moduli) // batches)
    means[:] = 0.0
    for q in range(count):
        for lane in range(LANES):
            w = weights[count * batch + q, lane]
            means[3, lane] += w
            for k in range(3):
                means[k, lane] += w * points[POINT_ROWS * q + DILATATION + k, lane]
    for lane in range(LANES):
        for k in range(3):
            means[k, lane] /= means[3, lane]
    for q in range(count):
        for k in range(2):
            for lane in range(LANES):
                at_point, on_mean = moduli[own, lane], moduli[own + 1, lane]
                dilatation = points[POINT_ROWS * q + DILATATION + k, lane]
                points[POINT_ROWS * q + PRESSURE + k, lane] = at_point * dilatation + on_mean * means[k, lane]


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
def add_cells(batch: int, inputs: CellInputs, cells: PointCells, into: CellOutputs) -> None:
    """Compute forces and blocks of a batch from stress and tangent at its points."""
    nodes, gradients, weights, moduli = cells.cells.nodes, cells.cells.gradients, cells.weights, cells.moduli
    buffers = cells.buffers
    points, means, stress, scale = buffers.points, buffers.means, buffers.step_stress, inputs.scale
    batches, a, _ = nodes.shape
    count, own = len(weights) // batches, batch * (len(moduli) // batches)
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
        bulk[0, lane] = inputs.mean_share * moduli[own + 1, lane] * means[2, lane]
    for q in range(count):
        w = row(weights, weight + q)
        put_answer(points, POINT_ROWS * q, stress, 6 * q, w, w * row(bulk, 0), inputs.lag)
        for n in range(a):
            slope = place + n * pitch + 3 * q
            put_node(points, POINT_ROWS * q, triple_at(gradients, slope), w, n, volumes, pulls)
    for lane in range(LANES):
        bulk[0, lane] = scale * inputs.mean_share * moduli[own + 1, lane] / means[3, lane]
    pair = 0
    for m in range(a):
        for q in range(count):
            slope = place + m * pitch + 3 * q
            put_left(points, POINT_ROWS * q, scaled(scale, triple_at(gradients, slope)), left, LEFT_ROWS * q)
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


@kernel
def deformation_gradients(inputs: CellInputs, cells: PointCells, result: Array) -> None:
    """Write F at all points of all cells, shape (m, q, 3, 3)."""
    points, size = cells.buffers.points, cells.cells.size[0]
    for batch in range(len(cells.cells.nodes)):
        deform(batch, inputs, cells)
        first = batch * LANES
        for lane in range(min(LANES, size - first)):
            for q in range(result.shape[1]):
                for i in range(3):
                    for j in range(3):
                        f = points[POINT_ROWS * q + DEFORMATION + 3 * i + j, lane]
                        result[first + lane, q, i, j] = f


@kernel
def fill_given(
    inputs: CellInputs, cells: PointCells, stress: Array, tangent: Array, into: CellOutputs
) -> None:
    """Add forces and stiffness of all cells from given stress (m, q, 3, 3) and tangent (m, q, 9, 9)."""
    points, means, weights = cells.buffers.points, cells.buffers.means, cells.weights
    size, batches = cells.cells.size[0], len(cells.cells.nodes)
    count = len(weights) // batches
    for batch in range(batches):
        deform(batch, inputs, cells)
        means[:3] = 0.0
        means[3] = 1.0
        for lane in range(LANES):
            e = min(batch * LANES + lane, size - 1)
            for q in range(count):
                point, w = POINT_ROWS * q, weights[count * batch + q, lane]
                for one in range(9):
                    points[point + DILATATION_SLOPE + one, lane] = 0.0
                    points[point + STRESS + one, lane] = w * stress[e, q, one // 3, one % 3]
                    for other in range(one, 9):
                        points[point + TANGENT + UPPER[one, other], lane] = w * tangent[e, q, one, other]
        add_cells(batch, inputs, cells, into)


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


@part
def put_second_stress(points: Array, point: int, w: Any) -> None:
    """Write S = F^-1 P of a point over its stress w P, and det F over its pressure."""
    f, pulls = matrix_at(points, point + DEFORMATION), transposed(matrix_at(points, point + STRESS))
    cofactor = cofactors(f)
    volume, columns = dot(f[0], cofactor[0]), transposed(cofactor)
    share = 1.0 / (w * volume)
    put(points, point + PRESSURE, volume)
    for i in range(3):
        put_triple(points, point + STRESS + 3 * i, scaled(share, times(pulls, columns[i])))


@kernel
def remember(batch: int, cells: PointCells, memory: Memory) -> None:
    """Advance the memory of a batch with S, from the stress at its points without pressure."""
    points, weights, size = cells.buffers.points, cells.weights, cells.cells.size[0]
    stresses, fades, gains = memory.stresses, memory.fades, memory.gains
    count, terms = len(weights) // len(cells.cells.nodes), fades.shape[1]
    for q in range(count):
        point = POINT_ROWS * q
        put_second_stress(points, point, row(weights, count * batch + q))
        for lane in range(min(LANES, size - batch * LANES)):
            e = cells.memory[batch * LANES + lane]
            is_crushed = not points[point + PRESSURE, lane] > FLATTEST
            for i in range(3):
                for j in range(3):
                    before = stresses[e, q, terms, i, j]
                    one, other = point + STRESS + 3 * i + j, point + STRESS + 3 * j + i
                    now = before if is_crushed else 0.5 * (points[one, lane] + points[other, lane])
                    for t in range(terms):
                        past = fades[e, t] * stresses[e, q, t, i, j]
                        stresses[e, q, t, i, j] = past + gains[e, t] * (now - before)
                    stresses[e, q, terms, i, j] = now


@kernel
def finish_batch(
    batch: int, inputs: CellInputs, cells: PointCells, into: CellOutputs | None, memory: Memory | None
) -> None:
    """Add forces and stiffness of a batch, and advance its memory; None: leave that out."""
    if into is not None:
        add_cells(batch, inputs, cells, into)
    if memory is not None:
        remember(batch, cells, memory)
