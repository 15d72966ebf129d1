"""Arrays that the compiled kernels share, in a few named groups, and the places of cells' blocks in them.

b: reduced coordinates, c: actuators, e: elements of a kind, f: free nodes, j: joints, n: nodes,
s: supernodes, z: nodes in moving rigid regions.

Each cell has one block for each pair of its nodes, which are in elimination order. Blocks of free nodes are
added to the panels at once; blocks of moving regions are stored until the regions' Jacobians are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.actuation.compiled import CompiledKinds, compiler as actuation_compiler
from softsim_core.physics.kernels import Compiler
from softsim_core.physics.linalg import (
    Factor,
    Plan,
    Tree,
    add_block,
    compiler as linalg_compiler,
)
from softsim_core.physics.mechanics import no_rows

compiler = Compiler(Path(__file__).parent, uses=(linalg_compiler, actuation_compiler))
kernel = compiler.kernel


class CellPlaces(NamedTuple):
    """Places of the blocks of m cells with a nodes each: free nodes, then those of regions, then fixed ones.

    Attributes:
        starts: Panel place of the block of each pair of nodes, 00, 01, ... 11, ...; -1 where one is not free,
            shape (m, a (a + 1) / 2).
        strides: Panel width at each node, 0 where it is not free, shape (m, a).
        pair_blocks: Place in Pairs.blocks of each cell's first block, shape (m,); -1: no node is moved.
    """

    starts: IndexArray
    strides: IndexArray
    pair_blocks: IndexArray


class Elements(NamedTuple):
    """Elements in B batches of LANES; their nodes are sorted: free, then in moving regions, then fixed.

    Attributes:
        nodes: Node indices, shape (B, 4, LANES).
        corners: Nodes in mesh order (for the law `corotational_qr`), shape (B, 4, LANES).
        gradients: Shape gradients in [1/m], shape (B, 12, LANES).
        lame: Lame parameters times volume in [N m], shape (B, 2, LANES); zero in lanes without an element.
        places: Places of their blocks.
    """

    nodes: IndexArray
    corners: IndexArray
    gradients: Array
    lame: Array
    places: CellPlaces


class Pairs(NamedTuple):
    """Stiffness blocks of pairs of nodes with one in a moving region, and their places.

    The first node of a pair is eliminated no later than the second. Cells may have any number of nodes.

    Attributes:
        blocks: Blocks of all pairs of nodes of cells with a node there, in the unit of the matrix, (p, 3, 3).
        beside: A free node and one in a moving region: block, place of the first panel row, panel width,
            supernode, number of the region node, shape (., 5).
        regions: Two nodes in moving rigid regions: block and their numbers, shape (., 3).
    """

    blocks: Array
    beside: IndexArray
    regions: IndexArray


class Cells(NamedTuple):
    """All deforming cells: those with kernels of their own, by law, and pairs of nodes of the others.

    Attributes:
        polar: Law `corotational`.
        frames: Law `corotational_qr`.
        pairs: Stored blocks of cells with a node in a moving region.
    """

    polar: Elements
    frames: Elements
    pairs: Pairs


class Nodes(NamedTuple):
    """Free nodes and nodes in moving rigid regions.

    Attributes:
        free: Node index, shape (f,).
        row: Place of the node's first panel row, shape (f,).
        stride: Panel width, shape (f,).
        column: The node's first column in its panel, shape (f,).
        right: Column of the right-hand side in its panel, shape (f,).
        unknown: The node's first scalar unknown, shape (f,).
        region: Node index, shape (z,).
        region_of: RigidRegion of the node, shape (z,).
        local: Position in the region's frame in [m], shape (z, 3).
        reduced: Reduced coordinates that move the node, at most w, shape (z, w).
        size: Number of these coordinates, shape (z,).
        region_number: Number among the region nodes of each node, or -1, shape (n,).
        reduced_column: Panel column of each reduced coordinate, then actuator, in each supernode, or -1,
            shape (s, b + c).
        first_unknown: First scalar unknown of each node, or -1 where it is not free, shape (n,).
        supernode: Supernode of each node, or -1, shape (n,).
        mass: Node masses in [kg], shape (n,).
        diagonal: Contribution of inertia and soft fixings to the matrix, in [kg], shape (n,).
    """

    free: IndexArray
    row: IndexArray
    stride: IndexArray
    column: IndexArray
    right: IndexArray
    unknown: IndexArray
    region: IndexArray
    region_of: IndexArray
    local: Array
    reduced: IndexArray
    size: IndexArray
    region_number: IndexArray
    reduced_column: IndexArray
    first_unknown: IndexArray
    supernode: IndexArray
    mass: Array
    diagonal: Array


class Kinematics(NamedTuple):
    """Joints and regions.

    Attributes:
        base_rotation: Joint base, shape (j, 3, 3).
        axis: Joint axis in the base frame, shape (j, 3).
        slide: Slide axis in the base frame, shape (j, 3).
        revolute: Whether the joint is revolute (else prismatic), shape (j,).
        stiffness: Drive stiffness in [N m/rad] or [N/m], 0 for a prescribed joint, shape (j,).
        inertia: Drive inertia in [kg m^2] or [kg], shape (j,).
        parent: Joint that carries the base, or -1, shape (j,).
        rest: Position at the start in [rad] or [m], shape (j,).
        rest_rotation: Rotation of the frame that the joint moves at `rest`, its parent at rest, (j, 3, 3).
        regions: Free frame and joint of each region, -1 for none, shape (regions, 2).
    """

    base_rotation: Array
    axis: Array
    slide: Array
    revolute: BoolArray
    stiffness: Array
    inertia: Array
    parent: IndexArray
    rest: Array
    rest_rotation: Array
    regions: IndexArray


class ActuatorRows(NamedTuple):
    """Constraint rows of the actuators; kinds with compiled kernels come first.

    Attributes:
        joint, start, place: See actuation.actuators.Constraints.
        command, compliance: q and c of this step, shapes (c,).
        compiled: Number of rows that compiled kernels evaluate, shape (1,).
        coefficient: Entries of the rows, shape (k, 3).
        value: Coordinates s, shape (c,).
        before: Coordinates at the start of the step, shape (c,).
        violation: s - q + c t at the end of the step, shape (c,).
        multiplier: Multipliers t, shape (c,).
        response: Change of the coordinates within a step per multiplier, shape (c, c).
    """

    joint: IndexArray
    start: IndexArray
    place: IndexArray
    command: Array
    compliance: Array
    compiled: IndexArray
    coefficient: Array
    value: Array
    before: Array
    violation: Array
    multiplier: Array
    response: Array


class ActuatorStiffness(NamedTuple):
    """Stiffness of taut actuators, R^T diag(w) R; see actuation.actuators.GeometricStiffness.

    Attributes:
        start, place, coefficient: R, see mechanics.rows.Rows.
        weight: w, in the unit of the matrix; only those above 0 count.
    """

    start: IndexArray
    place: IndexArray
    coefficient: Array
    weight: Array


NO_STIFFNESS = ActuatorStiffness(*no_rows(), np.zeros(0))


class Acting(NamedTuple):
    """Actuators of a step; it is None in a step without any, which is compiled without them.

    Attributes:
        rows, stiffness: See ActuatorRows and ActuatorStiffness.
        kinds: Actuators that have compiled kernels.
    """

    rows: ActuatorRows
    kinds: CompiledKinds
    stiffness: ActuatorStiffness


class Motion(NamedTuple):
    """The state's arrays, as the kernels change them; see mechanics.state.State."""

    positions: Array
    velocities: Array
    frame_positions: Array
    frame_rotations: Array
    reduced_velocities: Array
    joint_positions: Array
    joint_efforts: Array
    base_positions: Array
    base_shift: Array


class Work(NamedTuple):
    """Results and buffers of the kernels.

    Attributes:
        factor: Matrix and right-hand side; the dense unknowns are the reduced coordinates, then the actuators
            (minus their impulses), d = b + c; the solution is the change of velocity.
        scratch: Shape of `factor.schur`.
        forces: Forces on the nodes in [N], shape (n, 4); the fourth number stays zero.
        ahead: x + lag v in [m], shape (n, 3).
        jacobian: Velocity of each region node per unit of each of its reduced coordinates, (z, w, 3).
        angular, linear, origin: Motion subspace of the reduced coordinates, shape (b, 3) each.
        base_origins, base_rotations: Frames of the joints' bases, shapes (j, 3), (j, 3, 3).
        joint_origins, joint_rotations: Frames that the joints move, shapes (j, 3), (j, 3, 3).
        region_origins, region_rotations: Frames of the regions, shapes (regions, 3), (regions, 3, 3).
        deformation, rotations: Deformation gradients and rotations of one batch, shapes (9, LANES).
        turned: Rotated shape gradients of one batch, three rows per node, shape (12, LANES).
        blocks: Stiffness of one batch in [N/m], row i of block ab in row 3 (ab) + i: pairs of nodes a <= b
            run 00, 01, ... 33; shape (30, LANES, 4), the fourth number zero.
    """

    factor: Factor
    scratch: Array
    forces: Array
    ahead: Array
    jacobian: Array
    angular: Array
    linear: Array
    origin: Array
    base_origins: Array
    base_rotations: Array
    joint_origins: Array
    joint_rotations: Array
    region_origins: Array
    region_rotations: Array
    deformation: Array
    rotations: Array
    turned: Array
    blocks: Array


class StepArrays(NamedTuple):
    """Arrays that stay in place from step to step, beside those of cells and actuators.

    Attributes:
        kinematics, nodes, work: See there.
        tree: Tree of the factor.
    """

    kinematics: Kinematics
    nodes: Nodes
    tree: Tree
    work: Work


class StepInputs(NamedTuple):
    """Inputs of a step.

    Attributes:
        motion: The state; the step changes it.
        straining: Velocities in [m/s] that damp strain, shape (n, 3).
        external: Forces on the nodes in [N] but those of linear tetrahedra and masses, shape (n, 3).
        targets: Targets of the joints, shape (j,).
        base_shift: Shift of the joints' bases in [m].
        lower, upper: Bounds of the actuators' multipliers, shape (c,).
        h: Time step in [s].
        lag: Time lag of the elastic forces in [s].
        rayleigh_mass: Damping of masses in [1/s].
    """

    motion: Motion
    straining: Array
    external: Array
    targets: Array
    base_shift: float
    lower: Array
    upper: Array
    h: float
    lag: float
    rayleigh_mass: float


@kernel
def add_blocks(
    blocks: Array, place: int, pitch: int, e: int, places: CellPlaces, panels: Array, pair_blocks: Array
) -> None:
    """Add the blocks of cell e to the panels; write them to `pair_blocks` if a node is in a moving region.

    Rows of the blocks are four numbers, the fourth zero. The first row starts at number `place` of `blocks`,
    each further one `pitch` numbers later.
    """
    strides, starts = places.strides, places.starts
    a = strides.shape[1]
    for n in range(a):
        if strides[e, n] == 0:
            break
        pair = n
        for m in range(n + 1):  # column by column, so that no row is loaded right after it was stored
            add_block(panels, starts[e, pair], strides[e, m], blocks, place + 3 * pair * pitch, pitch)
            pair += a - m - 1
    first = places.pair_blocks[e]
    if first >= 0:
        numbers = blocks.reshape(-1)
        for k in range(starts.shape[1]):
            for i in range(3):
                row = place + (3 * k + i) * pitch
                for j in range(3):
                    pair_blocks[first + k, i, j] = numbers[row + j]


@kernel
def add_all_blocks(blocks: Array, places: CellPlaces, panels: Array, pair_blocks: Array) -> None:
    """Add the blocks (m, a (a + 1) / 2, 3, 4) of all cells; the fourth number of a row is zero."""
    for e in range(len(blocks)):
        add_blocks(blocks, e * blocks.shape[1] * 12, 4, e, places, panels, pair_blocks)


@kernel
def scatter(pairs: Pairs, nodes: Nodes, work: Work) -> None:
    """Add the stored blocks of moving regions to panels and reduced coordinates.

    Work.jacobian must be set.
    """
    panels, schur, jacobian, blocks = work.factor.panels, work.factor.schur, work.jacobian, pairs.blocks
    for p in range(len(pairs.beside)):
        block, place, width = pairs.beside[p, 0], pairs.beside[p, 1], pairs.beside[p, 2]
        supernode, z = pairs.beside[p, 3], pairs.beside[p, 4]
        for q in range(nodes.size[z]):
            at = place + nodes.reduced_column[supernode, nodes.reduced[z, q]]
            for i in range(3):
                total = 0.0
                for j in range(3):
                    total += blocks[block, i, j] * jacobian[z, q, j]
                panels[at + i * width] += total
    for p in range(len(pairs.regions)):
        block, a, b = pairs.regions[p, 0], pairs.regions[p, 1], pairs.regions[p, 2]
        for q in range(nodes.size[b]):
            k = nodes.reduced[b, q]
            j0, j1, j2 = jacobian[b, q, 0], jacobian[b, q, 1], jacobian[b, q, 2]
            c0 = blocks[block, 0, 0] * j0 + blocks[block, 0, 1] * j1 + blocks[block, 0, 2] * j2
            c1 = blocks[block, 1, 0] * j0 + blocks[block, 1, 1] * j1 + blocks[block, 1, 2] * j2
            c2 = blocks[block, 2, 0] * j0 + blocks[block, 2, 1] * j1 + blocks[block, 2, 2] * j2
            for r in range(nodes.size[a]):
                m = nodes.reduced[a, r]
                if a == b and m > k:
                    continue
                total = jacobian[a, r, 0] * c0 + jacobian[a, r, 1] * c1 + jacobian[a, r, 2] * c2
                if a != b and m == k:  # the transposed block contributes, too
                    total *= 2.0
                schur[min(m, k), max(m, k)] += total


def node_pairs(cells: IndexArray) -> IndexArray:
    """Return all ordered pairs of nodes of each cell (m, a), cell by cell, shape (m a a, 2)."""
    count = cells.shape[1]
    first, second = np.repeat(cells, count, axis=1), np.tile(cells, (1, count))
    return np.stack([first.ravel(), second.ravel()], axis=1)


def elimination_order(
    cells: IndexArray, nodes: Nodes, local: IndexArray, layout: Plan
) -> tuple[IndexArray, IndexArray]:
    """Return the elimination order (m,) of cells (m, a), and the order of the nodes in each, shape (m, a)."""
    count = len(layout.position)
    places = np.append(layout.position, count)[local]  # local is -1 if a node is not free
    rank = (places + ((local < 0) & (nodes.region_number < 0)))[cells]
    order = np.argsort(rank.min(axis=1, initial=count), kind="stable")
    return order, np.argsort(rank[order], axis=1, kind="stable")


def cell_places(
    kinds: Sequence[IndexArray], nodes: Nodes, local: IndexArray, layout: Plan
) -> tuple[list[CellPlaces], Pairs]:
    """Return the places of the blocks of kinds of cells (m, a) in elimination order, and the stored pairs."""
    result, beside, regions = [], [np.zeros((0, 5), np.int64)], [np.zeros((0, 3), np.int64)]
    height = 0
    for cells in kinds:
        first, second = np.triu_indices(cells.shape[1])
        free, region = local[cells], nodes.region_number[cells]
        supernode = np.where(free >= 0, np.append(layout.supernode, 0)[free], 0)
        offset, width = np.append(layout.row_offset, 0)[free], np.append(layout.width, 0)[supernode]
        both = np.nonzero((free[:, first] >= 0) & (free[:, second] >= 0))
        one, other = (both[0], first[both[1]]), (both[0], second[both[1]])
        starts = np.full((len(cells), len(first)), -1, np.int64)
        starts[both] = offset[one] + layout.panel_columns(supernode[one], 3 * layout.position[free[other]])
        touching = (region >= 0).any(axis=1)
        pair_blocks = np.where(touching, height + len(first) * (np.cumsum(touching) - 1), -1)
        height += len(first) * int(touching.sum())
        result.append(CellPlaces(starts, np.where(free >= 0, width, 0), pair_blocks))
        cell, pair = np.nonzero(region[:, second] >= 0)
        block, one, z = pair_blocks[cell] + pair, (cell, first[pair]), region[cell, second[pair]]
        mixed, inside = free[one] >= 0, region[one] >= 0
        rows = np.stack([block, offset[one], width[one], supernode[one], z], axis=1)
        beside.append(rows[mixed])
        regions.append(np.stack([block, region[one], z], axis=1)[inside])
    pairs = Pairs(np.zeros((height, 3, 3)), np.concatenate(beside), np.concatenate(regions))
    return result, pairs
