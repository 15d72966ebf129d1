"""The time step in plain NumPy and SciPy: the readable reference that the fast one is tested against."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softsim_core.actuation.cable import Cables
from softsim_core.arrays import Array
from softsim_core.dynamics.assembly import (
    Unknowns,
    elastic_forces,
    jacobian,
    node_stiffness,
    rotated_gradients,
    sparse_of_blocks,
    static_forces,
    static_tangent,
)
from softsim_core.dynamics.bounded import solve_bounded
from softsim_core.dynamics.cable_statics import border_stiffness
from softsim_core.dynamics.rows import Rows, joined, sparse_rows
from softsim_core.dynamics.stepper import Inputs, Parameters, no_rows
from softsim_core.fem.corotational import stiffness_blocks, stresses, von_mises
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State


class ScipyStepper:
    """Assemble, project on the generalised coordinates, factor with SuperLU, solve."""

    name = "scipy"

    def __init__(self, model: Model, cables: Cables) -> None:
        self.model, self.cables = model, cables
        self.cable_gaps, self._tensions = np.zeros(len(cables)), np.zeros(len(cables))
        self._cable_rows = no_rows()
        self.stage_times: dict[str, float] = {}
        self._unknowns = Unknowns(model)
        self._matrix = sp.csc_matrix((0, 0))
        self._factors: Any = None
        self._mapping = sp.csr_matrix((0, 0))
        self._held = np.zeros((0, 0))
        self._answer = np.zeros((0, 0))

    def step(self, state: State, inputs: Inputs, parameters: Parameters) -> float:
        """See Stepper."""
        started = perf_counter()
        matrix, rhs = self.system(state, inputs, parameters)
        assembled = perf_counter()
        model, h, at = self.model, self.model.dt, self._unknowns
        change, targets = np.zeros(at.size), self.cables.travels(inputs.targets, state)
        wanted = (targets - state.joint_positions)[at.prescribed] / h
        change[at.fixed] = wanted - state.border_velocities[at.fixed - at.first_border]
        if len(at.solved):
            rows = matrix[at.solved]
            known_part = rows[:, at.fixed] @ change[at.fixed]
            self._factors = factorised(rows[:, at.solved])
            change[at.solved] = self._factors.solve(rhs[at.solved] - known_part)
        self._matrix = matrix
        pulled = self._hold_cables(state, change, self.cables.bounds(inputs.targets))
        solved = perf_counter()

        state.velocities[at.free] += change[: at.first_border].reshape(-1, 3)
        state.positions[at.free] += h * state.velocities[at.free]
        model.advance_border(state, state.border_velocities + change[at.first_border :])
        state.joint_positions[at.prescribed] = targets[at.prescribed]  # exactly, without rounding
        state.base_shift[0] = inputs.base_shift
        model.place_zones(state)
        reaction = (matrix[at.fixed] @ change - rhs[at.fixed]) / h - pulled[at.fixed]
        state.joint_efforts[at.prescribed] = reaction
        spring = at.drive * (targets - state.joint_positions)
        state.joint_efforts[at.compliant] = spring[at.compliant]
        if len(self.cables):
            self.cables.report(model, state, self._tensions)
        self.stage_times = {
            "assemble": 1e3 * (assembled - started),
            "solve": 1e3 * (solved - assembled),
            "update": 1e3 * (perf_counter() - solved),
        }
        return _top_speed(state)

    def _hold_cables(self, state: State, change: Array, bounds: tuple[Array, Array]) -> Array:
        """Find the tensions t, add what they do to the change of velocity (d,); returns H^T t (d,)."""
        cables, model, h, at = self.cables, self.model, self.model.dt, self._unknowns
        if not len(cables):
            return np.zeros(at.size)
        points = cables.points(model, state)
        pulls, lengths = cables.pulls(points)
        self._cable_rows = cables.rows(model, state, points, pulls)
        spread, answer = self._answers(self._cable_rows)
        after = change.copy()
        after[: at.first_border] += state.velocities[at.free].ravel()
        after[at.first_border :] += state.border_velocities
        compliance, gaps = h * h * (spread.T @ answer), cables.gaps(state, lengths) + h * (spread.T @ after)
        self._tensions = solve_bounded(compliance, gaps, *bounds)
        self.cable_gaps = gaps + compliance @ self._tensions
        change += answer @ (h * self._tensions)
        return np.asarray(spread @ self._tensions)

    def _answers(self, rows: Rows) -> tuple[Array, Array]:
        """H^T on all unknowns and A^-1 H^T, prescribed joints held, shapes (d, r)."""
        model, at = self.model, self._unknowns
        on_nodes, on_border = sparse_rows(rows, len(model.rest), model.border_size)
        spread = (on_nodes @ self._mapping).toarray().T
        spread[at.first_border :] += on_border.toarray().T
        answer = np.zeros_like(spread)
        if len(at.solved) and rows.height:
            answer[at.solved] = self._factors.solve(spread[at.solved])
        return spread, answer

    def compliance(self, rows: Rows, before: State) -> Array:
        """See Stepper."""
        self._held, self._answer = self._answers(joined([self._cable_rows, rows]))
        return np.asarray(self._held.T @ self._answer)

    def correct(self, state: State, before: State, impulses: Array) -> float:
        """See Stepper."""
        model, h, at = self.model, self.model.dt, self._unknowns
        change = self._answer @ impulses
        state.velocities[at.free] += change[: at.first_border].reshape(-1, 3)
        state.positions[at.free] = before.positions[at.free] + h * state.velocities[at.free]
        state.frame_positions[:] = before.frame_positions
        state.frame_rotations[:] = before.frame_rotations
        targets = state.joint_positions.copy()
        state.joint_positions[:] = before.joint_positions
        model.advance_border(state, state.border_velocities + change[at.first_border :])
        state.joint_positions[at.prescribed] = targets[at.prescribed]
        reaction = self._matrix[at.fixed] @ change - self._held[at.fixed] @ impulses
        state.joint_efforts[at.prescribed] += reaction / h
        moved = state.joint_positions - targets
        state.joint_efforts[at.compliant] -= (at.drive * moved)[at.compliant]
        model.place_zones(state)
        if len(self.cables):
            self.cables.report(model, state, self._tensions + impulses[: len(self.cables)] / h)
        return _top_speed(state)

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """See Stepper."""
        model = self.model
        rotated = rotated_gradients(model, state.positions)
        corners = state.positions[model.elements.nodes]
        return von_mises(stresses(corners, rotated, parameters.lame[model.element_body]))

    def border_stiffness(self, state: State, parameters: Parameters, forces: Array) -> Array:
        """See Stepper."""
        return border_stiffness(self, state, parameters, forces)

    def border_response(
        self, state: State, parameters: Parameters, forces: Array, rows: Rows
    ) -> tuple[Array, Array, Array]:
        """See Stepper."""
        at, model = self._unknowns, self.model
        loads = static_forces(model, state, parameters.lame, forces)
        stiffness = node_stiffness(model, state, parameters.lame)
        tangent = static_tangent(model, at, state, loads, stiffness).tocsc()
        free, border = slice(0, at.first_border), slice(at.first_border, at.size)
        coupling = tangent[free, border].toarray()
        condensed = tangent[border, border].toarray()
        on_nodes, on_border = sparse_rows(rows, len(model.rest), model.border_size)
        spread = (on_nodes @ jacobian(model, at, state)).toarray().T
        arriving, compliance = spread[border] + on_border.toarray().T, np.zeros((rows.height, rows.height))
        if at.first_border:
            factors = factorised(tangent[free, free])
            condensed = condensed - tangent[border, free] @ factors.solve(coupling)
            if rows.height:
                answer = factors.solve(spread[free])
                arriving = arriving - tangent[border, free] @ answer
                compliance = spread[free].T @ answer
        return 0.5 * (condensed + condensed.T), arriving, compliance

    def system(self, state: State, inputs: Inputs, parameters: Parameters) -> tuple[sp.csc_matrix, Array]:
        """Matrix A and right-hand side b over free nodes, frames and joints (prescribed ones too).

        Returns:
            A, sparse, shape (d, d), and b, shape (d,), with d = 3 free nodes + border unknowns.
        """
        model, h, at = self.model, self.model.dt, self._unknowns
        lag = h + parameters.rayleigh_stiffness
        ahead = state.positions + lag * state.velocities  # forces there are f - lag K v
        rotated = rotated_gradients(model, state.positions)
        force = inputs.forces + elastic_forces(model, ahead, rotated, parameters.lame)
        force += model.mass[:, None] * (model.gravity - parameters.rayleigh_mass * state.velocities)
        force -= model.spring[:, None] * (ahead - model.rest)

        blocks = stiffness_blocks(rotated, model.elements.volumes, parameters.lame[model.element_body])
        inertia = (1.0 + h * parameters.rayleigh_mass) * model.mass + h * lag * model.spring
        full = h * lag * sparse_of_blocks(model, blocks) + sp.diags(np.repeat(inertia, 3))

        mapping = self._mapping = jacobian(model, at, state)
        rhs = h * (mapping.T @ force.ravel())
        velocity = state.border_velocities[at.joints - at.first_border]
        rhs[at.joints] += h * at.drive * (inputs.targets - state.joint_positions - lag * velocity)
        diagonal = np.zeros(at.size)
        diagonal[at.joints] = [joint.inertia for joint in model.joints] + h * lag * at.drive
        return (mapping.T @ full @ mapping + sp.diags(diagonal)).tocsc(), rhs


def _top_speed(state: State) -> float:
    """Largest component of all velocities, NaN if one is."""
    speeds = np.concatenate([state.velocities.ravel(), state.border_velocities])
    return float(np.abs(speeds).max(initial=0.0))  # max keeps NaN


def factorised(matrix: sp.csc_matrix) -> Any:
    """SuperLU factors of a (nearly) symmetric matrix: diagonal pivots, minimum degree order of A + A^T."""
    return splu(
        matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
