"""Time step in plain NumPy, with any linear solver: the reference for the compiled step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from time import perf_counter

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array
from softsim_core.physics.actuation import Actuators, pressed_blocks
from softsim_core.physics.dynamics.actuator_statics import rows_on_unknowns
from softsim_core.physics.dynamics.assembly import (
    Unknowns,
    diagonal_matrix,
    jacobian,
    node_stiffness,
    static_forces,
    static_tangent,
    step_stress_matrix,
    top_speed,
    viscosity_matrix,
)
from softsim_core.physics.dynamics.iterations import FreeTurning
from softsim_core.physics.dynamics.report import StepReport
from softsim_core.physics.dynamics.stepper import Condensed
from softsim_core.physics.fem import BlockPattern, LinearMove, inverted_cells, von_mises_stress
from softsim_core.physics.linalg import Factoriser, Factors, LinearSolver, choose_linear_solver, solve_bounded
from softsim_core.physics.mechanics import (
    MOVED,
    Control,
    Model,
    Parameters,
    Rows,
    State,
    join_rows,
    no_rows,
    sparse_rows,
)


class ScipyStepper:
    """Stepper in plain NumPy: assemble, project on the generalised coordinates, factor, solve.

    Args:
        model, actuators: What moves, and what moves it.
        solver: The linear solver; None: the default.
    """

    name = "scipy"
    compiled = False

    def __init__(self, model: Model, actuators: Actuators, solver: LinearSolver | None = None) -> None:
        self.model, self.actuators = model, actuators
        self._unknowns = at = Unknowns(model)
        self._turning = FreeTurning(model)
        solver = solver or choose_linear_solver()
        self._matrices = Factoriser(solver, int((at.solved >= at.first_reduced).sum()))
        self._tangents = Factoriser(solver)

    @cached_property
    def _pattern(self) -> BlockPattern:
        return BlockPattern(len(self.model.rest), [group.cells for group in self.model.groups])

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance the state by one dt, in place."""
        return self._advance(state, control, parameters).report

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> ScipyFreeMotion:
        """Return the unconstrained step, ready for impulses on constraint rows."""
        before = self.model.empty_state()
        before.copy_from(state)
        return ScipyFreeMotion(self.model, self._unknowns, self._advance(state, control, parameters), before)

    def _advance(self, state: State, control: Control, parameters: Parameters) -> _SolvedStep:
        started = perf_counter()
        control.check(len(self.model.joints), len(self.model.rest))
        model, h, at = self.model, self.model.dt, self._unknowns
        before, moved = state.positions.copy(), state.extra.get(MOVED)
        pressed = []
        if moved is not None:
            pressed = self.actuators.surface_stiffness(state, self.actuators.multipliers(state))
        matrix, rhs, mapping = self.system(state, control, parameters, moved, pressed)
        assembled = perf_counter()
        change, targets = np.zeros(at.size), control.targets
        rates = (targets - state.joint_positions)[at.prescribed] / h
        change[at.fixed] = rates - state.reduced_velocities[at.fixed - at.first_reduced]
        change[at.joints[self.actuators.joint]] = 0.0  # an actuator's joint moves no frame
        factors, fallback = None, 0
        if len(at.solved):
            solved_rows = matrix[at.solved]
            factors = self._matrices.factor(solved_rows[:, at.solved])
            for stressed in (moved, None) if pressed else (None,):  # less, until the matrix is positive
                if moved is not None and not factors.positive:
                    fallback = 2 if stressed is None else 1
                    matrix, rhs, mapping = self.system(state, control, parameters, stressed)
                    solved_rows = matrix[at.solved]
                    factors = self._matrices.factor(solved_rows[:, at.solved])
            known_part = solved_rows[:, at.fixed] @ change[at.fixed]
            change[at.solved] = factors.solve(rhs[at.solved] - known_part)
        solved = _SolvedStep(state, matrix, factors, mapping, self.actuators)
        pulled = self._hold_actuators(solved, change, control)
        ended = perf_counter()

        state.velocities[at.free] += change[: at.first_reduced].reshape(-1, 3)
        state.positions[at.free] += h * state.velocities[at.free]
        model.advance_reduced(state, state.reduced_velocities + change[at.first_reduced :])
        state.joint_positions[at.prescribed] = targets[at.prescribed]  # exactly, without rounding
        state.base_shift[0] = control.base_shift
        model.place_regions(state)
        if moved is not None:
            moved[:] = state.positions - before
        reaction = (matrix[at.fixed] @ change - rhs[at.fixed]) / h - pulled[at.fixed]
        state.joint_efforts[at.prescribed] = reaction
        spring = at.drive * (targets - state.joint_positions)
        state.joint_efforts[at.compliant] = spring[at.compliant]
        self.actuators.report(model, state, solved.values, solved.multipliers)
        times = {
            "assemble": 1e3 * (assembled - started),
            "solve": 1e3 * (ended - assembled),
            "update": 1e3 * (perf_counter() - ended),
        }
        found_positive = factors is None or factors.positive
        solved.report = StepReport(
            top_speed(self.model, state),
            times,
            inverted_elements(model, state),
            found_positive,
            fallback=fallback,
        )
        return solved

    def _hold_actuators(self, solved: _SolvedStep, change: Array, control: Control) -> Array:
        """Solve for the multipliers t, add their effect to the velocity change (d,), return H^T t (d,)."""
        actuators, model, h, at, state = (
            self.actuators,
            self.model,
            self.model.dt,
            self._unknowns,
            solved.state,
        )
        if not len(actuators):
            return np.zeros(at.size)
        transmissions = actuators.transmissions_of_step(state, control, model)
        solved.values, solved.rows = actuators.values(model, state), actuators.rows(model, state)
        spread = solved.spread(model, at, solved.rows)
        after = change.copy()
        after[: at.first_reduced] += state.velocities[at.free].ravel()
        after[at.first_reduced :] += state.reduced_velocities
        compliance = h * h * solved.compliance(at, spread) + np.diag(transmissions.compliance)
        violations = solved.values - transmissions.command + h * (spread.T @ after)
        solved.multipliers = solve_bounded(compliance, violations, transmissions.lower, transmissions.upper)
        solved.violations = violations + compliance @ solved.multipliers
        pulled = np.asarray(spread @ solved.multipliers)
        change += solved.answer(at, h * pulled)
        return pulled

    def without_mass(self) -> None:
        """Return None: its steps take as long as iterations of statics."""

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """Return the von Mises stress of each element in [Pa], shape (m,)."""
        return von_mises_stress(self.model.groups, state.positions, parameters.materials)

    def static_tangent(
        self, state: State, parameters: Parameters, forces: Array, pressed: Sequence[Array] = ()
    ) -> ScipyStaticTangent:
        """Return the static tangent at a state under node forces (n, 3) in [N]."""
        stiffness = node_stiffness(
            self.model, state, parameters, last=_move(state, state.extra.get(MOVED)), pattern=self._pattern
        )
        if pressed:
            stiffness = stiffness + self._of_surfaces(pressed)
        loads = static_forces(self.model, state, parameters, forces)
        return ScipyStaticTangent(self.model, self._unknowns, state, loads, stiffness, self._tangents)

    def _of_surfaces(self, pressed: Sequence[Array]) -> sp.csr_matrix:
        """Return the stiffness of the actuators' surfaces, shape (3 n, 3 n).

        See ActuatorGroup.surface_stiffness.
        """
        blocks = [pressed_blocks(each) for each in pressed]
        return BlockPattern(len(self.model.rest), self.actuators.surfaces()).matrix(blocks)

    def system(
        self,
        state: State,
        control: Control,
        parameters: Parameters,
        moved: Array | None = None,
        pressed: Sequence[Array] = (),
    ) -> tuple[sp.csc_matrix, Array, sp.csr_matrix]:
        """Return matrix and right-hand side over free nodes, frames and joints (prescribed ones included).

        Args:
            state: See Stepper.
            control: See Stepper.
            parameters: See Stepper.
            moved: Displacement by the last step in [m], (n, 3), see fem.cells.LinearMove; with it, the matrix
                includes the stiffness of taut actuators.
            pressed: Stiffness of the actuators' surfaces, see ActuatorGroup.surface_stiffness; empty: left
                out.

        Returns:
            A, sparse, shape (d, d), and b, shape (d,), with d = 3 free nodes + reduced coordinates; and the
            map from the velocities of all unknowns to node velocities, sparse, shape (3 n, d).
        """
        model, h, at = self.model, self.model.dt, self._unknowns
        lag = h + parameters.rayleigh_stiffness
        stiffness = node_stiffness(
            model,
            state,
            parameters,
            True,
            last=_move(state, moved),
            mean_share=h / lag,
            pattern=self._pattern,
        )
        if pressed:
            stiffness = stiffness + self._of_surfaces(pressed)
        force = static_forces(model, state, parameters, control.forces)
        stress_matrix = step_stress_matrix(model, state)
        if stress_matrix is not None:
            stiffness = stiffness + stress_matrix
            force -= (stress_matrix @ state.positions.ravel()).reshape(-1, 3)
        force -= (parameters.rayleigh_mass * model.mass)[:, None] * state.velocities
        straining = self._turning.lagging(state, control, parameters.rayleigh_stiffness / lag)
        force -= lag * (stiffness @ straining.ravel()).reshape(-1, 3)
        lagging = lag * stiffness
        viscous = viscosity_matrix(model, state, parameters)
        if viscous is not None:
            force -= (viscous @ straining.ravel()).reshape(-1, 3)
            lagging = lagging + viscous
        damped = 1.0 + h * parameters.rayleigh_mass
        full = h * lagging + diagonal_matrix(np.repeat(damped * model.mass, 3))
        if model.coupling is not None:
            force -= parameters.rayleigh_mass * (model.coupling.matrix @ state.velocities)
            full = full + sp.kron(damped * model.coupling.matrix, sp.eye(3), format="csr")

        mapping = jacobian(model, at, state)
        rhs = h * (mapping.T @ force.ravel())
        velocity = state.reduced_velocities[at.joints - at.first_reduced]
        rhs[at.joints] += h * at.drive * (control.targets - state.joint_positions - lag * velocity)
        diagonal = np.zeros(at.size)
        diagonal[at.joints] = [joint.inertia for joint in model.joints] + h * lag * at.drive
        matrix = mapping.T @ full @ mapping + diagonal_matrix(diagonal)
        if moved is not None and len(self.actuators):
            geometric = self.actuators.geometric_stiffness(
                model, state, self.actuators.multipliers(state), without_surfaces=True
            )
            rows = rows_on_unknowns(model, at, mapping, geometric.rows)
            weight = h * lag * np.maximum(geometric.weight, 0.0)
            rates = rows.on_nodes @ straining.ravel() + rows.on_reduced @ state.reduced_velocities
            rhs -= rows.on_unknowns.T @ (weight * rates)
            matrix = matrix + rows.on_unknowns.T @ diagonal_matrix(weight) @ rows.on_unknowns
        return matrix.tocsc(), rhs, mapping


def _move(state: State, moved: Array | None) -> LinearMove | None:
    """Return the displacement (n, 3) that led to a state as a linear move; None: there is none."""
    return None if moved is None else LinearMove(state.positions - moved, moved)


class _SolvedStep:
    """A solved step: its matrix, and the multipliers of the actuators."""

    def __init__(
        self,
        state: State,
        matrix: sp.csc_matrix,
        factors: Factors | None,
        mapping: sp.csr_matrix,
        actuators: Actuators,
    ) -> None:
        self.state, self.matrix, self.actuators = state, matrix, actuators
        self._factors, self._mapping = factors, mapping
        self.violations, self.multipliers, self.values = np.zeros((3, len(actuators)))
        self.rows = no_rows()
        self.report = StepReport()

    def spread(self, model: Model, at: Unknowns, rows: Rows) -> Array:
        """Return H^T on all unknowns, shape (d, r)."""
        on_nodes, on_reduced = sparse_rows(rows, len(model.rest), model.reduced_size)
        spread = (on_nodes @ self._mapping).toarray().T
        spread[at.first_reduced :] += on_reduced.toarray().T
        return np.asarray(spread)

    def compliance(self, at: Unknowns, spread: Array) -> Array:
        """Return H A^-1 H^T of rows H^T (d, r), with prescribed joints fixed."""
        if self._factors is None or not spread.shape[1]:
            return np.zeros((spread.shape[1],) * 2)
        return self._factors.schur(spread[at.solved].T)

    def answer(self, at: Unknowns, impulse: Array) -> Array:
        """Return the velocity change (d,) by an impulse on the unknowns, with prescribed joints fixed."""
        change = np.zeros(at.size)
        if self._factors is not None:
            change[at.solved] = self._factors.solve(impulse[at.solved])
        return change


class ScipyFreeMotion:
    """Unconstrained step of the SciPy stepper, and the responses to impulses on it."""

    defect: Array | None = None

    def __init__(self, model: Model, at: Unknowns, solved: _SolvedStep, before: State) -> None:
        self.state, self.before, self.report = solved.state, before, solved.report
        self.violations = solved.violations
        self._model, self._at, self._solved = model, at, solved
        self._free = model.empty_state()
        self._free.copy_from(solved.state)
        self._spread = np.zeros((at.size, len(solved.actuators)))

    def compliance(self, rows: Rows) -> Array:
        """Return the compliance H A^-1 H^T of actuators and rows in [1/kg], shape (c + r, c + r)."""
        all_rows = join_rows([self._solved.rows, rows.with_kernel_types()])
        self._spread = self._solved.spread(self._model, self._at, all_rows)
        return self._solved.compliance(self._at, self._spread)

    def correct(self, impulses: Array) -> StepReport:
        """Add the effect of impulses [N s] on the rows to the free motion, in place."""
        model, at, h, state, free = self._model, self._at, self._model.dt, self.state, self._free
        solved, before, impulse = self._solved, self.before, self._spread @ impulses
        change = solved.answer(at, impulse)
        state.velocities[at.free] = free.velocities[at.free] + change[: at.first_reduced].reshape(-1, 3)
        state.positions[at.free] = before.positions[at.free] + h * state.velocities[at.free]
        state.frame_positions[:] = before.frame_positions
        state.frame_rotations[:] = before.frame_rotations
        state.joint_positions[:] = before.joint_positions
        model.advance_reduced(state, free.reduced_velocities + change[at.first_reduced :])
        state.joint_positions[at.prescribed] = free.joint_positions[at.prescribed]
        reaction = solved.matrix[at.fixed] @ change - impulse[at.fixed]
        state.joint_efforts[:] = free.joint_efforts
        state.joint_efforts[at.prescribed] += reaction / h
        moved = state.joint_positions - free.joint_positions
        state.joint_efforts[at.compliant] -= (at.drive * moved)[at.compliant]
        model.place_regions(state)
        if MOVED in state.extra:
            state.extra[MOVED][:] = state.positions - before.positions
        multipliers = solved.multipliers + impulses[: len(solved.actuators)] / h
        solved.actuators.report(model, state, solved.values, multipliers)
        return replace(
            self.report, top_speed=top_speed(model, state), inverted=inverted_elements(model, state)
        )


class ScipyStaticTangent:
    """Static tangent of the SciPy stepper.

    Args:
        model, at: The model and its unknowns.
        state, loads, stiffness: See assembly.static_tangent.
        matrices: Factors the free nodes' part.
    """

    def __init__(
        self,
        model: Model,
        at: Unknowns,
        state: State,
        loads: Array,
        stiffness: sp.csr_matrix,
        matrices: Factoriser,
    ) -> None:
        self._model, self._at = model, at
        self._mapping = jacobian(model, at, state)
        tangent = static_tangent(model, at, state, loads, stiffness, self._mapping).tocsc()
        free, reduced = slice(0, at.first_reduced), slice(at.first_reduced, at.size)
        self._stiffness = tangent[reduced, reduced].toarray()
        self._follow = np.zeros((at.first_reduced, model.reduced_size))
        self._factors: Factors | None = None
        if at.first_reduced:
            self._factors = matrices.factor(tangent[free, free])
            coupling = tangent[free, reduced].toarray()
            self._follow = self._factors.solve(coupling)
            self._stiffness = self._stiffness - tangent[reduced, free] @ self._follow
        self.positive = self._factors is None or self._factors.positive

    def condense(self, rows: Rows) -> Condensed:
        """Return the tangent with the free nodes eliminated, and the compliance of rows."""
        at, model = self._at, self._model
        on_nodes, on_reduced = sparse_rows(rows, len(model.rest), model.reduced_size)
        spread = (on_nodes @ self._mapping).toarray().T
        on_free = spread[: at.first_reduced]
        arriving = spread[at.first_reduced :] + on_reduced.toarray().T - self._follow.T @ on_free
        compliance = np.zeros((rows.height, rows.height))
        if self._factors is not None and rows.height:
            compliance = self._factors.schur(on_free.T)
        return Condensed(0.5 * (self._stiffness + self._stiffness.T), arriving, compliance)


def inverted_elements(model: Model, state: State) -> int:
    """Return the number of cells with det F <= 0 at a point; a state that is not finite has none."""
    with np.errstate(invalid="ignore"):
        return sum(int(inverted_cells(group, state.positions).sum()) for group in model.filling)
