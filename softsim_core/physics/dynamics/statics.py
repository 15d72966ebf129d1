"""Static equilibrium: Newton's method with the exact tangent, line search and load steps; its derivatives.

With S, Z and W of actuator_statics.condense_tangent, u the free frames and the joints on drives, p all other
joints, and D the stiffness of the drives, a force f on the rows and a change dc of the commands give

    du = S_uu^-1 (Z_u f + D dc_u - S_up dc_p),    dy = Z_u^T du + Z_p^T dc_p + W f

Source: implicit function theorem on the equilibrium of softsim_core.physics.dynamics.statics.

With q the free nodes, free frames and compliant joints, x = x(q) the nodes, J = dx/dq and f the forces on
nodes (elastic, weight, soft fixings, external, actuators), the residual is r(q) = J^T f + drive springs, and
an iteration solves

    (J^T K J - G) dq = r,    K = -df/dx (exact),    G = (dJ^T/dq) f of the rigid regions

and adds dq, all or part of it (see WAYS). Actuators add H^T t to f, their geometric stiffness to the tangent,
and the equations s - q + c t to the system; see actuator_statics.

Where commands lead on from a known equilibrium, steps of the same model without mass come first, if the back
end compiles steps: each is an iteration with the tangent of the step, and takes a fraction of the time. What
they find is checked with the exact tangent.

A load that is too far away is approached in parts: joint targets and base shift change linearly, and the
residual of the first state is removed linearly. Where that takes long, inertia restrains the steps instead
(see StaticProblem.take_restrained_steps). Layers, fibres and rods are axially stiff and flexible in bending:
they rotate far under small loads, which would take many parts. So restrained steps come first where nothing
else moves; where joints move, parts follow the branch of equilibria that the joints lead to. In models of
rods alone, cells rotate in a step without strain (see fem.RotatingSteps); then one part mostly suffices.

The first state may be unstable under any constant load, because bodies may be drawn far from rest; then
restrained steps come first, too, or the model is released before joints and base move. The result is checked:
the last step is tiny, the equilibrium is stable, and no element was inverted.

Source: Deuflhard 2004, Newton methods for nonlinear problems (error-oriented line search, continuation).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array, FactorisationError, IndexArray, NotConvergedError
from softsim_core.physics.actuation import Actuators, GeometricStiffness, drive_stiffness
from softsim_core.physics.dynamics.actuator_statics import ActuatedFactors, on_nodes, rows_on_unknowns
from softsim_core.physics.dynamics.assembly import (
    Unknowns,
    diagonal_matrix,
    generalised_forces,
    jacobian,
    node_stiffness,
    static_forces,
    static_tangent,
)
from softsim_core.physics.dynamics.memory import relaxing_groups
from softsim_core.physics.dynamics.stepper import Condensed, MasslessStepper
from softsim_core.physics.fem import (
    BlockPattern,
    LinearMove,
    RotatingSteps,
    element_group,
    inverted_cells,
)
from softsim_core.physics.fem.materials import RotatedHooke, StrainMaterial, material, rest_stiffness
from softsim_core.physics.linalg import Factoriser, LinearSolver, choose_linear_solver
from softsim_core.physics.mechanics import (
    MOVED,
    Control,
    Model,
    Parameters,
    RigidRegion,
    State,
    Transmissions,
    distribute,
    join_rows,
    nearest_rotation,
    step_stress_name,
)


@dataclass(frozen=True, slots=True, eq=False)
class StaticResponse:
    """Derivatives of an equilibrium with r rows and b degrees of freedom of frames and joints.

    Attributes:
        rows_by_command: Shift of each row per unit of each joint's command, shape (r, j).
        rows_by_row: Shift of each row per unit of force on each row in [m/N], shape (r, r).
        reduced_by_command: Change of frames and joints per unit of each joint's command, shape (b, j).
        reduced_by_row: Change of frames and joints per unit of force on each row, shape (b, r).
    """

    rows_by_command: Array
    rows_by_row: Array
    reduced_by_command: Array
    reduced_by_row: Array


def response_of(model: Model, condensed: Condensed) -> StaticResponse:
    """Return the response, from the condensed static tangent.

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
"""Fraction of a Newton step below which a line search stops."""

WAYS = {"whole": 12, "turning": 12, "rotated": 12, "damped": 25, "distant": 12}
"""Iteration strategies and their largest number of iterations.

- whole: Newton steps;
- turning: steps in which cells rotate without strain, with the distant tangent while they are long;
- rotated: whole steps from the equilibrium of the same bodies with Hooke's law in rotated axes, whose steps
  survive rotations of whole cells; the first has the distant tangent;
- damped: Newton steps with a line search;
- distant: steps with the distant tangent, which survive a crumpled start, then whole steps.

The first whole step has the distant tangent, too, where the exact one is not positive: a small error of the
volume gives nearly incompressible cells a large pressure.

Models of rods alone use the second and the first; where a command changes, all but the third, as a path of
commands is followed by few whole steps. Others use all but the second.
"""

NEAR = 0.1
"""Step length, as a share of an element's size, of an iteration that is close to the equilibrium."""

LONG = {"turning": 1.0, "whole": np.inf, "rotated": np.inf, "distant": NEAR}
"""Step length, in sizes of an element, after which the next step has the distant tangent again."""

MOST_MASSLESS = 61
"""Largest number of steps without mass."""

CHECKED_EVERY, SHORTER = 10, 0.1
"""Number of them in which their length has to fall to this share."""

CLOSER, SAME_PULL = 0.01, 1e-8
"""Their last length as a share of the tolerance, since it shrinks linearly; last change of multipliers."""

TURNS = 3
"""Largest number of rotating steps with the distant tangent."""

HEAVIEST, LIGHTEST = 1.0, 1e-6
"""Masses over step squared while a model is released, relative to that of the model's step.

The first is that at the beginning; below the second, the mass is left out.
"""

LET_GO = 300
"""Largest number of iterations in which a model is released."""

RESTRAINED = 200
"""Largest number of iterations with steps restrained by inertia."""

FARTHEST = 2.0
"""Largest displacement in a restrained step, in sizes of an element."""

RESTRAINT = 1e-3
"""Mass over step squared of the first restrained step, relative to that of the model's step."""

LESS, MORE = 0.2, 8.0
"""Bounds of the factor of that mass from step to step, the second where the tangent is not positive."""

SINGULAR = "the tangent is singular (is every body attached?)"
NO_FORCES = "the elements are crushed or stretched beyond what has forces and a tangent"


class LinearEnd(NamedTuple):
    """End of a step as its linear solve sees it.

    Stiff and thin cells have a large stress at the true end, where the step rotates them. The geometric
    stiffness there is that of the stress at this end instead.

    Attributes:
        move: Displacement of the nodes.
        forces: Static forces on the nodes in [N], shape (n, 3).
    """

    move: LinearMove
    forces: Array


class Leading(NamedTuple):
    """Steps of a model without mass, and whether what they find is checked for stability.

    Attributes:
        steps: The steps, see Stepper.without_mass.
        checked: False: an unstable equilibrium is not noticed.
    """

    steps: MasslessStepper
    checked: bool = True


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
        self.constrained = len(actuators)
        self.at = Unknowns(model)
        self._solver = solver
        self.matrices = Factoriser(solver, int((self.at.solved >= self.at.first_reduced).sum()))
        self.iterations, self.met_unstable = 0, False
        self.start = _copy(model, state)
        self.start.velocities[:] = 0.0
        self.start.reduced_velocities[:] = 0.0
        if (moved := self.start.extra.get(MOVED)) is not None:
            moved[:] = 0.0
        # while the problem is solved, the position of an actuator's joint represents its command
        self.start.joint_positions[actuators.joint] = actuators.commands_of(
            actuators.values(model, self.start), self._multipliers(self.start)
        )
        self.first_targets = self.start.joint_positions.copy()
        self.first_targets[actuators.multiplied] = self.start.joint_efforts[actuators.multiplied]
        self.first_shift = float(self.start.base_shift[0])
        self._driven = bool(
            (control.targets != self.first_targets).any() or control.base_shift != self.first_shift
        )
        self.bends_under_load = not self._driven and any(
            isinstance(group.material, StrainMaterial) for group in model.groups
        )
        self.only_rods = all(isinstance(group.material, StrainMaterial) for group in model.filling)
        inputs = (state.buffer, control.targets, control.forces, control.base_shift)
        if not all(np.isfinite(each).all() for each in inputs):
            raise NotConvergedError("a position, force or target is not finite", 0.0, 0, float("nan"))
        self.first_residual = np.zeros(self.at.size + self.constrained)

    def begin(self) -> None:
        """Store the residual of the first state, which load steps remove.

        Raises:
            NotConvergedError: the first state has no forces.
        """
        try:
            self.first_residual = self._residual(self.start, 0.0)[0]
        except np.linalg.LinAlgError as error:  # from the rotations of elements
            raise NotConvergedError(NO_FORCES, 0.0, 0, float("nan")) from error
        self.first_residual[self.at.size :] = 0.0
        if not np.isfinite(self.first_residual).all():
            raise NotConvergedError(NO_FORCES, 0.0, 0, float("nan"))

    @cached_property
    def size(self) -> float:
        """Mean size of an element in [m]."""
        volumes = np.concatenate([np.zeros(0)] + [group.volumes for group in self.model.filling])
        return float(np.cbrt(volumes.mean())) if len(volumes) else 0.0

    @cached_property
    def _pattern(self) -> BlockPattern:
        """Sparsity pattern of the cells."""
        return BlockPattern(len(self.model.rest), [group.cells for group in self.model.groups])

    @cached_property
    def _hookean(self) -> StaticProblem | None:
        """The same problem with Hooke's law in rotated axes in all cells of rubber.

        None: there are none, or joints move, and its equilibrium might be on another branch.
        """
        if self._driven:
            return None
        model, materials = self.model, list(self.parameters.materials)
        groups, hooke = [], material("corotational")
        for group in model.groups:
            if not isinstance(group.material, StrainMaterial | RotatedHooke):
                for k in np.unique(group.parameter_set).tolist():
                    law, values = group.material, self.parameters.materials[k]
                    at_rest = rest_stiffness(law, np.array([values[name] for name in law.names]))
                    materials[k] = {"young_modulus": at_rest.young, "poisson_ratio": at_rest.poisson}
                turned = element_group(
                    group.element, hooke, model.rest, group.cells, group.body, group.numbers
                )
                group = replace(turned, parameter_set=group.parameter_set, fills=group.fills)
            groups.append(group)
        if all(one is other for one, other in zip(groups, model.groups, strict=True)):
            return None
        hookean = StaticProblem(
            replace(model, groups=tuple(groups)),
            self.control,
            replace(self.parameters, materials=materials),
            self.start,
            self.actuators,
            self._solver,
        )
        hookean.begin()
        return hookean

    @cached_property
    def lever(self) -> Array:
        """Displacement per unknown: that of its region's nodes (RMS, in [m]), 1 for nodes."""
        lever = np.append(np.ones(self.at.size), np.zeros(self.constrained))
        motion_subspace = self.model.motion_subspace(self.start)
        for region in self.model.regions:
            for k in region.reduced.tolist():
                moved = motion_subspace.jacobian(k, self.start.positions[region.nodes])
                lever[self.at.first_reduced + k] = max(float(np.sqrt((moved**2).sum(axis=1).mean())), 1e-6)
        return lever

    def lead(self, leading: Leading, tolerance: float) -> State | None:
        """Return the equilibrium to which commands lead, by steps of the model without mass.

        None: commands do not change, the steps do not get short enough, or what they find is unstable.
        """
        massless = leading.steps
        if not self._driven:
            return None
        state = _copy(self.model, self.start)
        forces, parameters = self.control.forces + self.model.weight, _undamped(self.parameters)
        control = replace(self.control, forces=forces)
        for k, _ in relaxing_groups(self.model):
            state.extra[step_stress_name(k)][:] = 0.0  # at rest, all stress that relaxes has done so
        close = min(tolerance, max(CLOSER * tolerance, 1e-11))
        earlier = np.inf
        for number in range(MOST_MASSLESS):
            state.velocities[:], state.reduced_velocities[:] = 0.0, 0.0
            before, pulled = state.positions.copy(), self._multipliers(state)
            report = massless.step(state, control, parameters)
            self.iterations += 1
            size = float(np.abs(state.positions - before).max(initial=0.0))
            if number % CHECKED_EVERY == 0:
                if not (report.positive and size < SHORTER * earlier):
                    return None
                earlier = size
            now = self._multipliers(state)  # friction depends on those of the iteration before
            change = np.abs(now - pulled).max(initial=0.0)
            if size <= close and change <= SAME_PULL * np.abs(now).max(initial=0.0):
                break
        else:
            return None
        state.velocities[:], state.reduced_velocities[:] = 0.0, 0.0
        if not leading.checked:
            return state
        if (self._find_inverted(state) & ~self._find_inverted(self.start)).any():
            return None
        _, pulls, elastic = self._residual(state, 1.0)
        stable = massless.is_stable(state, parameters, forces + pulls)
        if not stable and self.constrained:  # taut actuators may be what keeps it in place
            stable = self._factors(state, pulls + elastic, 1.0, self._stiffness(state)).positive
        return state if stable else None

    def newton(self, before: State, goal: float, tolerance: float) -> State:
        """Return the equilibrium at the load fraction `goal`, trying each strategy from an earlier one."""
        failure: NotConvergedError | None = None
        ways = [way for way in WAYS if self.only_rods or way != "turning"]
        if self.only_rods and not self._driven:
            ways = ["turning", "whole"]
        for way in ways:
            try:
                if way == "rotated":
                    if self._hookean is None:
                        continue
                    near = self._hookean.nearby(before, goal, self)
                    return self._iterate(before, goal, tolerance, way, near)
                return self._iterate(before, goal, tolerance, way)
            except NotConvergedError as refused:
                failure = refused
            except np.linalg.LinAlgError as error:  # of the rotations of elements
                failure = NotConvergedError(NO_FORCES, goal, self.iterations, float("nan"))
                failure.__cause__ = error
        assert failure is not None
        raise failure

    def nearby(self, before: State, goal: float, problem: StaticProblem) -> State:
        """Return a state close to the equilibrium of `problem` at the load fraction `goal`.

        It is that of this problem's laws, up to NEAR element sizes; `problem` counts the iterations.
        """
        self.iterations = 0
        try:
            return self._iterate(before, goal, NEAR * self.size, "whole")
        finally:
            problem.iterations += self.iterations

    def _iterate(
        self, before: State, goal: float, tolerance: float, way: str, first: State | None = None
    ) -> State:
        """Return the equilibrium at the load fraction `goal`, by one strategy from `first`.

        None: from the state that follows `before` to first order.
        """
        state = self._predict_state(before, goal) if first is None else first
        turning = way == "turning"
        distant = way in ("turning", "rotated", "distant")
        sizes: list[float] = []
        end: LinearEnd | None = None
        for _ in range(WAYS[way]):
            residual, pulls, forces = self._residual(state, goal)
            stiffness = self._stiffness(state, end, distant)
            loads = pulls + (forces if end is None else end.forces)
            factors = self._factors(state, loads, goal, stiffness)
            if way == "whole" and not (sizes or factors.positive):
                distant = True
                stiffness = self._stiffness(state, distant=True)
                factors = self._factors(state, loads, goal, stiffness)
            step = self._solve(factors, residual, state)
            sizes.append(self._size(step))
            if not sizes[-1] < np.inf:
                raise self._failure(SINGULAR, goal, residual)
            if sizes[-1] <= tolerance and not distant:
                self._accept(state, before, factors, goal, residual)
                self._move(state, step)
                return state
            started = _copy(self.model, state)
            if way == "damped":
                part = self._search(state, step, factors, goal)
                if not part:
                    raise self._failure("the line search stalled", goal, residual)
                end = self._linear_end(started, part * step, forces, stiffness)
                continue
            if turning and (len(sizes) > TURNS if distant else not factors.positive):
                raise self._failure("rotating steps do not lead to a stable place", goal, residual)
            if way == "whole" and sizes[0] > self.size and self._hookean is not None:
                raise self._failure("the first step rotates cells", goal, residual)
            if way == "whole" and len(sizes) > 2 and sizes[-1] > 0.5 * sizes[0]:
                raise self._failure("whole steps do not get shorter", goal, residual)
            self._move(state, step, turning)
            distant = distant and sizes[-1] > LONG[way] * self.size
            end = None if distant or turning else self._linear_end(started, step, forces, stiffness)
        raise self._failure(f"no convergence in {WAYS[way]} iterations", goal, residual)

    def _accept(self, state: State, before: State, factors: Any, goal: float, residual: Array) -> None:
        """Refuse an equilibrium that is unstable or that was reached by inverting elements."""
        if not factors.positive:
            self.met_unstable = True
            raise self._failure("only an unstable one", goal, residual)
        if (self._find_inverted(state) & ~self._find_inverted(before)).any():
            raise self._failure("only one with elements turned inside out", goal, residual)

    def _find_inverted(self, state: State) -> Any:
        """Return which elements are inverted, shape (m,)."""
        flags = [inverted_cells(group, state.positions) for group in self.model.filling]
        return np.concatenate([np.zeros(0, dtype=bool), *flags])

    @property
    def starts_stable(self) -> bool:
        """Whether the first state would be stable under constant forces that balance it."""
        forces = static_forces(self.model, self.start, self.parameters, self.control.forces)
        try:
            return bool(self._factors(self.start, forces, 0.0, self._stiffness(self.start)).positive)
        except NotConvergedError:
            return False

    def let_go(self, tolerance: float) -> State:
        """Return the equilibrium that the first state reaches under the whole load, however far away it is.

        The steps are like time steps, but each starts from rest: the mass over the square of a step is added
        to the distant tangent. It is increased where a step leads too far and decreased otherwise, until
        Newton's method converges.

        Source: Kelley and Keyes 1998, Convergence analysis of pseudo-transient continuation.
        """
        state, goal = _copy(self.model, self.start), 1.0
        inertia, share = self._inertia(), HEAVIEST
        residual, pulls, forces = self._residual(state, goal)
        while self.iterations < LET_GO:
            stiffness = self._stiffness(state, distant=True) + share * inertia
            factors = self._factors(state, pulls + forces, goal, stiffness)
            step, before = self._solve(factors, residual, state), _copy(self.model, state)
            self._move(state, step)
            after, *loads = self._residual(state, goal)
            size, remaining = self._size(step), self._size(self._solve(factors, after, state))
            if factors.positive and remaining <= max(size, tolerance):
                residual, (pulls, forces), share = after, loads, 0.1 * share
                if share < LIGHTEST or size <= tolerance:
                    try:
                        return self.newton(state, goal, tolerance)
                    except NotConvergedError:
                        share = HEAVIEST
            else:
                state.copy_from(before)
                share *= 8.0
        raise self._failure("what was let go found no place to stay", goal, residual)

    def take_restrained_steps(self, before: State, tolerance: float) -> State:
        """Return the equilibrium under the whole load from an earlier one, by steps that inertia restrains.

        The exact tangent, with the stress that the last step found, is increased by the mass over the square
        of a step. The mass is large enough to make the sum positive; it is increased where steps are long,
        decreased where they are short, and zero in the end. A step need not reduce the residual: each
        rotation first stretches cells that are axially stiff and flexible in bending, which would stall a
        line search. The cells of models of rods alone rotate without strain instead.

        Source: Kelley and Keyes 1998, Convergence analysis of pseudo-transient continuation; Magisano,
        Leonetti, Garcea 2017, How to improve efficiency and robustness of the Newton method.
        """
        state, goal, inertia, share = self._predict_state(before, 1.0), 1.0, self._inertia(), RESTRAINT
        farthest = FARTHEST * self.size or np.inf
        end: LinearEnd | None = None
        last = self.iterations + RESTRAINED
        while self.iterations < last:
            residual, pulls, forces = self._residual(state, goal)
            stiffness, loads = self._stiffness(state, end), pulls + (forces if end is None else end.forces)
            factors = self._factors(state, loads, goal, stiffness + share * inertia)
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
            share *= min(max(math.sqrt(size / farthest), LESS), MORE)
            share = share if share >= LIGHTEST else 0.0
            started = _copy(self.model, state)
            self._move(state, step, self.only_rods)
            end = None if self.only_rods else self._linear_end(started, step, forces, stiffness)
        raise self._failure(f"no convergence in {RESTRAINED} restrained steps", goal, residual)

    def _inertia(self) -> sp.csr_matrix:
        """Return the mass of the nodes over the square of the model's step in [N/m], shape (3 n, 3 n)."""
        return sp.diags(np.repeat(self.model.mass, 3) / self.model.dt**2, format="csr")

    def finish(self, state: State) -> float:
        """Set the joint efforts of an equilibrium and return the largest unbalanced force in [N]."""
        residual = self._residual(state, 1.0)[0]
        multipliers = self._multipliers(state)
        state.joint_efforts[self.at.prescribed] = -residual[self.at.fixed]
        self.actuators.set_multipliers(state, multipliers)
        self.actuators.measure(self.model, state)
        if (moved := state.extra.get(MOVED)) is not None:
            moved[:] = 0.0
        self.actuators.settle(self.model, state, self.control.targets)
        spring = self.at.drive * (self.control.targets - state.joint_positions)
        state.joint_efforts[self.at.compliant] = spring[self.at.compliant]
        return self._measure_imbalance(residual)

    def _predict_state(self, before: State, goal: float) -> State:
        """Return the state with prescribed joints and bases at `goal` and all else following to first order.

        Nodes that share a short cell with a moving region rotate with it rigidly and add their own
        displacement. The cell would be torn if one end rotated while the other moved straight.
        """
        at, model = self.at, self.model
        state = _copy(model, before)
        state.joint_positions[at.prescribed] = self._targets(goal)[at.prescribed]
        state.base_shift[0] = self.first_shift + goal * (self.control.base_shift - self.first_shift)
        model.place_regions(state)
        driven = self._compute_driven_displacement(before, state).ravel()
        if driven.any():
            residual, pulls, forces = self._residual(before, goal)
            stiffness = self._stiffness(before)
            factors = self._factors(before, pulls + forces, goal, stiffness)
            stiffness = stiffness + on_nodes(model, self._geometric(before))
            spread = (stiffness @ driven).reshape(-1, 3)
            residual[: at.size] -= generalised_forces(model, at, before, spread)
            self._move(state, self._solve(factors, residual, before))
        return state

    def _compute_driven_displacement(self, before: State, state: State) -> Array:
        """Return the first-order displacement by joints and bases in [m], (n, 3).

        Place `beside` in `state`.
        """
        model, first = self.model, 6 * len(self.model.frame_names)
        shifted = _copy(model, before)
        shifted.base_shift[0] = state.base_shift[0]
        change = state.joint_positions - before.joint_positions
        subspace, driven = model.motion_subspace(before), np.zeros_like(before.positions)
        for region, nodes in self._beside:
            start, both = before.positions[region.nodes], np.concatenate([region.nodes, nodes])
            driven[region.nodes] = shifted.positions[region.nodes] - start
            driven[nodes] = _moved_along(before.positions[nodes], start, shifted.positions[region.nodes])
            driven[nodes] -= before.positions[nodes]
            for k in region.reduced[region.reduced >= first].tolist():
                driven[both] += change[k - first] * subspace.jacobian(k, before.positions[both])
            state.positions[nodes] = _moved_along(
                before.positions[nodes], start, state.positions[region.nodes]
            )
        return driven

    def _targets(self, fraction: float) -> Array:
        return np.asarray(self.first_targets + fraction * (self.control.targets - self.first_targets))

    def _residual(self, state: State, fraction: float) -> tuple[Array, Array, Array]:
        """Return the residual (d + c,) at a load fraction, and the node forces of actuators and all others.

        The residual has the generalised forces, then s - q + c t of the actuators. The forces are in [N],
        shape (n, 3).
        """
        model, at = self.model, self.at
        forces = static_forces(model, state, self.parameters, self.control.forces)
        residual, pulls = np.zeros(at.size + self.constrained), np.zeros_like(forces)
        if self.constrained:
            actuators, multipliers = self.actuators, self._multipliers(state)
            rows = actuators.rows(model, state)
            pulls, turns = distribute(rows, multipliers, len(model.rest), model.reduced_size)
            residual[at.first_reduced : at.size] = turns
            transmissions = actuators.transmissions(model, state, state.joint_positions[actuators.joint])
            residual[at.size :] = actuators.values(model, state) - transmissions.command
            residual[at.size :] += transmissions.compliance * multipliers
        residual[: at.size] += generalised_forces(model, at, state, forces + pulls)
        residual[at.joints] += at.drive * (self._targets(fraction) - state.joint_positions)
        return residual - (1.0 - fraction) * self.first_residual, pulls, forces

    def _stiffness(self, state: State, end: LinearEnd | None = None, distant: bool = False) -> sp.csr_matrix:
        """Return the `node_stiffness` at a state, where the last step ended."""
        last = None if end is None else end.move
        return node_stiffness(
            self.model, state, self.parameters, distant=distant, last=last, pattern=self._pattern
        )

    def _linear_end(self, start: State, step: Array, forces: Array, stiffness: sp.csr_matrix) -> LinearEnd:
        """Return the linear end of a step of all unknowns, from the forces and the stiffness at its start."""
        moved = jacobian(self.model, self.at, start) @ step[: self.at.size]
        changed = forces - (stiffness @ moved).reshape(-1, 3)
        return LinearEnd(LinearMove(start.positions, moved.reshape(-1, 3)), changed)

    def _geometric(self, state: State) -> GeometricStiffness:
        """Return the geometric stiffness of the actuators."""
        return self.actuators.geometric_stiffness(self.model, state, self._multipliers(state))

    def _multipliers(self, state: State) -> Array:
        """Return the multipliers of the actuators, shape (c,)."""
        return self.actuators.multipliers(state)

    def _factors(self, state: State, forces: Array, fraction: float, stiffness: sp.csr_matrix) -> Any:
        """Return the factorised tangent of the residual on the solved unknowns; see `node_stiffness`."""
        at, mapping = self.at, jacobian(self.model, self.at, state)
        matrix = static_tangent(self.model, at, state, forces, stiffness, mapping)
        if self.constrained:
            geometric = self._geometric(state)
            rows = join_rows([self.actuators.rows(self.model, state), geometric.rows])
            spread = rows_on_unknowns(self.model, at, mapping, rows).on_unknowns
            across = spread[self.constrained :]
            matrix = matrix + across.T @ diagonal_matrix(geometric.weight) @ across
        self.iterations += 1
        try:
            factors = self.matrices.factor(matrix[at.solved][:, at.solved])
            if not self.constrained:
                return factors
            commands, actuators = self._targets(fraction)[self.actuators.joint], self.actuators
            here = _copy(self.model, state)

            def laws(multipliers: Array) -> Transmissions:
                actuators.set_multipliers(here, multipliers)
                return actuators.transmissions(self.model, here, commands)

            on_solved = spread[: self.constrained, at.solved]
            return ActuatedFactors(factors, on_solved, laws, actuators.passive_size > 0)
        except FactorisationError:
            residual = self._residual(state, fraction)[0]
            raise self._failure(SINGULAR, fraction, residual) from None

    def _solve(self, factors: Any, residual: Array, state: State) -> Array:
        at, step = self.at, np.zeros(len(residual))
        if not self.constrained:
            step[at.solved] = factors.solve(residual[at.solved])
        else:
            step[at.solved], step[at.size :] = factors.solve(
                residual[at.solved], residual[at.size :], self._multipliers(state)
            )
        return step

    def _search(self, state: State, step: Array, factors: Any, fraction: float) -> float:
        """Take the largest part of a Newton step after which the next one, with the same tangent, is shorter.

        Return the part, 0 if there is none.

        The measure is in metres for every unknown, so that a stiff drive does not dominate soft material.
        Source: Deuflhard 2004, natural monotonicity.
        """
        before, size, part = _copy(self.model, state), self._size(step), 1.0
        while part >= SHORTEST_STEP:
            self._move(state, part * step)
            remaining = self._size(self._solve(factors, self._residual(state, fraction)[0], state))
            if remaining <= (1.0 - 0.25 * part) * size:
                return part
            state.copy_from(before)
            part /= 2.0
        return 0.0

    @cached_property
    def _beside(self) -> list[tuple[RigidRegion, IndexArray]]:
        return _beside(self.model)

    @cached_property
    def _rotating_steps(self) -> RotatingSteps:
        return RotatingSteps(self.model.filling, self.at.free, len(self.model.rest), self._solver)

    def _move(self, state: State, step: Array, turning: bool = False) -> None:
        """Add a step of all unknowns; frames and joints (`turning`: cells, too) rotate without strain."""
        first, before = self.at.first_reduced, state.positions.copy()
        self.model.displace(state, step[:first].reshape(-1, 3), step[first : self.at.size])
        if turning and len(self.at.free):
            state.positions[self.at.free] += self._rotating_steps.correction(before, state.positions)
        self.actuators.set_multipliers(state, self._multipliers(state) + step[self.at.size :])

    def _size(self, step: Array) -> float:
        """Return the largest displacement of a step in [m]; NaN counts as infinite."""
        return float(np.nan_to_num(np.abs(step * self.lever), nan=np.inf).max(initial=0.0))

    def _measure_imbalance(self, residual: Array) -> float:
        solved = self.at.solved
        return float(np.abs(residual[solved] / self.lever[solved]).max(initial=0.0))

    def _failure(self, reason: str, fraction: float, residual: Array) -> NotConvergedError:
        return NotConvergedError(reason, fraction, self.iterations, self._measure_imbalance(residual))


def _beside(model: Model) -> list[tuple[RigidRegion, IndexArray]]:
    """Return, for each region, the free nodes that share a short cell with it."""
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
    """Return points (k, 3) moved by the rigid motion that fits nodes (n, 3) from `before` to `after` best."""
    if not len(points):
        return points
    first, last = before.mean(axis=0), after.mean(axis=0)
    return np.asarray(last + (points - first) @ nearest_rotation(before - first, after - last).T)


def _undamped(parameters: Parameters) -> Parameters:
    return replace(parameters, rayleigh_stiffness=0.0, rayleigh_mass=0.0)


def _copy(model: Model, state: State) -> State:
    copy = model.empty_state()
    copy.copy_from(state)
    return copy


SMALLEST_PART = 1.0 / 1024.0
"""Fraction of the load below which a load step is not reduced further."""

SMALLER = 1.0 / 4.0
"""Factor by which a load step that found no equilibrium is reduced."""

PATIENCE = 60
"""Number of iterations of load steps after which restrained steps are tried."""

MOST_IN_PARTS = 1000
"""Number of iterations after those after which load steps end without an equilibrium.

The hardest cases of the tests that end with one take 60.
"""


@dataclass(frozen=True, slots=True, eq=False)
class StaticSolution:
    """An equilibrium.

    Attributes:
        state: The state at rest; joint efforts are those of the drives.
        iterations: Number of linear solves over all load steps.
        load_steps: Number of parts in which the load was applied; 1 if Newton's method converged at once.
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
    leading: Leading | None = None,
) -> StaticSolution:
    """Return the stable equilibrium under a constant control that is reached from `state`.

    If there are several, it is not always the one that a slowly growing load leads to.

    Args:
        model: The model.
        state: Initial state, unchanged. Velocities are ignored; fixed nodes stay in place.
        control: Joint targets in [rad] or [m], external node forces in [N], base shift in [m].
        parameters: Material parameters; damping does not affect an equilibrium.
        actuators: Actuators of the joints; None: there are none. Contacts are not included.
        tolerance: Largest displacement of the last Newton step in [m].
        solver: The linear solver; None: the default.
        leading: Steps of the model without mass; None: there are none.

    Raises:
        NotConvergedError: there is none, none that is stable, or it could not be reached from `state`.
    """
    chosen, acting = solver or choose_linear_solver(), actuators or Actuators()
    with np.errstate(all="ignore"):  # far from an equilibrium numbers overflow: such steps are refused
        problem = StaticProblem(model, control, parameters, state, acting, chosen)
        if leading is not None and (end := problem.lead(leading, tolerance)) is not None:
            return StaticSolution(end, problem.iterations, 1, problem.finish(end))
        problem.begin()
        try:
            current, steps = problem.newton(problem.start, 1.0, tolerance), 1
        except NotConvergedError:
            part, stable, found = SMALLER, problem.starts_stable, None
            if not stable or (problem.bends_under_load and not problem.met_unstable):
                found = _try_restrained_steps(problem, problem.start, tolerance)
            if found is None and not stable:
                standing = replace(control, targets=problem.first_targets, base_shift=problem.first_shift)
                first = StaticProblem(model, standing, parameters, state, acting, chosen)
                first.begin()
                settled, spent, part = first.let_go(tolerance), problem.iterations + first.iterations, 1.0
                problem = StaticProblem(model, control, parameters, settled, acting, chosen)
                problem.begin()
                problem.iterations = spent
            current, steps = (found, 1) if found is not None else _in_parts(problem, tolerance, part)
        residual = problem.finish(current)
    return StaticSolution(current, problem.iterations, steps, residual)


def _try_restrained_steps(problem: StaticProblem, before: State, tolerance: float) -> State | None:
    """Return the equilibrium under the whole load by restrained steps from a state; None: there is none."""
    try:
        return problem.take_restrained_steps(before, tolerance)
    except (NotConvergedError, np.linalg.LinAlgError):  # the latter from the rotations of elements
        return None


def _in_parts(problem: StaticProblem, tolerance: float, part: float) -> tuple[State, int]:
    """Return the equilibrium under the whole load, applied in parts, and the number of parts.

    Where the parts take long, restrained steps are tried once for the whole remaining load. They are not
    tried where an unstable equilibrium was met, because the direction in which a column buckles would depend
    on rounding.
    """
    current, reached, steps, attempted = problem.start, 0.0, 0, False
    soon = problem.iterations + PATIENCE
    while reached < 1.0:
        goal = min(1.0, reached + part)
        try:
            current = problem.newton(current, goal, tolerance)
        except NotConvergedError as failure:
            if problem.iterations > soon and not attempted and not problem.met_unstable:
                attempted = True
                if (found := _try_restrained_steps(problem, current, tolerance)) is not None:
                    return found, steps + 1
            part *= SMALLER
            if part < SMALLEST_PART or problem.iterations > soon + MOST_IN_PARTS:
                raise failure
            continue
        reached, steps, part = goal, steps + 1, 2.0 * part
    return current, steps
