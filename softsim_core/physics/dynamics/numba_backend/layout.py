"""Arrays that the compiled kernels share, in a few named groups.

b: reduced coordinates, c: actuators, e: elements of a kind, f: free nodes, j: joints, n: nodes,
s: supernodes, z: nodes in moving rigid regions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.actuation.compiled import CompiledKinds
from softsim_core.physics.linalg import Factor, Tree
from softsim_core.physics.mechanics import no_rows


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
        compliance: c of this step, shape (c,).
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
