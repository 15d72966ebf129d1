"""Static equilibrium: Newton's method with the exact tangent, line search and load steps; its derivatives.

With S, Z and W of actuator_statics.condensed, u the free frames and joints on drives, p all other joints, and
D the stiffness of the drives, a force f on the rows and a change dc of the commands move

    du = S_uu^-1 (Z_u f + D dc_u - S_up dc_p),    dy = Z_u^T du + Z_p^T dc_p + W f

Source: implicit function theorem on the equilibrium of softsim_core.physics.dynamics.statics.

With q the free nodes, free frames and compliant joints, x = x(q) the nodes, J = dx/dq and f the forces on
nodes (elastic, weight, soft fixings, external, actuators), the residual is r(q) = J^T f + drive springs, and
an iteration solves

    (J^T K J - G) dq = r,    K = -df/dx (exact),    G = (dJ^T/dq) f of the rigid regions

and adds dq, all or part of it (see WAYS). Actuators add H^T t to f, their geometric stiffness to the tangent,
and s - q + c t to what is solved; see actuator_statics. A load that is too far
is approached in parts: joint targets and base shift move evenly, and the residual of the first state is taken
away evenly; where that takes long, inertia restrains the steps instead (see StaticProblem.restrained). Where
the first state could not stay whatever held it (bodies may be drawn far from rest), such steps come first, or
it is let go before joints and base move. What comes out is checked: the last step is tiny, the equilibrium
stable, and no element was turned inside out.

Source: Deuflhard 2004, Newton methods for nonlinear problems (error-oriented line search, continuation).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array, FactorisationError, IndexArray, NotConvergedError
from softsim_core.physics.actuation import Actuators, GeometricStiffness, drive_stiffness
from softsim_core.physics.dynamics.actuator_statics import ActuatedFactors, on_nodes, rows_on_unknowns
from softsim_core.physics.dynamics.assembly import (
    Unknowns,
    generalised_forces,
    node_stiffness,
    static_forces,
    static_tangent,
)
from softsim_core.physics.dynamics.stepper import Condensed
from softsim_core.physics.fem import inverted_cells
from softsim_core.physics.linalg import Factoriser, LinearSolver, linear_solver
from softsim_core.physics.mechanics import Control, Model, Parameters, RigidRegion, State, nearest_rotation


@dataclass(frozen=True, slots=True, eq=False)
class StaticResponse:
    """Derivatives of an equilibrium; of its r rows, and of its b degrees of freedom of frames and joints.

    Attributes:
        rows_by_command: Shift of each row a unit of each joint's command, shape (r, j).
        rows_by_row: Shift of each row a unit of force on each row in [m/N], shape (r, r).
        reduced_by_command: Change of frames and joints a unit of each joint's command, shape (b, j).
        reduced_by_row: The same a unit of force on each row, shape (b, r).
    """

    rows_by_command: Array
    rows_by_row: Array
    reduced_by_command: Array
    reduced_by_row: Array


def response_of(model: Model, condensed: Condensed) -> StaticResponse:
    """The response, from the condensed static tangent.

    Raises:
        LinAlgError: frames or joints have no stiffness here.
    """
    stiffness, arriving, compliance = condensed
    drive = drive_stiffness(model)
    first = len(stiffness) - len(drive)
    solved = np.append(np.ones(first, dtype=bool), drive > 0.0)
    by_command = np.zeros((len(stiffness), len(drive)))
    by_command[first:] = np.eye(len(drive))
    asked = -stiffness[:, first:].copy()
    asked[:, drive > 0.0] = 0.0
    asked[first:] += np.diag(drive)
    by_row = np.zeros_like(arriving)
    inner = stiffness[np.ix_(solved, solved)]
    if len(inner):
        answer = np.linalg.solve(inner, np.hstack([asked[solved], arriving[solved]]))
        by_command[solved], by_row[solved] = answer[:, : len(drive)], answer[:, len(drive) :]
    return StaticResponse(arriving.T @ by_command, compliance + arriving.T @ by_row, by_command, by_row)


SHORTEST_STEP = 1.0 / 256.0
"""A line search below this fraction of a Newton step is given up."""

WAYS = {"whole": 12, "damped": 25, "distant": 12}
"""Ways to an equilibrium, quickest first, and their most iterations: whole Newton steps; damped ones; steps
with the distant tangent, which survive a crumpled start, then whole ones when near."""

NEAR = 0.1
"""The distant tangent is left when a step is shorter than this part of an element's size."""

HEAVIEST, LIGHTEST = 1.0, 1e-6
"""Mass over step squared while a model is let go: in the beginning, and where it is left out, both over what
a step of the model's has."""

LET_GO = 300
"""Most iterations in which a model is let go."""

RESTRAINED = 200
"""Most iterations whose steps inertia restrains."""

FARTHEST = 2.0
"""Such a step moves nothing farther than this many elements' sizes."""

RESTRAINT = 1e-3
"""Mass over step squared of the first of them, over what a step of the model's has."""

LESS, MORE = 0.2, 8.0
"""By which that mass changes after a step that was short enough, and after one that was much too long."""

SINGULAR = "the tangent is singular (is every body attached?)"
NO_FORCES = "the elements are crushed or stretched beyond what has forces and a tangent"


class StaticProblem:
    """Residual and tangent of one static problem, and the Newton iteration on them."""

    def __init__(
        self,
        model: Model,
        control: Control,
        parameters: Parameters,
        state: State,
        actuators: Actuators,
        solver: LinearSolver,
    ) -> None:
        self.model, self.control, self.parameters, self.actuators = model, control, parameters, actuators
        self.held = len(actuators)
        self.at = Unknowns(model)
        self.matrices = Factoriser(solver, int((self.at.solved >= self.at.first_reduced).sum()))
        self.iterations, self.met_unstable = 0, False
        self.start = _copy(model, state)
        self.start.velocities[:] = 0.0
        self.start.reduced_velocities[:] = 0.0
        # while the problem is solved, the position of an actuator's joint is its command
        self.start.joint_positions[actuators.joint] = actuators.commands_of(
            actuators.values(model, self.start), self._multipliers(self.start)
        )
        self.first_targets = self.start.joint_positions.copy()
        self.first_targets[actuators.multiplied] = self.start.joint_efforts[actuators.multiplied]
        self.first_shift = float(self.start.base_shift[0])
        given = (state.buffer, control.targets, control.forces, control.base_shift)
        if not all(np.isfinite(each).all() for each in given):
            raise NotConvergedError("a position, force or target is not finite", 0.0, 0, float("nan"))
        self.lever, self.beside = self._levers(), _beside(model)
        volumes = np.concatenate([np.zeros(0)] + [group.volumes for group in model.filling])
        self.size = float(np.cbrt(volumes.mean())) if len(volumes) else 0.0
        self.first_residual = np.zeros(self.at.size + self.held)
        try:
            self.first_residual = self._residual(self.start, 0.0)[0]
        except np.linalg.LinAlgError as error:  # of the rotations of elements
            raise NotConvergedError(NO_FORCES, 0.0, 0, float("nan")) from error
        self.first_residual[self.at.size :] = 0.0
        if not np.isfinite(self.first_residual).all():
            raise NotConvergedError(NO_FORCES, 0.0, 0, float("nan"))

    def _levers(self) -> Array:
        """What turns each unknown into a displacement: how far it moves its region's nodes in [m], else 1."""
        lever = np.append(np.ones(self.at.size), np.zeros(self.held))
        motion_subspace = self.model.motion_subspace(self.start)
        for region in self.model.regions:
            for k in region.reduced.tolist():
                moved = motion_subspace.jacobian(k, self.start.positions[region.nodes])
                lever[self.at.first_reduced + k] = max(float(np.sqrt((moved**2).sum(axis=1).mean())), 1e-6)
        return lever

    def newton(self, before: State, goal: float, tolerance: float) -> State:
        """The equilibrium at the load fraction `goal`, from an earlier one: each way in turn."""
        failure: NotConvergedError | None = None
        for way in WAYS:
            try:
                return self._iterated(before, goal, tolerance, way)
            except NotConvergedError as refused:
                failure = refused
            except np.linalg.LinAlgError as error:  # of the rotations of elements
                failure = NotConvergedError(NO_FORCES, goal, self.iterations, float("nan"))
                failure.__cause__ = error
        assert failure is not None
        raise failure

    def _iterated(self, before: State, goal: float, tolerance: float, way: str) -> State:
        state, distant = self._predicted(before, goal), way == "distant"
        sizes: list[float] = []
        moved: Array | None = None
        for _ in range(WAYS[way]):
            residual, forces = self._residual(state, goal)
            stiffness = node_stiffness(self.model, state, self.parameters, distant=distant, moved=moved)
            factors = self._factors(state, forces, goal, stiffness)
            step = self._solve(factors, residual, state)
            sizes.append(self._size(step))
            if not sizes[-1] < np.inf:
                raise self._failure(SINGULAR, goal, residual)
            if sizes[-1] <= tolerance and not distant:
                self._accept(state, before, factors, goal, residual)
                self._move(state, step)
                return state
            started = state.positions.copy()
            if way == "damped":
                if not self._search(state, step, factors, goal):
                    raise self._failure("the line search stalled", goal, residual)
                moved = state.positions - started
                continue
            if way == "whole" and len(sizes) > 2 and sizes[-1] > 0.5 * sizes[0]:
                raise self._failure("whole steps do not get shorter", goal, residual)
            self._move(state, step)
            distant = distant and sizes[-1] > NEAR * self.size
            moved = None if distant else state.positions - started
        raise self._failure(f"no convergence in {WAYS[way]} iterations", goal, residual)

    def _accept(self, state: State, before: State, factors: Any, goal: float, residual: Array) -> None:
        """Refuse an equilibrium in which nothing would stay, or that was reached through matter."""
        if not factors.positive:
            self.met_unstable = True
            raise self._failure("only an unstable one", goal, residual)
        if (self._inverted(state) & ~self._inverted(before)).any():
            raise self._failure("only one with elements turned inside out", goal, residual)

    def _inverted(self, state: State) -> Any:
        """Which elements are inside out, shape (m,)."""
        flags = [inverted_cells(group, state.positions) for group in self.model.filling]
        return np.concatenate([np.zeros(0, dtype=bool), *flags])

    @property
    def starts_stable(self) -> bool:
        """Whether the first state would stay if forces held it that do not change."""
        forces = static_forces(self.model, self.start, self.parameters, self.control.forces)
        try:
            stiffness = node_stiffness(self.model, self.start, self.parameters)
            return bool(self._factors(self.start, forces, 0.0, stiffness).positive)
        except NotConvergedError:
            return False

    def let_go(self, tolerance: float) -> State:
        """The equilibrium that the whole load leads the first state to, however far it is from there.

        As steps in time, but each from rest: the mass over the square of a step stands in the distant
        tangent, more of it where a step leads too far, else less and less, until Newton's method does the
        rest.

        Source: Kelley and Keyes 1998, Convergence analysis of pseudo-transient continuation.
        """
        state, goal = _copy(self.model, self.start), 1.0
        inertia, share = self._inertia(), HEAVIEST
        residual, forces = self._residual(state, goal)
        while self.iterations < LET_GO:
            stiffness = node_stiffness(self.model, state, self.parameters, distant=True) + share * inertia
            factors = self._factors(state, forces, goal, stiffness)
            step, before = self._solve(factors, residual, state), _copy(self.model, state)
            self._move(state, step)
            after, forces_after = self._residual(state, goal)
            size, remaining = self._size(step), self._size(self._solve(factors, after, state))
            if factors.positive and remaining <= max(size, tolerance):
                residual, forces, share = after, forces_after, 0.1 * share
                if share < LIGHTEST or size <= tolerance:
                    try:
                        return self.newton(state, goal, tolerance)
                    except NotConvergedError:
                        share = HEAVIEST
            else:
                state.copy_from(before)
                share *= 8.0
        raise self._failure("what was let go found no place to stay", goal, residual)

    def restrained(self, before: State, tolerance: float) -> State:
        """The equilibrium under the whole load from an earlier one, by Newton steps that inertia restrains.

        The exact tangent, with the stress that the last step found, and the mass over the square of a step:
        so much of it that the sum is positive, more where steps are long, less and less where they are short,
        none in the end. Steps need not leave less of the residual than there was: what is flexible in bending
        and axially stiff is first stretched by each turn, which stalls a line search.

        Source: Kelley and Keyes 1998, Convergence analysis of pseudo-transient continuation; Magisano,
        Leonetti, Garcea 2017, How to improve efficiency and robustness of the Newton method.
        """
        state, goal, inertia, share = self._predicted(before, 1.0), 1.0, self._inertia(), RESTRAINT
        farthest = FARTHEST * self.size or np.inf
        moved: Array | None = None
        last = self.iterations + RESTRAINED
        while self.iterations < last:
            residual, forces = self._residual(state, goal)
            stiffness = node_stiffness(self.model, state, self.parameters, moved=moved)
            factors = self._factors(state, forces, goal, stiffness + share * inertia)
            if not factors.positive and share < HEAVIEST / LIGHTEST:
                share = max(MORE * share, LIGHTEST)
                continue
            step = self._solve(factors, residual, state)
            size = self._size(step)
            if not size < np.inf:
                raise self._failure(SINGULAR, goal, residual)
            if size <= tolerance and not share:
                self._accept(state, before, factors, goal, residual)
                self._move(state, step)
                return state
            if size > farthest:
                step *= farthest / size
                share = max(MORE * share, LIGHTEST) if size > 3.0 * farthest else share
            else:
                share = LESS * share if LESS * share >= LIGHTEST else 0.0
            started = state.positions.copy()
            self._move(state, step)
            moved = state.positions - started
        raise self._failure(f"no convergence in {RESTRAINED} restrained steps", goal, residual)

    def _inertia(self) -> sp.csr_matrix:
        """Mass of the nodes over the square of the model's step in [N/m], shape (3 n, 3 n)."""
        return sp.diags(np.repeat(self.model.mass, 3) / self.model.dt**2, format="csr")

    def finish(self, state: State) -> float:
        """Set the joint efforts of an equilibrium; returns the largest unbalanced force in [N]."""
        residual, _ = self._residual(state, 1.0)
        multipliers = self._multipliers(state)
        state.joint_efforts[self.at.prescribed] = -residual[self.at.fixed]
        state.joint_efforts[self.actuators.joint] = multipliers
        self.actuators.measure(self.model, state)
        self.actuators.settle(state, self.control.targets)
        spring = self.at.drive * (self.control.targets - state.joint_positions)
        state.joint_efforts[self.at.compliant] = spring[self.at.compliant]
        return self._unbalanced(residual)

    def _predicted(self, before: State, goal: float) -> State:
        """Prescribed joints and bases at `goal`; all else follows them to first order.

        Nodes that share a short cell with what joints move turn with it as a whole, and add what they do
        beside that: the cell would be torn if its one end turned and the other were moved straight.
        """
        at, model = self.at, self.model
        state = _copy(model, before)
        state.joint_positions[at.prescribed] = self._targets(goal)[at.prescribed]
        state.base_shift[0] = self.first_shift + goal * (self.control.base_shift - self.first_shift)
        model.place_regions(state)
        driven = self._driven(before, state).ravel()
        if driven.any():
            residual, forces = self._residual(before, goal)
            stiffness = node_stiffness(model, before, self.parameters)
            factors = self._factors(before, forces, goal, stiffness)
            stiffness = stiffness + on_nodes(model, self._geometric(before))
            pulled = (stiffness @ driven).reshape(-1, 3)
            residual[: at.size] -= generalised_forces(model, at, before, pulled)
            self._move(state, self._solve(factors, residual, before))
        return state

    def _driven(self, before: State, state: State) -> Array:
        """What joints and bases move to first order in [m], (n, 3); places nodes of `beside` in `state`."""
        model, first = self.model, 6 * len(self.model.frame_names)
        shifted = _copy(model, before)
        shifted.base_shift[0] = state.base_shift[0]
        change = state.joint_positions - before.joint_positions
        subspace, driven = model.motion_subspace(before), np.zeros_like(before.positions)
        for region, nodes in self.beside:
            held, both = before.positions[region.nodes], np.concatenate([region.nodes, nodes])
            driven[region.nodes] = shifted.positions[region.nodes] - held
            driven[nodes] = _moved_along(before.positions[nodes], held, shifted.positions[region.nodes])
            driven[nodes] -= before.positions[nodes]
            for k in region.reduced[region.reduced >= first].tolist():
                driven[both] += change[k - first] * subspace.jacobian(k, before.positions[both])
            state.positions[nodes] = _moved_along(
                before.positions[nodes], held, state.positions[region.nodes]
            )
        return driven

    def _targets(self, fraction: float) -> Array:
        return np.asarray(self.first_targets + fraction * (self.control.targets - self.first_targets))

    def _residual(self, state: State, fraction: float) -> tuple[Array, Array]:
        """Generalised forces and s - q + c t (d + c,) at a part of the load, node forces (n, 3) in [N]."""
        model, at = self.model, self.at
        forces = static_forces(model, state, self.parameters, self.control.forces)
        residual = np.zeros(at.size + self.held)
        if self.held:
            actuators, multipliers = self.actuators, self._multipliers(state)
            rows = rows_on_unknowns(model, at, state, actuators.rows(model, state))
            forces = forces + (rows.on_nodes.T @ multipliers).reshape(-1, 3)
            residual[at.first_reduced : at.size] = rows.on_reduced.T @ multipliers
            kept = actuators.transmissions(state.joint_positions[actuators.joint], multipliers)
            residual[at.size :] = actuators.values(model, state) - kept.command
            residual[at.size :] += kept.compliance * multipliers
        residual[: at.size] += generalised_forces(model, at, state, forces)
        residual[at.joints] += at.drive * (self._targets(fraction) - state.joint_positions)
        return residual - (1.0 - fraction) * self.first_residual, forces

    def _geometric(self, state: State) -> GeometricStiffness:
        """Geometric stiffness of the actuators."""
        return self.actuators.geometric_stiffness(self.model, state, self._multipliers(state))

    def _multipliers(self, state: State) -> Array:
        """Multipliers of the actuators, shape (c,)."""
        return np.asarray(state.joint_efforts[self.actuators.joint])

    def _factors(self, state: State, forces: Array, fraction: float, stiffness: sp.csr_matrix) -> Any:
        """Factorised tangent of the residual on the unknowns that are solved for; see `node_stiffness`."""
        at = self.at
        matrix = static_tangent(self.model, at, state, forces, stiffness)
        if self.held:
            geometric = self._geometric(state)
            across = rows_on_unknowns(self.model, at, state, geometric.rows).on_unknowns
            matrix = matrix + across.T @ sp.diags(geometric.weight) @ across
        self.iterations += 1
        try:
            factors = self.matrices.factor(matrix[at.solved][:, at.solved])
            if not self.held:
                return factors
            rows = rows_on_unknowns(self.model, at, state, self.actuators.rows(self.model, state))
            commands = self._targets(fraction)[self.actuators.joint]
            kept = self.actuators.transmissions(commands, self._multipliers(state))
            return ActuatedFactors(
                factors,
                rows.on_unknowns[:, at.solved],
                kept.compliance,
                (kept.lower, kept.upper),
            )
        except FactorisationError:
            residual, _ = self._residual(state, fraction)
            raise self._failure(SINGULAR, fraction, residual) from None

    def _solve(self, factors: Any, residual: Array, state: State) -> Array:
        at, step = self.at, np.zeros(len(residual))
        if not self.held:
            step[at.solved] = factors.solve(residual[at.solved])
        else:
            step[at.solved], step[at.size :] = factors.solve(
                residual[at.solved], residual[at.size :], self._multipliers(state)
            )
        return step

    def _search(self, state: State, step: Array, factors: Any, fraction: float) -> bool:
        """Take the part of a Newton step after which the next one, with the same tangent, is shorter.

        This measure is in metres for every unknown, so a stiff drive does not drown the silicone.
        Source: Deuflhard 2004, natural monotonicity.
        """
        before, size, part = _copy(self.model, state), self._size(step), 1.0
        while part >= SHORTEST_STEP:
            self._move(state, part * step)
            remaining = self._size(self._solve(factors, self._residual(state, fraction)[0], state))
            if remaining <= (1.0 - 0.25 * part) * size:
                return True
            state.copy_from(before)
            part /= 2.0
        return False

    def _move(self, state: State, step: Array) -> None:
        """Add a step of all unknowns; rotations turn by the exponential."""
        first = self.at.first_reduced
        self.model.displace(state, step[:first].reshape(-1, 3), step[first : self.at.size])
        state.joint_efforts[self.actuators.joint] += step[self.at.size :]

    def _size(self, step: Array) -> float:
        """Largest displacement of a step in [m]; NaN counts as endless."""
        return float(np.nan_to_num(np.abs(step * self.lever), nan=np.inf).max(initial=0.0))

    def _unbalanced(self, residual: Array) -> float:
        solved = self.at.solved
        return float(np.abs(residual[solved] / self.lever[solved]).max(initial=0.0))

    def _failure(self, reason: str, fraction: float, residual: Array) -> NotConvergedError:
        return NotConvergedError(reason, fraction, self.iterations, self._unbalanced(residual))


def _beside(model: Model) -> list[tuple[RigidRegion, IndexArray]]:
    """Of each region, the nodes that share a short cell with it and belong to none."""
    free, found = np.zeros(len(model.rest), dtype=np.bool_), []
    free[model.free_nodes] = True
    for k, region in enumerate(model.regions):
        touched = np.zeros_like(free)
        for group in model.filling:
            cells = group.cells[group.short]
            touched[cells[(model.region_of_node[cells] == k).any(axis=1)]] = True
        found.append((region, np.flatnonzero(touched & free)))
        free &= ~touched
    return found


def _moved_along(points: Array, before: Array, after: Array) -> Array:
    """Points (k, 3) moved as what takes nodes (n, 3) from `before` to `after` without straining them."""
    if not len(points):
        return points
    first, last = before.mean(axis=0), after.mean(axis=0)
    return np.asarray(last + (points - first) @ nearest_rotation(before - first, after - last).T)


def _copy(model: Model, state: State) -> State:
    copy = model.empty_state()
    copy.copy_from(state)
    return copy


SMALLEST_PART = 1.0 / 1024.0
"""A load step below this fraction of the load is given up."""

SMALLER = 1.0 / 4.0
"""A load step that does not lead to an equilibrium is tried again with this part of it."""

PATIENCE = 60
"""Iterations of load steps after which restrained steps are tried."""


@dataclass(frozen=True, slots=True, eq=False)
class StaticSolution:
    """An equilibrium.

    Attributes:
        state: The state at rest in it; joint efforts are what the drives must hold.
        iterations: Linear solves spent, over all load steps.
        load_steps: Parts in which the load was applied; 1 where Newton's method went straight to the answer.
        residual: Largest unbalanced force on an unknown in [N]; moments are divided by their lever arm.
    """

    state: State
    iterations: int
    load_steps: int
    residual: float


def solve_static(
    model: Model,
    state: State,
    control: Control,
    parameters: Parameters,
    *,
    actuators: Actuators | None = None,
    tolerance: float = 1e-11,
    solver: LinearSolver | None = None,
) -> StaticSolution:
    """The stable equilibrium under a constant control that is reached from `state`.

    Where there are several, it is not always the one that a load which grows slowly leads to.

    Args:
        model: The model.
        state: Where to start; it is not changed. Velocities do not matter; held nodes stay where they are.
        control: Joint targets in [rad] or [m], external node forces in [N], base shift in [m].
        parameters: Material; damping has no part in an equilibrium.
        actuators: What pulls and pushes at the command of joints; contacts have no part in it.
        tolerance: The last Newton step moves nothing by more than this, in [m].
        solver: The linear solver; None: the default.

    Raises:
        NotConvergedError: there is none, none that is stable, or it could not be reached from `state`.
    """
    chosen, acting = solver or linear_solver(), actuators or Actuators()
    with np.errstate(all="ignore"):  # far off, numbers overflow: such steps are refused
        problem = StaticProblem(model, control, parameters, state, acting, chosen)
        try:
            current, steps = problem.newton(problem.start, 1.0, tolerance), 1
        except NotConvergedError:
            part, stable = SMALLER, problem.starts_stable
            found = None if stable else _restrained(problem, problem.start, tolerance)
            if found is None and not stable:
                standing = replace(control, targets=problem.first_targets, base_shift=problem.first_shift)
                first = StaticProblem(model, standing, parameters, state, acting, chosen)
                settled, spent, part = first.let_go(tolerance), problem.iterations + first.iterations, 1.0
                problem = StaticProblem(model, control, parameters, settled, acting, chosen)
                problem.iterations = spent
            current, steps = (found, 1) if found is not None else _in_parts(problem, tolerance, part)
        residual = problem.finish(current)
    return StaticSolution(current, problem.iterations, steps, residual)


def _restrained(problem: StaticProblem, before: State, tolerance: float) -> State | None:
    """The equilibrium under the whole load by restrained steps from a state; None: they lead to none."""
    try:
        return problem.restrained(before, tolerance)
    except (NotConvergedError, np.linalg.LinAlgError):  # the latter of the rotations of elements
        return None


def _in_parts(problem: StaticProblem, tolerance: float, part: float) -> tuple[State, int]:
    """The equilibrium under the whole load, of which a part is tried first, and how many parts it took.

    Where parts take long, restrained steps are tried once in the place of all that are left; not where an
    unstable equilibrium was met: which way a column buckles would depend on round-off.
    """
    current, reached, steps, tried = problem.start, 0.0, 0, False
    soon = problem.iterations + PATIENCE
    while reached < 1.0:
        goal = min(1.0, reached + part)
        try:
            current = problem.newton(current, goal, tolerance)
        except NotConvergedError as failure:
            if problem.iterations > soon and not tried and not problem.met_unstable:
                tried = True
                if (found := _restrained(problem, current, tolerance)) is not None:
                    return found, steps + 1
            part *= SMALLER
            if part < SMALLEST_PART:
                raise failure
            continue
        reached, steps, part = goal, steps + 1, 2.0 * part
    return current, steps
