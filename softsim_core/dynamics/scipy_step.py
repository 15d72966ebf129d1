"""The time step in plain NumPy and SciPy: the readable reference that the fast one is tested against."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softsim_core.arrays import Array
from softsim_core.dynamics.stepper import Inputs, Parameters, joint_stiffness
from softsim_core.fem.corotational import element_rotations, stiffness_blocks, stresses
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State


class ScipyStepper:
    """Assemble, project on the generalised coordinates, factor with SuperLU, solve."""

    name = "scipy"

    def __init__(self, model: Model) -> None:
        self.model = model
        self.stage_times: dict[str, float] = {}
        joints = model.border_size - len(model.joints)
        self._free = model.free_nodes
        self._first_border = 3 * len(self._free)
        self._joint_columns = self._first_border + joints + np.arange(len(model.joints))
        self._compliant = model.compliant_joints
        self._prescribed = np.setdiff1d(np.arange(len(model.joints)), self._compliant)
        self._stiffness = joint_stiffness(model)

    def step(self, state: State, inputs: Inputs, parameters: Parameters) -> None:
        """See Stepper."""
        started = perf_counter()
        matrix, rhs = self.system(state, inputs, parameters)
        assembled = perf_counter()
        model, h = self.model, self.model.dt
        change = np.zeros(len(rhs))
        prescribed = self._joint_columns[self._prescribed]
        wanted = (inputs.targets - state.joint_positions)[self._prescribed] / h
        change[prescribed] = wanted - state.border_velocities[prescribed - self._first_border]
        unknown = np.setdiff1d(np.arange(len(rhs)), prescribed)
        if len(unknown):
            known_part = matrix[unknown][:, prescribed] @ change[prescribed]
            change[unknown] = factorised(matrix[unknown][:, unknown]).solve(rhs[unknown] - known_part)
        solved = perf_counter()

        state.velocities[self._free] += change[: self._first_border].reshape(-1, 3)
        state.positions[self._free] += h * state.velocities[self._free]
        model.advance_border(state, state.border_velocities + change[self._first_border :])
        state.joint_positions[self._prescribed] = inputs.targets[
            self._prescribed
        ]  # exactly, without rounding
        state.base_shift[0] = inputs.base_shift
        model.place_zones(state)
        reaction = (matrix[prescribed] @ change - rhs[prescribed]) / h
        state.joint_efforts[self._prescribed] = reaction
        spring = self._stiffness * (inputs.targets - state.joint_positions)
        state.joint_efforts[self._compliant] = spring[self._compliant]
        self.stage_times = {
            "assemble": 1e3 * (assembled - started),
            "solve": 1e3 * (solved - assembled),
            "update": 1e3 * (perf_counter() - solved),
        }

    def system(self, state: State, inputs: Inputs, parameters: Parameters) -> tuple[sp.csc_matrix, Array]:
        """Matrix A and right-hand side b of the step over free nodes, frames and joints (prescribed ones included).

        Returns:
            A, sparse, shape (d, d), and b, shape (d,), with d = 3 free nodes + border unknowns.
        """
        model, h = self.model, self.model.dt
        lag = h + parameters.rayleigh_stiffness
        tets, volumes = model.elements.nodes, model.elements.volumes
        corners, lame = state.positions[tets], parameters.lame[model.element_body]
        rotated = model.elements.gradients @ np.swapaxes(
            element_rotations(corners, model.elements.gradients, model.law), 1, 2
        )
        stress = stresses(
            corners + lag * state.velocities[tets], rotated, lame
        )  # stress at x + lag v: f - lag K v
        force = inputs.forces + model.mass[:, None] * (
            model.gravity - parameters.rayleigh_mass * state.velocities
        )
        np.add.at(force, tets, -volumes[:, None, None] * np.einsum("mij,maj->mai", stress, rotated))
        force -= model.spring[:, None] * (state.positions + lag * state.velocities - model.rest)

        blocks = stiffness_blocks(rotated, volumes, lame)
        dofs = 3 * tets[:, :, None] + np.arange(3)
        rows = np.broadcast_to(dofs[:, :, None, :, None], blocks.shape)
        columns = np.broadcast_to(dofs[:, None, :, None, :], blocks.shape)
        size = 3 * len(model.rest)
        stiffness = sp.coo_matrix(
            (blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)
        ).tocsr()
        inertia = (1.0 + h * parameters.rayleigh_mass) * model.mass + h * lag * model.spring
        full = h * lag * stiffness + sp.diags(np.repeat(inertia, 3))

        jacobian = self._jacobian(state)
        matrix = (jacobian.T @ full @ jacobian).tocsc()
        rhs = h * (jacobian.T @ force.ravel())
        drive, joints = self._stiffness, self._joint_columns
        velocity = state.border_velocities[self._joint_columns - self._first_border]
        rhs[joints] += h * drive * (inputs.targets - state.joint_positions - lag * velocity)
        diagonal = np.zeros(len(rhs))
        diagonal[joints] = [joint.inertia for joint in model.joints] + h * lag * drive
        return matrix + sp.diags(diagonal).tocsc(), rhs

    def _jacobian(self, state: State) -> sp.csr_matrix:
        """Node velocities from the velocities of free nodes, frames and joints, shape (3 n, d)."""
        model, free = self.model, self._free
        rows = [(3 * free[:, None] + np.arange(3)).ravel()]
        columns = [np.arange(3 * len(free))]
        values = [np.ones(3 * len(free))]
        screws = model.screws(state)
        for zone in model.zones:
            for k in zone.border:
                rows.append((3 * zone.nodes[:, None] + np.arange(3)).ravel())
                columns.append(np.full(3 * len(zone.nodes), self._first_border + k))
                values.append(screws.jacobian(int(k), state.positions[zone.nodes]).ravel())
        shape = (3 * len(model.rest), self._first_border + model.border_size)
        return sp.csr_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape
        )


def factorised(matrix: sp.csc_matrix) -> object:
    """SuperLU factorisation of a symmetric positive definite matrix, ordered by minimum degree on A + A^T."""
    return splu(
        matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
