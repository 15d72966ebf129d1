"""Forces and sparse matrices of a model on its unknowns: three per free node, then frames and joints."""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array, IndexArray
from softsim_core.physics.actuation import drive_stiffness
from softsim_core.physics.fem import (
    BlockPattern,
    LinearMove,
    elastic_forces,
    step_stress_stiffness,
    stiffness_matrix,
)
from softsim_core.physics.fem.materials import DAMPING
from softsim_core.physics.fem.rods import RodGroup, rod_drag, rod_viscosity
from softsim_core.physics.mechanics import (
    Model,
    MotionSubspace,
    Parameters,
    RigidRegion,
    State,
    step_stress_name,
)


class Unknowns:
    """Places of a model's unknowns in the vector of all of them.

    Attributes:
        free: Indices of the free nodes, ascending, shape (k,); their unknowns come first, shape (3 k,).
        first_reduced: Number of unknowns of free nodes; reduced coordinate b is at `first_reduced + b`.
        size: Number of unknowns.
        joints: Places of the joints, shape (j,).
        compliant, prescribed: Indices of the joints with and without a spring drive.
        fixed: Places of the prescribed joints.
        solved: Places of all other unknowns.
        drive: Stiffness of each joint's drive in [N m/rad] or [N/m], 0 where prescribed, shape (j,).
    """

    def __init__(self, model: Model) -> None:
        count = len(model.joints)
        self.free: IndexArray = model.free_nodes
        self.first_reduced = 3 * len(self.free)
        self.size = self.first_reduced + model.reduced_size
        self.joints: IndexArray = np.arange(self.size - count, self.size)
        self.compliant: IndexArray = model.compliant_joints
        self.prescribed: IndexArray = np.setdiff1d(np.arange(count), self.compliant)
        self.fixed: IndexArray = self.joints[self.prescribed]
        self.solved: IndexArray = np.setdiff1d(np.arange(self.size), self.fixed)
        self.drive: Array = drive_stiffness(model)


def jacobian(model: Model, unknowns: Unknowns, state: State) -> sp.csr_matrix:
    """Return the map from the velocities of all unknowns to node velocities, sparse, shape (3 n, d)."""
    free = unknowns.free
    rows = [(3 * free[:, None] + np.arange(3)).ravel()]
    columns = [np.arange(3 * len(free))]
    values = [np.ones(3 * len(free))]
    motion_subspace = model.motion_subspace(state)
    for region in model.regions:
        shape = (len(region.nodes), len(region.reduced), 3)
        rows.append(np.broadcast_to(3 * region.nodes[:, None, None] + np.arange(3), shape).ravel())
        columns.append(np.broadcast_to(unknowns.first_reduced + region.reduced[:, None], shape).ravel())
        values.append(motion_subspace.jacobians(region.reduced, state.positions[region.nodes]).ravel())
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sp.csr_matrix(entries, shape=(3 * len(model.rest), unknowns.size))


def generalised_forces(model: Model, unknowns: Unknowns, state: State, forces: Array) -> Array:
    """Return forces on nodes (n, 3) in [N] as forces on all unknowns, shape (d,): J^T f without forming J."""
    generalised = np.zeros(unknowns.size)
    generalised[: unknowns.first_reduced] = forces[unknowns.free].ravel()
    motion_subspace = model.motion_subspace(state)
    for region in model.regions:
        generalised[unknowns.first_reduced + region.reduced] += motion_subspace.work(
            region.reduced, state.positions[region.nodes], forces[region.nodes]
        )
    return generalised


def static_forces(model: Model, state: State, parameters: Parameters, external: Array) -> Array:
    """Return all static forces on nodes in [N], shape (n, 3).

    These are elastic forces, weight, soft fixings and `external` (n, 3).
    """
    forces = external + model.weight
    forces += elastic_forces(model.groups, state.positions, parameters.materials)
    return np.asarray(forces - model.spring[:, None] * (state.positions - model.rest))


def node_stiffness(
    model: Model,
    state: State,
    parameters: Parameters,
    positive: bool = False,
    distant: bool = False,
    last: LinearMove | None = None,
    mean_share: float = 1.0,
    pattern: BlockPattern | None = None,
) -> sp.csr_matrix:
    """Return the stiffness of cells and soft fixings in [N/m], sparse, shape (3 n, 3 n).

    It is the exact derivative -df/dx; or `positive` semidefinite for a time step, see
    Material.positive_tangent; or `distant`, for statics far from an equilibrium. For `last` and `mean_share`
    see fem.cells.cell_stiffness; for `pattern` see stiffness_matrix.
    """
    cells = stiffness_matrix(
        model.groups, state.positions, parameters.materials, positive, distant, last, mean_share, pattern
    )
    return cells + diagonal_matrix(np.repeat(model.spring, 3))


def diagonal_matrix(values: Array) -> sp.csr_matrix:
    """Return values (k,) on a sparse diagonal (k, k), three times as fast as `scipy.sparse.diags`."""
    size = len(values)
    return sp.csr_matrix((values, np.arange(size), np.arange(size + 1)), shape=(size, size))


def viscosity_matrix(model: Model, state: State, parameters: Parameters) -> sp.csr_matrix | None:
    """Return the damping of the rods' laws in [N s/m], sparse, shape (3 n, 3 n); None: there is none."""
    damped = _damped_rods(model, parameters)
    if not damped:
        return None
    blocks = [rod_viscosity(group, state.positions, p) for group, p in damped]
    return BlockPattern(len(model.rest), [group.cells for group, _ in damped]).matrix(blocks)


def viscous_forces(
    model: Model, before: Array, positions: Array, parameters: Parameters, dt: float
) -> Array | None:
    """Return the damping forces of the rods' laws on nodes that were at `before` in [N], (n, 3).

    None: none.
    """
    damped = _damped_rods(model, parameters)
    if not damped:
        return None
    forces = np.zeros_like(positions)
    for group, p in damped:
        np.add.at(forces, group.cells, rod_drag(group, before, positions, p, dt))
    return forces


def _damped_rods(model: Model, parameters: Parameters) -> list[tuple[RodGroup, Array]]:
    """Return the groups of rods whose law has damping, with their parameter values."""
    if not any(each.get(DAMPING.name) for each in parameters.materials):
        return []
    rods = [group for group in model.groups if isinstance(group, RodGroup)]
    return [(group, group.values(parameters.materials)) for group in rods]


def step_stress_matrix(model: Model, state: State) -> sp.csr_matrix | None:
    """Return the stiffness of relaxing cells' known stress in a step in [N/m], (3 n, 3 n).

    None: there is none.

    See fem.prony.
    """
    stiffnesses = [
        (group, step_stress_stiffness(group, state.extra[step_stress_name(k)]))
        for k, group in enumerate(model.groups)
        if step_stress_name(k) in state.extra
    ]
    if not stiffnesses:
        return None
    size = len(model.rest)
    matrix = sp.csr_matrix((size, size))
    for group, stiffness in stiffnesses:
        nodes = np.broadcast_to(group.cells[:, :, None], stiffness.shape)
        places = (nodes.ravel(), np.swapaxes(nodes, 1, 2).ravel())
        matrix = matrix + sp.coo_matrix((stiffness.ravel(), places), shape=matrix.shape)
    return sp.kron(matrix, sp.eye(3), format="csr")


def static_tangent(
    model: Model, at: Unknowns, state: State, forces: Array, stiffness: sp.csr_matrix, mapping: sp.csr_matrix
) -> sp.csr_matrix:
    """Return J^T K J - (dJ^T/dq) f + drive springs on all unknowns, sparse, shape (d, d).

    Args:
        model: The model.
        at: Its unknowns.
        state: State at which the tangent is taken.
        forces: Forces on the nodes there in [N], see `static_forces`.
        stiffness: See `node_stiffness`.
        mapping: J there, see `jacobian`.
    """
    motion_subspace = model.motion_subspace(state)
    reduced = np.zeros((model.reduced_size, model.reduced_size))
    for region in model.regions:
        reduced[np.ix_(region.reduced, region.reduced)] -= turned_work(
            motion_subspace, region, state.positions[region.nodes], forces[region.nodes]
        )
    reduced[range(-len(at.drive), 0), range(-len(at.drive), 0)] += at.drive
    rows, columns = np.indices(reduced.shape).reshape(2, -1) + at.first_reduced
    turning = sp.csr_matrix((reduced.ravel(), (rows, columns)), shape=(at.size, at.size))
    return (mapping.T @ stiffness @ mapping + turning).tocsr()


def turned_work(motion: MotionSubspace, region: RigidRegion, points: Array, forces: Array) -> Array:
    """Return the second derivative of the work of forces (k, 3) on a region's nodes at points (k, 3).

    It is taken by the reduced coordinates that move the region. Of two joints, the outer one rotates the
    motion that the inner one gives the nodes: f . (w_a x u_b). The six coordinates of a frame rotate at once,
    so the mean of both orders counts; translations contribute nothing.
    """
    moved = motion.jacobians(region.reduced, points)
    product = np.einsum("kbi,kj->bij", moved, forces)
    torque = np.stack([product[:, i - 2, i - 1] - product[:, i - 1, i - 2] for i in range(3)], axis=1)
    work = motion.angular[region.reduced] @ torque.T
    if region.frame >= 0:
        turning = motion.angular[region.reduced].any(axis=1)
        return np.asarray(0.5 * (work + work.T) * np.outer(turning, turning))
    return np.asarray(np.triu(work) + np.triu(work, 1).T)


def top_speed(model: Model, state: State) -> float:
    """Return the largest component of all linear velocities in [m/s].

    NaN if any velocity is NaN or infinite.
    """
    if not np.isfinite(state.reduced_velocities).all():
        return math.nan
    slides = [True, True, True, False, False, False] * len(model.frame_names)
    slides += [not joint.revolute for joint in model.joints]
    speeds = np.concatenate([state.velocities[model.free_nodes].ravel(), state.reduced_velocities[slides]])
    return float(np.abs(speeds).max(initial=0.0))  # max propagates NaN
