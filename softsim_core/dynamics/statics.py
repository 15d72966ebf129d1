"""Static equilibrium of a model: Newton's method with the exact tangent, line search and load stepping.

With q the free nodes, free frames and compliant joints, x = x(q) the nodes, J = dx/dq and f the forces on
nodes (elastic, weight, soft fixings, external, cables), the residual is r(q) = J^T f + drive springs, and an
iteration solves

    (J^T K J - G) dq = r,    K = -df/dx (exact),    G = (dJ^T/dq) f of the rigid zones

and adds dq, all or part of it (see WAYS). Cables add their tensions t to f, the stiffness of their
directions under tension to K, and their travels to what is solved; see cable_statics. A load that is too far
is approached in parts: joint targets and base shift move evenly, and the residual of the first state is taken
away evenly. What comes out is checked: the last step is tiny, the equilibrium stable, and no element was
turned inside out.

Source: Deuflhard 2004, Newton methods for nonlinear problems (error-oriented line search, continuation).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from softsim_core.actuation.cable import Cables
from softsim_core.arrays import Array
from softsim_core.dynamics.assembly import (
    Unknowns,
    jacobian,
    node_stiffness,
    static_forces,
    static_tangent,
)
from softsim_core.dynamics.cable_statics import CableFactors, cable_rows, cable_stiffness
from softsim_core.dynamics.scipy_step import factorised
from softsim_core.dynamics.stepper import Inputs, Parameters
from softsim_core.errors import NotConvergedError
from softsim_core.fem.corotational import deformation_gradients
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.pose import rotation_exp
from softsim_core.mechanics.state import State

SMALLEST_PART = 1.0 / 1024.0
"""A load step below this fraction of the load is given up."""

SHORTEST_STEP = 1.0 / 256.0
"""A line search below this fraction of a Newton step is given up."""

WAYS = {"whole": 12, "damped": 25, "warped": 12}
"""Ways to an equilibrium, quickest first, and their most iterations: whole Newton steps; damped ones; steps
with the rotations of the elements frozen, which survive a crumpled start, then whole ones when near."""

NEAR = 0.1
"""Frozen rotations are left when a step is shorter than this part of an element's size."""

SINGULAR = "the tangent is singular (is every body attached?)"


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
    inputs: Inputs,
    parameters: Parameters,
    *,
    cables: Cables | None = None,
    tolerance: float = 1e-11,
) -> StaticSolution:
    """The stable equilibrium under constant inputs that is reached from `state`.

    Args:
        model: The model.
        state: Where to start; it is not changed. Velocities do not matter; held nodes stay where they are.
        inputs: Joint targets in [rad] or [m], external node forces in [N], base shift in [m].
        parameters: Material; damping has no part in an equilibrium.
        cables: The cables that joints pull; contacts have no part in it.
        tolerance: The last Newton step moves nothing by more than this, in [m].

    Raises:
        NotConvergedError: there is none, none that is stable, or it could not be reached from `state`.
    """
    problem = _Problem(model, inputs, parameters, state, cables)
    current, reached, part, steps = problem.start, 0.0, 1.0, 0
    while reached < 1.0:
        goal = min(1.0, reached + part)
        try:
            current = problem.newton(current, goal, tolerance)
        except NotConvergedError as failure:
            part /= 4.0
            if part < SMALLEST_PART:
                raise failure
            continue
        reached, steps, part = goal, steps + 1, 2.0 * part
    residual = problem.finish(current)
    return StaticSolution(current, problem.iterations, steps, residual)


class _Problem:
    """Residual and tangent of one static problem, and the Newton iteration on them."""

    def __init__(
        self, model: Model, inputs: Inputs, parameters: Parameters, state: State, cables: Cables | None
    ) -> None:
        self.model, self.inputs, self.parameters, self.cables = model, inputs, parameters, cables
        self.held = 0 if cables is None else len(cables)
        self.lame = parameters.lame[model.element_body]
        self.at = Unknowns(model)
        self.iterations = 0
        self.start = _copy(model, state)
        self.start.velocities[:] = 0.0
        self.start.border_velocities[:] = 0.0
        self.first_targets = self.start.joint_positions.copy()
        if cables is not None:
            forced = cables.joint[cables.by_force]
            self.first_targets[forced] = self.start.joint_efforts[forced]
        self.first_shift = float(self.start.base_shift[0])
        self.lever = self._levers()
        self.near = NEAR * float(np.cbrt(model.elements.volumes.mean())) if len(self.lame) else 0.0
        self.first_residual = np.zeros(self.at.size + self.held)
        self.first_residual = self._residual(self.start, 0.0)[0]
        self.first_residual[self.at.size :] = 0.0
        if not np.isfinite(self.first_residual + self.inputs.targets.sum() + self.inputs.base_shift).all():
            raise NotConvergedError("a position, force or target is not finite", 0.0, 0, float("nan"))

    def _levers(self) -> Array:
        """What turns each unknown into a displacement: how far it moves its zone's nodes in [m], else 1."""
        lever = np.append(np.ones(self.at.size), np.zeros(self.held))
        screws = self.model.screws(self.start)
        for zone in self.model.zones:
            for k in zone.border.tolist():
                moved = screws.jacobian(k, self.start.positions[zone.nodes])
                lever[self.at.first_border + k] = max(float(np.sqrt((moved**2).sum(axis=1).mean())), 1e-6)
        return lever

    def newton(self, before: State, goal: float, tolerance: float) -> State:
        """The equilibrium at the load fraction `goal`, from an earlier one: each way in turn."""
        failure: NotConvergedError | None = None
        for way in WAYS:
            try:
                return self._iterated(before, goal, tolerance, way)
            except NotConvergedError as refused:
                failure = refused
        assert failure is not None
        raise failure

    def _iterated(self, before: State, goal: float, tolerance: float, way: str) -> State:
        state, warped = self._predicted(before, goal), way == "warped"
        sizes: list[float] = []
        for _ in range(WAYS[way]):
            residual, forces = self._residual(state, goal)
            factors = self._factors(state, forces, goal, warped)
            step = self._solve(factors, residual, state)
            sizes.append(self._size(step))
            if not sizes[-1] < np.inf:
                raise self._failure(SINGULAR, goal, residual)
            if sizes[-1] <= tolerance and not warped:
                self._accept(state, before, factors, goal, residual)
                self._move(state, step)
                return state
            if way == "damped":
                if not self._search(state, step, factors, goal):
                    raise self._failure("the line search stalled", goal, residual)
                continue
            if way == "whole" and len(sizes) > 2 and sizes[-1] > 0.5 * sizes[0]:
                raise self._failure("whole steps do not get shorter", goal, residual)
            self._move(state, step)
            warped = warped and sizes[-1] > self.near
        raise self._failure(f"no convergence in {WAYS[way]} iterations", goal, residual)

    def _accept(self, state: State, before: State, factors: Any, goal: float, residual: Array) -> None:
        """Refuse an equilibrium in which nothing would stay, or that was reached through matter."""
        if not _positive(factors):
            raise self._failure("only an unstable one", goal, residual)
        if (self._inverted(state) & ~self._inverted(before)).any():
            raise self._failure("only one with elements turned inside out", goal, residual)

    def _inverted(self, state: State) -> Any:
        """Which elements are inside out, shape (m,)."""
        corners = state.positions[self.model.elements.nodes]
        gradients = deformation_gradients(corners, self.model.elements.gradients)
        return np.linalg.det(gradients) < 0.0

    def finish(self, state: State) -> float:
        """Set the joint efforts of an equilibrium; returns the largest unbalanced force in [N]."""
        residual, _ = self._residual(state, 1.0)
        tensions = self._tensions(state)
        state.joint_efforts[self.at.prescribed] = -residual[self.at.fixed]
        if self.cables is not None:
            self.cables.report(self.model, state, tensions)
        spring = self.at.drive * (self.inputs.targets - state.joint_positions)
        state.joint_efforts[self.at.compliant] = spring[self.at.compliant]
        return self._unbalanced(residual)

    def _predicted(self, before: State, goal: float) -> State:
        """Prescribed joints and bases at `goal`; all else follows them to first order."""
        at, model = self.at, self.model
        state = _copy(model, before)
        state.joint_positions[at.prescribed] = self._targets(goal)[at.prescribed]
        state.base_shift[0] = self.first_shift + goal * (self.inputs.base_shift - self.first_shift)
        model.place_zones(state)
        driven = (state.positions - before.positions).ravel()
        if driven.any():
            residual, forces = self._residual(before, goal)
            stiffness = self._stiffness(before)
            residual[: at.size] -= jacobian(model, at, before).T @ (stiffness @ driven)
            self._move(state, self._solve(self._factors(before, forces, goal), residual, before))
        return state

    def _targets(self, fraction: float) -> Array:
        return np.asarray(self.first_targets + fraction * (self.inputs.targets - self.first_targets))

    def _residual(self, state: State, fraction: float) -> tuple[Array, Array]:
        """Generalised forces and gaps of cables (d + c,) at a part of the load, node forces (n, 3) in [N]."""
        model, at = self.model, self.at
        forces = static_forces(model, state, self.parameters.lame, self.inputs.forces)
        residual = np.zeros(at.size + self.held)
        if self.cables is not None:
            spread, gaps = cable_rows(model, at, self.cables, state)
            tensions = self._tensions(state)
            forces = forces + (spread.on_nodes.T @ tensions).reshape(-1, 3)
            residual[at.first_border : at.size] = spread.on_border.T @ tensions
            residual[at.size :] = gaps
        residual[: at.size] += jacobian(model, at, state).T @ forces.ravel()
        residual[at.joints] += at.drive * (self._targets(fraction) - state.joint_positions)
        return residual - (1.0 - fraction) * self.first_residual, forces

    def _stiffness(self, state: State, warped: bool = False) -> sp.csr_matrix:
        """Exact tangent -df/dx on the nodes, shape (3 n, 3 n)."""
        stiffness = node_stiffness(self.model, state, self.parameters.lame, warped)
        if self.cables is not None:
            stiffness = stiffness + cable_stiffness(self.model, self.cables, state, self._tensions(state))
        return stiffness

    def _tensions(self, state: State) -> Array:
        """Tensions of the cables in [N], shape (c,)."""
        return state.joint_efforts[self.cables.joint] if self.cables is not None else np.zeros(0)

    def _factors(self, state: State, forces: Array, fraction: float, warped: bool = False) -> Any:
        """Factorised tangent of the residual on the unknowns that are solved for."""
        at = self.at
        matrix = static_tangent(self.model, at, state, forces, self._stiffness(state, warped))
        self.iterations += 1
        try:
            factors = factorised(matrix[at.solved][:, at.solved])
            if self.cables is None:
                return factors
            rows, _ = cable_rows(self.model, at, self.cables, state)
            return CableFactors(factors, rows.on_unknowns[:, at.solved], self._bounds(fraction))
        except RuntimeError:  # exactly singular
            residual, _ = self._residual(state, fraction)
            raise self._failure(SINGULAR, fraction, residual) from None

    def _solve(self, factors: Any, residual: Array, state: State) -> Array:
        at, step = self.at, np.zeros(len(residual))
        if self.cables is None:
            step[at.solved] = factors.solve(residual[at.solved])
        else:
            step[at.solved], step[at.size :] = factors.solve(
                residual[at.solved], residual[at.size :], self._tensions(state)
            )
        return step

    def _bounds(self, fraction: float) -> tuple[Array, Array]:
        """Bounds of the tensions in [N], shapes (c,)."""
        assert self.cables is not None
        return self.cables.bounds(self._targets(fraction))

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
        at, model = self.at, self.model
        state.positions[at.free] += step[: at.first_border].reshape(-1, 3)
        for f in range(len(model.frame_names)):
            shift, turn = step[at.first_border + 6 * f :][:6].reshape(2, 3)
            state.frame_positions[f] += shift
            state.frame_rotations[f] = rotation_exp(turn) @ state.frame_rotations[f]
        state.joint_positions += step[at.joints]
        if self.cables is not None:
            state.joint_efforts[self.cables.joint] += step[at.size :]
        model.place_zones(state)

    def _size(self, step: Array) -> float:
        """Largest displacement of a step in [m]; NaN counts as endless."""
        return float(np.nan_to_num(np.abs(step * self.lever), nan=np.inf).max(initial=0.0))

    def _unbalanced(self, residual: Array) -> float:
        solved = self.at.solved
        return float(np.abs(residual[solved] / self.lever[solved]).max(initial=0.0))

    def _failure(self, reason: str, fraction: float, residual: Array) -> NotConvergedError:
        return NotConvergedError(reason, fraction, self.iterations, self._unbalanced(residual))


def _positive(factors: Any) -> bool:
    """Whether all pivots of a factorisation are positive: the equilibrium is stable."""
    return bool((factors.U.diagonal() > 0.0).all()) and bool((factors.perm_r == factors.perm_c).all())


def _copy(model: Model, state: State) -> State:
    copy = model.empty_state()
    copy.copy_from(state)
    return copy
