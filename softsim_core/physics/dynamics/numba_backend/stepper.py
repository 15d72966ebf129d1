"""Compiled time step: assembly, elimination of the free nodes, and motion.

All constant data are planned once. With a factor, a step is one compiled call, and its result equals that of
scipy_backend up to rounding; by iteration, up to a tolerance in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softsim_core.base import Array, FactorisationError, IndexArray
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.dynamics import Condensed, FreeTurning, StepReport
from softsim_core.physics.dynamics.numba_backend.cells import assemble_tangent
from softsim_core.physics.dynamics.numba_backend.elements import CLAMPED, EXACT
from softsim_core.physics.dynamics.numba_backend.elimination import (
    DirectElimination,
    DividedElimination,
    Elimination,
    IterativeElimination,
)
from softsim_core.physics.dynamics.numba_backend.layout import (
    NO_STIFFNESS,
    ActuatorStiffness,
    Motion,
    StepInputs,
)
from softsim_core.physics.dynamics.numba_backend.prepare import prepare
from softsim_core.physics.dynamics.numba_backend.responses import Responses, motion_of
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.linalg import (
    LANES,
    ROWS,
    Division,
    Plan,
    clear,
    divide_tree,
    elimination_order,
    factor_cost,
    graph_of,
    matrix_layout,
    plan,
    usable_threads,
    with_space_for,
)
from softsim_core.physics.mechanics import MOVED, Control, Model, Parameters, Rows, State, no_rows

MANY = 2000
"""Number of free nodes above which iteration is considered: with fewer, a factor stays in the cache."""

CROSSING = 250.0
"""Flops per number of a factor above which reading it ten times is faster than computing it again.

Measured with some 25 Gflop/s, 10 GB/s and eight iterations per step.
"""


TOUCHING = 30
"""Additional solutions in a step with contact: its contacts are found in ten rounds of three."""


def planned_elimination(
    model: Model, actuators: Actuators, iterative: bool | None, touching: bool, threads: int
) -> Elimination:
    """Return an elimination for a model, by a factor or by iteration.

    `iterative` None: the faster of both, given whether bodies touch.
    """
    iterations: list[tuple[Plan, Plan]] = []
    divisions: list[Division] = []

    def divide_layout(layout: Plan) -> Plan:
        divisions.append(divide_tree(layout))
        return with_space_for(layout, divisions[0], ROWS) if len(divisions[0].above) else layout

    def lay_out(count: int, edges: IndexArray, beside: IndexArray, reduced_size: int) -> Plan:
        graph = graph_of(count, edges)
        order = elimination_order(graph)
        chosen = iterative
        if chosen is None:
            flops, numbers = factor_cost(graph, order) if count > MANY else (0.0, 0.0)
            solutions = reduced_size + 1 + touching * TOUCHING
            chosen = flops > CROSSING * numbers * solutions
        if not chosen:
            return divide_layout(plan(count, edges, beside, reduced_size, LANES, ROWS, order))
        preconditioner = divide_layout(plan(count, edges, edges[:0], 0, LANES, ROWS, order))
        matrix = matrix_layout(preconditioner.position, edges, beside, reduced_size, LANES)
        iterations.append((matrix, preconditioner))
        return matrix

    prepared = prepare(model, actuators, lay_out)
    division = divisions[0]
    if not len(division.above):
        threads = 1
    if iterations:
        return IterativeElimination(model, actuators, prepared, *iterations[0], division, threads)
    if len(division.above):
        return DividedElimination(model, actuators, prepared, division, threads)
    return DirectElimination(model, actuators, prepared)


class NumbaStepper:
    """Stepper that plans once and then steps in compiled code.

    Args:
        model, actuators: The model and its actuators.
        iterative: Whether the free nodes are eliminated by conjugate gradients; None: where that is faster.
            Steps that need a factor anyway, and static tangents, use a second stepper, which is planned on
            first use.
        touching: Whether steps have contacts, which need many solutions each.
        like: Stepper of another copy of the scene: its plan and its buffers are reused, so only one of the
            two may be in a step at a time. If None, or if its pattern differs, the plan is made again.
        threads: Threads of a step of a large mesh; None: see linalg.threads.usable_threads. The result does
            not depend on their number.
    """

    name = "numba"
    compiled = True

    def __init__(
        self,
        model: Model,
        actuators: Actuators,
        iterative: bool | None = None,
        touching: bool = False,
        like: NumbaStepper | None = None,
        threads: int | None = None,
    ) -> None:
        self.model, self.actuators = model, actuators
        self._threads = usable_threads() if threads is None else threads
        earlier = None if like is None else like._elimination
        shared = earlier.of_another_copy(model, actuators) if isinstance(earlier, DirectElimination) else None
        self._elimination: Elimination = shared or planned_elimination(
            model, actuators, iterative, touching, self._threads
        )
        self._factoring: NumbaStepper | None = None  # never itself: a cycle would outlive its user
        self._prepared = self._elimination.prepared
        every = (*actuators.spans(), *actuators.passive_spans())
        self._plain = [each for each in every if each[1].start >= self._prepared.rows.compiled[0]]
        self._soft = bool(model.spring.any())
        self._turning = FreeTurning(model)
        self._weight = model.weight
        self._tuned: tuple[list[list[float]], float, float] | None = None
        self._before, self._free, self._start = (model.empty_state() for _ in range(3))
        self._responses = self._elimination.responses
        self._assemble_tangent = OneSignature(assemble_tangent)

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance the state by one dt, in place.

        Where the matrix is not positive, the step is repeated without the stiffness of pressed surfaces, then
        without the stress that the last linear solve found; see StepReport.fallback.
        """
        control.check(len(self.model.joints), len(self.model.rest))
        moved = state.extra.get(MOVED)
        if moved is None:
            return self._step(state, control, parameters)
        before = self._start
        before.copy_from(state)
        pressed = self.actuators.surface_stiffness(state, self.actuators.multipliers(state))
        report = self._step(state, control, parameters, moved, pressed)
        if not report.positive and pressed:
            state.copy_from(before)
            report = replace(self._step(state, control, parameters, moved), fallback=1)
        if not report.positive:
            state.copy_from(before)
            report = replace(self._step(state, control, parameters), fallback=2)
        moved[:] = state.positions - before.positions
        return report

    def _step(
        self,
        state: State,
        control: Control,
        parameters: Parameters,
        moved: Array | None = None,
        pressed: Sequence[Array] = (),
    ) -> StepReport:
        """Advance by one step; for `moved` see fem.cells.LinearMove, for `pressed` PlannedCells.press."""
        model, data = self.model, self._prepared
        lag = model.dt + parameters.rayleigh_stiffness
        self._tune(parameters, lag)
        self._responses = self._elimination.responses
        external = control.forces + self._weight
        straining = self._turning.lagging(state, control, parameters.rayleigh_stiffness / lag)
        if self._soft:
            external -= model.spring[:, None] * (state.positions + lag * straining - model.rest)
        clear(data.work.factor)
        external += data.cells.fill(state, True, model.dt * lag, lag, straining, moved, model.dt / lag)
        if pressed:
            external += data.cells.press(pressed, straining, lag, model.dt * lag)
        if model.coupling is not None:
            external -= parameters.rayleigh_mass * (model.coupling.matrix @ state.velocities)
            data.cells.couple(model.coupling.blocks, 1.0 + model.dt * parameters.rayleigh_mass)
        transmissions = self.actuators.transmissions_of_step(state, control, model)
        data.rows.command[:], data.rows.compliance[:] = transmissions.command, transmissions.compliance
        for rows, own, entries in self._plain:
            data.rows.value[own] = rows.values(model, state)
            data.rows.coefficient[entries] = rows.coefficients(model, state)
        try:
            inputs = StepInputs(
                motion_of(state), straining, external, control.targets, control.base_shift,
                transmissions.lower, transmissions.upper, model.dt, lag, parameters.rayleigh_mass,
            )  # fmt: skip
            acting = data.acting(self._stiffness(state, model.dt * lag, moved))
            speed, *seconds = self._elimination.advance(inputs, acting)
        except FactorisationError:
            factoring = self._with_factor()
            report = factoring._step(state, control, parameters, moved, pressed)
            self._responses = factoring._responses
            return report
        if self._plain:
            self.actuators.report(model, state, data.rows.before, data.rows.multiplier)
        times = {stage: 1e3 * each for stage, each in zip(self._elimination.stages, seconds, strict=True)}
        # a pivot that is not positive leaves a NaN in all later results
        return StepReport(
            float(speed),
            times,
            data.cells.count_inverted(state.positions),
            positive=bool(speed == speed),
            linear_iterations=self._elimination.iterations,
        )

    def _stiffness(self, state: State, scale: float, moved: Array | None) -> ActuatorStiffness:
        """Return the stiffness of taut actuators times `scale`; none if `moved` is None."""
        if moved is None or not len(self.actuators):
            return NO_STIFFNESS
        multipliers = self.actuators.multipliers(state)
        rows, weight = self.actuators.geometric_stiffness(
            self.model, state, multipliers, without_surfaces=True
        )
        if not len(weight):
            return NO_STIFFNESS
        return ActuatorStiffness(*rows.with_kernel_types(), scale * weight)

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> NumbaFreeMotion:
        """Return the unconstrained step, ready for impulses on constraint rows."""
        self._before.copy_from(state)
        report = self.step(state, control, parameters)
        self._free.copy_from(state)
        return NumbaFreeMotion(self._responses, state, self._before, self._free, report)

    def without_mass(self) -> NumbaStepper | None:
        """Return a stepper of the model without mass, with this one's plan; see Stepper.

        None: this one does not factor by a single thread.
        """
        if not isinstance(self._elimination, DirectElimination):
            return None
        model = self.model
        light = replace(
            model,
            mass=np.zeros_like(model.mass),
            dt=1.0,
            joints=tuple(replace(joint, inertia=0.0) for joint in model.joints),
            coupling=None if model.coupling is None else model.coupling.scale(0.0),
        )
        stepper = NumbaStepper(light, self.actuators, like=self)
        return stepper if stepper._elimination.prepared.work is self._prepared.work else None

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """Return the von Mises stress of each element in [Pa], shape (m,)."""
        data = self._prepared
        return data.cells.von_mises(state, parameters.materials, data.work)

    def static_tangent(
        self, state: State, parameters: Parameters, forces: Array, pressed: Sequence[Array] = ()
    ) -> NumbaStaticTangent:
        """Return the static tangent at a state under node forces (n, 3) in [N]."""
        if not isinstance(self._elimination, DirectElimination):
            return self._with_factor().static_tangent(state, parameters, forces, pressed)
        model = self.model
        self._tune(parameters, model.dt + parameters.rayleigh_stiffness)
        motion, loads = motion_of(state), forces + self._weight
        if self._soft:
            loads -= model.spring[:, None] * (state.positions - model.rest)
        positive = self._factor_tangent(state, loads, EXACT, pressed)
        if not positive:  # no Cholesky factor: the state is not stable
            self._factor_tangent(state, loads, CLAMPED)
        return NumbaStaticTangent(self._responses, motion, positive)

    def is_stable(self, state: State, parameters: Parameters, forces: Array) -> bool:
        """Return whether an equilibrium under node forces (n, 3) in [N], all but elastic ones, is stable.

        Where actuators add to the pattern of the step, their positive stiffness counts; elsewhere False may
        be an equilibrium that they stabilise.
        """
        multipliers = self.actuators.multipliers(state)
        pressed = self.actuators.surface_stiffness(state, multipliers)
        taut = self._stiffness(state, 1.0, state.extra.get(MOVED))
        self._tune(parameters, self.model.dt + parameters.rayleigh_stiffness)
        if not self._factor_tangent(state, forces, EXACT, pressed, taut):
            return False
        solved = np.ones(self.model.reduced_size, dtype=np.bool_)
        joints = 6 * len(self.model.frame_names) + np.arange(len(self.model.joints))
        solved[np.setdiff1d(joints, joints[self.model.compliant_joints])] = False
        stiffness = self._responses.condense(no_rows(), motion_of(state)).stiffness
        return bool((np.linalg.eigvalsh(stiffness[np.ix_(solved, solved)]) > 0.0).all())

    def _factor_tangent(
        self,
        state: State,
        loads: Array,
        tangent: int,
        pressed: Sequence[Array] = (),
        taut: ActuatorStiffness = NO_STIFFNESS,
    ) -> bool:
        """Factor the static tangent in the panels; return whether it is positive on the free nodes."""
        data = self._prepared
        clear(data.work.factor)
        moved = None if tangent == CLAMPED else state.extra.get(MOVED)
        loads = loads + data.cells.fill(state, tangent == CLAMPED, moved=moved)
        if pressed:
            data.cells.press(pressed, np.zeros_like(loads))
        self._assemble_tangent(
            motion_of(state), loads, self.model.spring, tangent, data.cells.arrays, taut, data.arrays
        )
        assert isinstance(self._elimination, DirectElimination)
        self._elimination.factor()
        return self._responses.positive()

    def _tune(self, parameters: Parameters, lag: float) -> None:
        """Update the arrays if tunable parameters have changed."""
        tuned = ([list(values.values()) for values in parameters.materials], lag, parameters.rayleigh_mass)
        if tuned == self._tuned:
            return
        self._tuned = tuned
        model, data = self.model, self._prepared
        data.cells.tune(parameters.materials)
        inertia = (1.0 + model.dt * parameters.rayleigh_mass) * model.mass
        data.nodes.diagonal[:] = inertia + model.dt * lag * model.spring
        self._elimination.update_parameters(lambda: self._at_rest(parameters, lag))

    def _at_rest(self, parameters: Parameters, lag: float) -> StepInputs:
        """Return the inputs of a step from rest; see Elimination.update_parameters."""
        rest, data, h = self.model.rest_state(), self._prepared, self.model.dt
        clear(data.work.factor)
        still = np.zeros_like(rest.positions)
        data.cells.fill(rest, True, h * lag, lag, still, None, h / lag)
        if self.model.coupling is not None:
            data.cells.couple(self.model.coupling.blocks, 1.0 + h * parameters.rayleigh_mass)
        none, targets = np.zeros(len(self.actuators)), np.zeros(len(self.model.joints))
        return StepInputs(
            motion_of(rest), still, still, targets, 0.0, none, none, h, lag, parameters.rayleigh_mass
        )

    def _with_factor(self) -> NumbaStepper:
        """Return the stepper that factors: itself, or a second one, made on first use."""
        if isinstance(self._elimination, DirectElimination):
            return self
        if self._factoring is None:
            self._factoring = NumbaStepper(self.model, self.actuators, iterative=False, threads=self._threads)
        return self._factoring


class NumbaFreeMotion:
    """Unconstrained step of the compiled stepper, and the responses to impulses on it."""

    def __init__(
        self, responses: Responses, state: State, before: State, free: State, report: StepReport
    ) -> None:
        self.state, self.before, self.report = state, before, report
        self.violations = responses.prepared.rows.violation.copy()
        self.defect: Array | None = None
        self._responses, self._free = responses, free

    def compliance(self, rows: Rows) -> Array:
        """Return the compliance H A^-1 H^T of actuators and rows in [1/kg], shape (c + r, c + r)."""
        return self._responses.compliance(rows.with_kernel_types(), motion_of(self.before))

    def correct(self, impulses: Array) -> StepReport:
        """Add the effect of impulses [N s] on the rows to the free motion, in place."""
        state, free = self.state, self._free
        state.velocities[:], state.reduced_velocities[:] = free.velocities, free.reduced_velocities
        state.joint_positions[:], state.joint_efforts[:] = free.joint_positions, free.joint_efforts
        speed = self._responses.correct(state, self.before, impulses)
        self.defect = self._responses.defect
        if MOVED in state.extra:
            state.extra[MOVED][:] = state.positions - self.before.positions
        inverted = self._responses.prepared.cells.count_inverted(state.positions)
        return replace(self.report, top_speed=speed, inverted=inverted)


class NumbaStaticTangent:
    """Static tangent of the compiled stepper."""

    def __init__(self, responses: Responses, motion: Motion, positive: bool) -> None:
        self._responses, self._motion, self.positive = responses, motion, positive

    def condense(self, rows: Rows) -> Condensed:
        """Return the tangent with the free nodes eliminated, and the compliance of rows."""
        return self._responses.condense(rows.with_kernel_types(), self._motion)
