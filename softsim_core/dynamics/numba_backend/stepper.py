"""The fast time step: compiled assembly into the panels of a supernodal multifrontal Cholesky factorisation.

One step is one compiled call (assemble, factor, finish); everything that does not change is planned once.
It computes what scipy_step computes, to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softsim_core.actuation.actuators import Actuators
from softsim_core.actuation.compiled.kinds import CompiledKinds
from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.free_turning import FreeTurning
from softsim_core.dynamics.numba_backend.actuator_rows import (
    add_rows,
    add_stiffness,
    hold_rows,
    report_rows,
)
from softsim_core.dynamics.numba_backend.cells import assemble_cells
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.elements import CLAMPED, EXACT, FROZEN, assemble_nodes
from softsim_core.dynamics.numba_backend.inversion import count_inverted, oriented
from softsim_core.dynamics.numba_backend.kinematics import (
    advance_reduced,
    jacobians,
    motion_subspace,
    place_regions,
    slides,
)
from softsim_core.dynamics.numba_backend.layout import (
    ActuatorRows,
    ActuatorStiffness,
    Cells,
    Kinematics,
    Motion,
    Nodes,
    Work,
)
from softsim_core.dynamics.numba_backend.prepare import prepare
from softsim_core.dynamics.numba_backend.reduced import eliminate_reduced, solve_reduced
from softsim_core.dynamics.numba_backend.responses import Responses, motion_of
from softsim_core.dynamics.numba_backend.tangent import assemble_tangent
from softsim_core.dynamics.report import StepReport
from softsim_core.dynamics.stepper import Condensed
from softsim_core.kernels import OneSignature
from softsim_core.linalg.cholesky import factor, solve_backward
from softsim_core.linalg.layout import Tree, clear
from softsim_core.linalg.simd import steady_seconds
from softsim_core.mechanics.control import Control, Parameters
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.rows import Rows, no_rows
from softsim_core.mechanics.state import MOVED, State


@kernel
def assemble(
    motion: Motion, straining: Array, external: Array, h: float, lag: float, rayleigh_mass: float,
    kinematics: Kinematics, cells: Cells, nodes: Nodes, rows: ActuatorRows, kinds: CompiledKinds,
    stiffness: ActuatorStiffness, tree: Tree, work: Work,
) -> None:  # fmt: skip
    """Forces, matrix and right-hand side of the step, into `work`, to what is there of paired cells."""
    x, v = motion.positions, motion.velocities
    motion_subspace(motion, kinematics, work)
    jacobians(motion, nodes, work)
    work.forces[:, :3] = external
    for n in range(len(x)):
        for i in range(3):
            work.ahead[n, i] = x[n, i] + lag * straining[n, i]
    assemble_cells(x, h * lag, CLAMPED, FROZEN, cells, nodes, work)
    assemble_nodes(v, h, rayleigh_mass, nodes, work)
    add_rows(h, motion, kinematics, rows, kinds, nodes, tree, work)
    add_stiffness(stiffness, straining, motion.reduced_velocities, nodes, tree, work)


@kernel
def finish(
    motion: Motion, targets: Array, base_shift: float, lower: Array, upper: Array, h: float, lag: float,
    kinematics: Kinematics, tree: Tree, nodes: Nodes, rows: ActuatorRows, kinds: CompiledKinds, work: Work,
) -> float:  # fmt: skip
    """Solve reduced and interior, advance, report joint efforts; returns the largest speed, or NaN."""
    joints, velocities = len(motion.joint_positions), motion.reduced_velocities
    size, right = len(velocities), len(work.factor.schur)
    first = size - joints
    known = np.zeros(size, dtype=np.bool_)
    change = work.factor.solution[3 * len(nodes.free) :]
    for j in range(joints):
        b, stiffness = first + j, kinematics.stiffness[j]
        gap = targets[j] - motion.joint_positions[j]
        work.factor.schur[b, b] += kinematics.inertia[j] + h * lag * stiffness
        work.factor.schur[b, right] += h * stiffness * (gap - lag * velocities[b])
        if stiffness == 0.0:
            known[b] = True
            change[b] = gap / h - velocities[b]
    for c in range(len(rows.joint)):
        change[first + rows.joint[c]] = 0.0  # moves no frame
    eliminate_reduced(work.factor.schur, known, change, work.scratch)
    hold_rows(h, targets, lower, upper, change, size, rows, work.scratch)
    solve_reduced(known, change, work.scratch)
    solve_backward(tree, work.factor)
    speed, finite = 0.0, True
    for f in range(len(nodes.free)):
        node, place = nodes.free[f], nodes.unknown[f]
        for i in range(3):
            motion.velocities[node, i] += work.factor.solution[place + i]
            motion.positions[node, i] += h * motion.velocities[node, i]
            speed = max(speed, abs(motion.velocities[node, i]))
            finite = finite and motion.velocities[node, i] == motion.velocities[node, i]
    for j in range(joints):
        b = first + j
        if known[b]:
            impulse = -work.factor.schur[b, right]
            for a in range(right):
                impulse += (work.factor.schur[a, b] if a < b else work.factor.schur[b, a]) * change[a]
            motion.joint_efforts[j] = impulse / h
    for b in range(size):
        velocities[b] += change[b]
        if slides(b, motion, kinematics):
            speed = max(speed, abs(velocities[b]))
        finite = finite and velocities[b] == velocities[b]
    advance_reduced(h, motion)
    motion.base_shift[0] = base_shift
    for j in range(joints):
        if known[first + j]:
            motion.joint_positions[j] = targets[j]  # exactly, without rounding
        else:
            motion.joint_efforts[j] = kinematics.stiffness[j] * (targets[j] - motion.joint_positions[j])
    place_regions(motion, kinematics, nodes, work)
    report_rows(h, motion, kinematics, rows, kinds)
    return speed if finite else np.nan


@kernel
def advance(
    motion: Motion, straining: Array, external: Array, targets: Array, base_shift: float, lower: Array,
    upper: Array, h: float, lag: float, rayleigh_mass: float, kinematics: Kinematics, cells: Cells,
    nodes: Nodes, rows: ActuatorRows, kinds: CompiledKinds, stiffness: ActuatorStiffness, tree: Tree,
    work: Work, corners: IndexArray,
) -> tuple[float, int, float, float, float]:  # fmt: skip
    """One whole step.

    Returns:
        The largest speed, how many of the elements `corners` (m, 4) are inside out, and the seconds for
        assembly, factorisation and the rest.
    """
    started = steady_seconds()
    assemble(
        motion, straining, external, h, lag, rayleigh_mass, kinematics, cells, nodes, rows, kinds, stiffness,
        tree, work,
    )  # fmt: skip
    assembled = steady_seconds()
    factor(tree, work.factor)
    factored = steady_seconds()
    speed = finish(
        motion, targets, base_shift, lower, upper, h, lag, kinematics, tree, nodes, rows, kinds, work
    )
    inverted = count_inverted(motion.positions, corners)
    return speed, inverted, assembled - started, factored - assembled, steady_seconds() - factored


_NO_STIFFNESS = ActuatorStiffness(*no_rows(), np.zeros(0))

STAGES = ("assemble", "factor", "solve")
"""Stages of a step."""


class NumbaStepper:
    """Plan once, then step in one compiled call."""

    name = "numba"
    compiled = True

    def __init__(self, model: Model, actuators: Actuators) -> None:
        self.model, self.actuators = model, actuators
        self._prepared = prepare(model, actuators)
        self._plain = actuators.spans()[1 if self._prepared.rows.compiled[0] else 0 :]
        self._corners = oriented(model)
        self._soft = bool(model.spring.any())
        self._turning = FreeTurning(model)
        self._weight = model.mass[:, None] * model.gravity
        self._tuned: tuple[list[list[float]], float, float] | None = None
        self._before, self._free, self._start = (model.empty_state() for _ in range(3))
        self._responses = Responses(model, actuators, self._prepared)
        self._advance, self._factor = OneSignature(advance), OneSignature(factor)
        self._assemble_tangent = OneSignature(assemble_tangent)

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """See Stepper."""
        control.check(len(self.model.joints), len(self.model.rest))
        moved = state.extra.get(MOVED)
        if moved is None:
            return self._step(state, control, parameters)
        before = self._start
        before.copy_from(state)
        pressed = self.actuators.surface_stiffness(state, state.joint_efforts[self.actuators.joint])
        report = self._step(state, control, parameters, moved, pressed)
        if not report.positive and pressed:
            state.copy_from(before)
            report = self._step(state, control, parameters, moved)
        if not report.positive:
            state.copy_from(before)
            report = self._step(state, control, parameters)
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
        """One step; `moved`: see fem.assembly.cell_stiffness, `pressed`: see PairedCells.press."""
        model, data = self.model, self._prepared
        lag = model.dt + parameters.rayleigh_stiffness
        self._tune(parameters, lag)
        external = control.forces + self._weight
        straining = self._turning.straining(state.positions, state.velocities)
        if self._soft:
            external -= model.spring[:, None] * (state.positions + lag * state.velocities - model.rest)
        clear(data.work.factor)
        if data.cells.paired:
            external += data.cells.paired.fill(
                state, parameters.materials, True, model.dt * lag, lag, straining, moved, model.dt / lag
            )
        if pressed:
            external += data.cells.paired.press(pressed, straining, lag, model.dt * lag)
        bounds = self.actuators.bounds(control.targets)
        for group, own, entries in self._plain:
            data.rows.value[own] = group.values(model, state)
            data.rows.coefficient[entries] = group.coefficients(model, state)
        speed, inverted, *seconds = self._advance(
            motion_of(state), straining, external, control.targets, control.base_shift, *bounds, model.dt,
            lag, parameters.rayleigh_mass, data.kinematics, data.cells.arrays, data.nodes,
            data.rows, data.kinds, self._stiffness(state, model.dt * lag, moved), data.tree, data.work,
            self._corners,
        )  # fmt: skip
        if self._plain:
            self.actuators.report(model, state, data.rows.before, data.rows.multiplier)
        inverted += data.cells.paired.folded(state.positions)
        times = {stage: 1e3 * each for stage, each in zip(STAGES, seconds, strict=True)}
        # a pivot that is not positive leaves a NaN in all that follows
        return StepReport(float(speed), times, inverted, bool(speed == speed))

    def _stiffness(self, state: State, scale: float, moved: Array | None) -> ActuatorStiffness:
        """What taut actuators add to the matrix, times `scale`: where cells take the stress they found."""
        if moved is None or not len(self.actuators):
            return _NO_STIFFNESS
        multipliers = state.joint_efforts[self.actuators.joint]
        rows, weight = self.actuators.geometric_stiffness(
            self.model, state, multipliers, without_surfaces=True
        )
        return ActuatorStiffness(*rows.checked(), scale * weight)

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> NumbaFreeMotion:
        """See Stepper."""
        self._before.copy_from(state)
        report = self.step(state, control, parameters)
        self._free.copy_from(state)
        return NumbaFreeMotion(self._responses, state, self._before, self._free, report, self._corners)

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """See Stepper."""
        data = self._prepared
        return data.cells.von_mises(state, parameters.materials, data.work)

    def static_tangent(
        self, state: State, parameters: Parameters, forces: Array, pressed: Sequence[Array] = ()
    ) -> NumbaStaticTangent:
        """See Stepper."""
        model = self.model
        self._tune(parameters, model.dt + parameters.rayleigh_stiffness)
        motion, loads = motion_of(state), forces + self._weight
        if self._soft:
            loads -= model.spring[:, None] * (state.positions - model.rest)
        positive = self._factor_tangent(state, parameters, loads, EXACT, pressed)
        if not positive:  # no Cholesky factor: on its way, the state is not stable
            self._factor_tangent(state, parameters, loads, CLAMPED)
        return NumbaStaticTangent(self._responses, motion, positive)

    def _factor_tangent(
        self,
        state: State,
        parameters: Parameters,
        loads: Array,
        tangent: int,
        pressed: Sequence[Array] = (),
    ) -> bool:
        """Factor the static tangent in the panels; returns whether it is positive on the free nodes."""
        data = self._prepared
        clear(data.work.factor)
        if data.cells.paired:
            moved = None if tangent == CLAMPED else state.extra.get(MOVED)
            loads = loads + data.cells.paired.fill(
                state, parameters.materials, tangent == CLAMPED, moved=moved
            )
        if pressed:
            data.cells.paired.press(pressed, np.zeros_like(loads))
        self._assemble_tangent(
            motion_of(state), loads, self.model.spring, tangent, data.kinematics, data.cells.arrays,
            data.nodes, data.work,
        )  # fmt: skip
        self._factor(data.tree, data.work.factor)
        return self._responses.positive()

    def _tune(self, parameters: Parameters, lag: float) -> None:
        """Take over tunable parameters when they have changed."""
        tuned = ([list(values.values()) for values in parameters.materials], lag, parameters.rayleigh_mass)
        if tuned == self._tuned:
            return
        self._tuned = tuned
        model, data = self.model, self._prepared
        data.cells.tune(parameters.materials)
        inertia = (1.0 + model.dt * parameters.rayleigh_mass) * model.mass
        data.nodes.diagonal[:] = inertia + model.dt * lag * model.spring


class NumbaFreeMotion:
    """See FreeMotion."""

    def __init__(
        self,
        responses: Responses,
        state: State,
        before: State,
        free: State,
        report: StepReport,
        corners: IndexArray,
    ) -> None:
        self.state, self.before, self.report = state, before, report
        self.violations = responses.prepared.rows.violation.copy()
        self._responses, self._free, self._corners = responses, free, corners

    def compliance(self, rows: Rows) -> Array:
        """See FreeMotion."""
        return self._responses.compliance(rows.checked(), motion_of(self.before))

    def correct(self, impulses: Array) -> StepReport:
        """See FreeMotion."""
        state, free = self.state, self._free
        state.velocities[:], state.reduced_velocities[:] = free.velocities, free.reduced_velocities
        state.joint_positions[:], state.joint_efforts[:] = free.joint_positions, free.joint_efforts
        speed = self._responses.correct(state, self.before, impulses)
        if MOVED in state.extra:
            state.extra[MOVED][:] = state.positions - self.before.positions
        inverted = count_inverted(state.positions, self._corners)
        inverted += self._responses.prepared.cells.paired.folded(state.positions)
        return replace(self.report, top_speed=speed, inverted=inverted)


class NumbaStaticTangent:
    """See StaticTangent."""

    def __init__(self, responses: Responses, motion: Motion, positive: bool) -> None:
        self._responses, self._motion, self.positive = responses, motion, positive

    def condensed(self, rows: Rows) -> Condensed:
        """See StaticTangent."""
        return self._responses.condensed(rows.checked(), self._motion)
