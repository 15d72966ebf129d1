"""The arrays that the compiled kernels share, in a few named groups.

b: border unknowns, c: cables, e: elements of a kind, f: free nodes, j: joints, n: nodes, s: supernodes,
z: nodes in moving zones.
"""

from __future__ import annotations

from typing import NamedTuple

from softsim_core.arrays import Array, BoolArray, IndexArray


class Elements(NamedTuple):
    """Elements, LANES to a batch (B batches); their nodes: free ones, then in moving zones, then held.

    Attributes:
        nodes: Node indices, shape (B, 4, LANES).
        corners: The first three nodes in mesh order and the fourth (law `qr`), shape (B, 4, LANES).
        gradients: Shape gradients in [1/m], shape (B, 12, LANES).
        lame: Lame parameters times volume in [N m], shape (B, 2, LANES); zero in lanes without an element.
        starts: Panel places of the ten blocks of free nodes, first panel place of each free node (from 10)
            and its supernode (from 14), shape (e, 18).
        strides: Panel width at each free node, shape (e, 4).
        counts: Free nodes, and nodes in moving zones, shape (e, 2).
    """

    nodes: IndexArray
    corners: IndexArray
    gradients: Array
    lame: Array
    starts: IndexArray
    strides: IndexArray
    counts: IndexArray


class Nodes(NamedTuple):
    """Free nodes and nodes in moving zones.

    Attributes:
        free: Node index, shape (f,).
        row: Place of the node's first panel row, shape (f,).
        stride: Panel width, shape (f,).
        column: The node's first column in its panel, shape (f,).
        right: Column of the right-hand side in its panel, shape (f,).
        unknown: The node's first scalar unknown, shape (f,).
        zone: Node index, shape (z,).
        zone_of: Zone of the node, shape (z,).
        local: Position in the zone's frame in [m], shape (z, 3).
        border: Border unknowns that move the node, shape (z, 6).
        size: How many of them count, shape (z,).
        zone_number: Number among the zone nodes of each node, or -1, shape (n,).
        border_column: Panel column of each border unknown, then cable, in each supernode, or -1, (s, b + c).
        first_unknown: First scalar unknown of each node, or -1 where it is not free, shape (n,).
        supernode: Supernode of each node, or -1, shape (n,).
        mass: Node masses in [kg], shape (n,).
        diagonal: What inertia and soft fixings add to the matrix, in [kg], shape (n,).
    """

    free: IndexArray
    row: IndexArray
    stride: IndexArray
    column: IndexArray
    right: IndexArray
    unknown: IndexArray
    zone: IndexArray
    zone_of: IndexArray
    local: Array
    border: IndexArray
    size: IndexArray
    zone_number: IndexArray
    border_column: IndexArray
    first_unknown: IndexArray
    supernode: IndexArray
    mass: Array
    diagonal: Array


class Border(NamedTuple):
    """Joints and zones.

    Attributes:
        base_position: Joint base in [m], shape (j, 3).
        base_rotation: Joint base, shape (j, 3, 3).
        axis: Joint axis in the base frame, shape (j, 3).
        slide: Slide axis in the base frame, shape (j, 3).
        revolute: Whether the joint turns (else it slides), shape (j,).
        stiffness: Drive stiffness in [N m/rad] or [N/m], 0 for a prescribed joint, shape (j,).
        inertia: Drive inertia in [kg m^2] or [kg], shape (j,).
        parent: Joint that carries the base, or -1, shape (j,).
        rest: Position at the start in [rad] or [m], shape (j,).
        zones: Free frame and joint of each zone, -1 for none, shape (zones, 2).
    """

    base_position: Array
    base_rotation: Array
    axis: Array
    slide: Array
    revolute: BoolArray
    stiffness: Array
    inertia: Array
    parent: IndexArray
    rest: Array
    zones: IndexArray


class Lines(NamedTuple):
    """Cables; what never changes of their rows is that of actuation.cable_layout.RowLayout.

    Attributes:
        first: Where each cable's points begin; the last one ends them, shape (c + 1,).
        nodes, weights: Nodes that carry each point, and their weights, shapes (p, 4).
        carrier: Joint that carries each point, or fast.cables.IN_WORLD or IN_BODY, shape (p,).
        local: Where in the carrier's frame in [m], shape (p, 3).
        entry: First of the four entries of each point, shape (p,).
        start, place, levers, lever_points, lever_unknowns: See RowLayout.
        joint: The joint that pulls each cable, shape (c,).
        rest_length: In [m], shape (c,).
        by_force: Whether the joint's command is a tension, shape (c,).
        coefficient: Entries of the rows, shape (k, 3).
        points, pulls: In [m], and H on them, shape (p, 3).
        travel, gap: Shortening since the start, and beyond the commanded one, in [m], shape (c,).
        tension: In [N], shape (c,).
        compliance: In [m/N], shape (c, c).
    """

    first: IndexArray
    nodes: IndexArray
    weights: Array
    carrier: IndexArray
    local: Array
    entry: IndexArray
    start: IndexArray
    place: IndexArray
    levers: IndexArray
    lever_points: IndexArray
    lever_unknowns: IndexArray
    joint: IndexArray
    rest_length: Array
    by_force: BoolArray
    coefficient: Array
    points: Array
    pulls: Array
    travel: Array
    gap: Array
    tension: Array
    compliance: Array


class Motion(NamedTuple):
    """The state's arrays, as the kernels change them; see mechanics.state.State."""

    positions: Array
    velocities: Array
    frame_positions: Array
    frame_rotations: Array
    border_velocities: Array
    joint_positions: Array
    joint_efforts: Array
    base_shift: Array


class Tree(NamedTuple):
    """The plan of symbolic.Plan; first scalar unknown of each supernode, and the one above it or -1, (s,)."""

    columns: IndexArray
    later: IndexArray
    side: IndexArray
    width: IndexArray
    panel: IndexArray
    update: IndexArray
    first_child: IndexArray
    children: IndexArray
    first_run: IndexArray
    runs: IndexArray
    first_row: IndexArray
    row_index: IndexArray
    first_column: IndexArray
    parent: IndexArray


class Work(NamedTuple):
    """What the kernels compute.

    Attributes:
        panels, stack: Factor panels, and update matrices not yet used.
        schur: Upper triangle of the border's matrix, cables last, then its right-hand side,
            shape (b + c, b + c + 1).
        scratch: Shape of `schur`.
        solution: Change of velocity of all scalar unknowns, then the border's, then minus the impulses of
            cables, shape (3 f + b + c,).
        gathered: One panel row's unknowns.
        forces: Forces on the nodes in [N], shape (n, 3).
        ahead: x + lag v in [m], shape (n, 3).
        jacobian: Velocity of each zone node a unit of each of its border unknowns, shape (z, 6, 3).
        angular, linear, origin: Screws of the border unknowns, shape (b, 3) each.
        zone_origins, zone_rotations: Frames of the zones, shapes (zones, 3), (zones, 3, 3).
        deformation, rotations: Of one batch, shapes (9, LANES), (10, LANES).
        rotated: Rotated gradients of one batch, shape (4 LANES, 4), the fourth column zero.
        turns: How the forces of one element turn with its nodes, shape (12, 4).
        one, two: Shape (3, 3).
    """

    panels: Array
    stack: Array
    schur: Array
    scratch: Array
    solution: Array
    gathered: Array
    forces: Array
    ahead: Array
    jacobian: Array
    angular: Array
    linear: Array
    origin: Array
    zone_origins: Array
    zone_rotations: Array
    deformation: Array
    rotations: Array
    rotated: Array
    turns: Array
    one: Array
    two: Array
