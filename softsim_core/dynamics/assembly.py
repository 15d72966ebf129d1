"""Forces and sparse matrices of a model on its unknowns: three a free node, then frames and joints."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.stepper import joint_stiffness
from softsim_core.fem.corotational import (
    element_rotations,
    exact_tangent_blocks,
    stiffness_blocks,
    stresses,
)
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State


class Unknowns:
    """Where each unknown of a model stands in a vector of all of them.

    Attributes:
        free: Indices of the free nodes, ascending, shape (k,); their unknowns come first, shape (3 k,).
        first_border: Number of unknowns of free nodes; border unknown b stands at `first_border + b`.
        size: Number of unknowns.
        joints: Places of the joints, shape (j,).
        compliant, prescribed: Indices of the joints with and without a spring drive.
        fixed: Places of the prescribed joints.
        solved: Places of all others.
        drive: Stiffness of each joint's drive in [N m/rad] or [N/m], 0 where prescribed, shape (j,).
    """

    def __init__(self, model: Model) -> None:
        count = len(model.joints)
        self.free: IndexArray = model.free_nodes
        self.first_border = 3 * len(self.free)
        self.size = self.first_border + model.border_size
        self.joints: IndexArray = np.arange(self.size - count, self.size)
        self.compliant: IndexArray = model.compliant_joints
        self.prescribed: IndexArray = np.setdiff1d(np.arange(count), self.compliant)
        self.fixed: IndexArray = self.joints[self.prescribed]
        self.solved: IndexArray = np.setdiff1d(np.arange(self.size), self.fixed)
        self.drive: Array = joint_stiffness(model)


def rotated_gradients(model: Model, positions: Array) -> Array:
    """Shape gradients turned with each element at node `positions` (n, 3), in [1/m], shape (m, 4, 3)."""
    gradients = model.elements.gradients
    rotations = element_rotations(positions[model.elements.nodes], gradients, model.law)
    return np.asarray(gradients @ np.swapaxes(rotations, 1, 2))


def elastic_forces(model: Model, positions: Array, rotated: Array, lame: Array) -> Array:
    """Forces of the elements on the nodes in [N], shape (n, 3).

    Args:
        model: The model.
        positions: Node positions in [m] at which the strain is taken, shape (n, 3).
        rotated: Rotated gradients, see `rotated_gradients`.
        lame: Lame parameters of each body in [Pa], shape (bodies, 2).
    """
    tets, volumes = model.elements.nodes, model.elements.volumes
    stress = stresses(positions[tets], rotated, lame[model.element_body])
    forces = np.zeros_like(positions)
    np.add.at(forces, tets, -volumes[:, None, None] * np.einsum("mij,maj->mai", stress, rotated))
    return forces


def sparse_of_blocks(model: Model, blocks: Array) -> sp.csr_matrix:
    """Sum of element matrices (m, 4, 4, 3, 3) over all nodes, sparse, shape (3 n, 3 n)."""
    dofs = 3 * model.elements.nodes[:, :, None] + np.arange(3)
    rows = np.broadcast_to(dofs[:, :, None, :, None], blocks.shape)
    columns = np.broadcast_to(dofs[:, None, :, None, :], blocks.shape)
    size = 3 * len(model.rest)
    return sp.coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)).tocsr()


def jacobian(model: Model, unknowns: Unknowns, state: State) -> sp.csr_matrix:
    """Node velocities from the velocities of all unknowns, sparse, shape (3 n, d)."""
    free = unknowns.free
    rows = [(3 * free[:, None] + np.arange(3)).ravel()]
    columns = [np.arange(3 * len(free))]
    values = [np.ones(3 * len(free))]
    screws = model.screws(state)
    for zone in model.zones:
        for k in zone.border:
            rows.append((3 * zone.nodes[:, None] + np.arange(3)).ravel())
            columns.append(np.full(3 * len(zone.nodes), unknowns.first_border + k))
            values.append(screws.jacobian(int(k), state.positions[zone.nodes]).ravel())
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sp.csr_matrix(entries, shape=(3 * len(model.rest), unknowns.size))


def static_forces(model: Model, state: State, lame: Array, external: Array) -> Array:
    """All forces on nodes at rest in [N], shape (n, 3): elastic, weight, soft fixings, external (n, 3)."""
    rotated = rotated_gradients(model, state.positions)
    forces = external + model.mass[:, None] * model.gravity
    forces += elastic_forces(model, state.positions, rotated, lame)
    return np.asarray(forces - model.spring[:, None] * (state.positions - model.rest))


def node_stiffness(model: Model, state: State, lame: Array, warped: bool = False) -> sp.csr_matrix:
    """Tangent -df/dx on the nodes, shape (3 n, 3 n): exact, or `warped` with frozen element rotations."""
    volumes, moduli = model.elements.volumes, lame[model.element_body]
    if warped:
        blocks = stiffness_blocks(rotated_gradients(model, state.positions), volumes, moduli)
    else:
        corners = state.positions[model.elements.nodes]
        blocks = exact_tangent_blocks(corners, model.elements.gradients, volumes, moduli, model.law)
    return sparse_of_blocks(model, blocks) + sp.diags(np.repeat(model.spring, 3))


def static_tangent(
    model: Model, at: Unknowns, state: State, forces: Array, stiffness: sp.csr_matrix
) -> sp.csr_matrix:
    """J^T K J - (dJ^T/dq) f + drive springs on all unknowns, sparse, shape (d, d).

    Args:
        model: The model.
        at: Its unknowns.
        state: Where the tangent is taken.
        forces: Forces on the nodes there in [N], see `static_forces`.
        stiffness: See `node_stiffness`.
    """
    mapping, screws = jacobian(model, at, state), model.screws(state)
    border = np.zeros((model.border_size, model.border_size))
    for zone in model.zones:
        lever = state.positions[zone.nodes] - screws.origin[zone.border[-1]]
        product = lever.T @ forces[zone.nodes]
        turned = 0.5 * (product + product.T) - np.trace(product) * np.eye(3)
        angular = screws.angular[zone.border]
        border[np.ix_(zone.border, zone.border)] -= angular @ turned @ angular.T
    border[range(-len(at.drive), 0), range(-len(at.drive), 0)] += at.drive
    empty = sp.csr_matrix((at.first_border, at.first_border))
    return (mapping.T @ stiffness @ mapping + sp.block_diag((empty, border))).tocsr()
