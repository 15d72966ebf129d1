"""The fast time step: compiled assembly into the panels of a supernodal multifrontal Cholesky factorisation.

One step is one compiled call (assemble, factor, finish); everything that does not change is planned once.
It computes what scipy_step computes, to rounding.
"""

from __future__ import annotations

import numpy as np

from softsim_core.actuation.cable import Cables
from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.assembly import Unknowns
from softsim_core.dynamics.cable_statics import border_stiffness
from softsim_core.dynamics.fast.border import eliminate_border, solve_border
from softsim_core.dynamics.fast.cables import add_lines, hold_lines, report_lines
from softsim_core.dynamics.fast.compile import OneSignature, kernel
from softsim_core.dynamics.fast.compliance import apply_impulses, respond
from softsim_core.dynamics.fast.elements import (
    assemble_free,
    assemble_mixed,
    assemble_nodes,
    von_mises_stress,
)
from softsim_core.dynamics.fast.factorisation import factor, solve_backward
from softsim_core.dynamics.fast.kinematics import advance_border, jacobians, place_zones, screws
from softsim_core.dynamics.fast.layout import Border, Elements, Lines, Motion, Nodes, Tree, Work
from softsim_core.dynamics.fast.prepare import prepare, set_moduli
from softsim_core.dynamics.fast.simd import LANES, ROWS, steady_seconds
from softsim_core.dynamics.fast.tangent import assemble_tangent
from softsim_core.dynamics.rows import Rows
from softsim_core.dynamics.scipy_step import ScipyStepper
from softsim_core.dynamics.stepper import Inputs, Parameters
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State


@kernel
def assemble(
    motion: Motion, external: Array, h: float, lag: float, rayleigh_mass: float, polar: bool, border: Border,
    free: Elements, mixed: Elements, nodes: Nodes, lines: Lines, tree: Tree, work: Work,
) -> None:  # fmt: skip
    """Forces, matrix and right-hand side of the step, into `work`."""
    x, v = motion.positions, motion.velocities
    screws(motion, border, work)
    jacobians(motion, nodes, work)
    work.panels[:] = 0.0
    work.schur[:] = 0.0
    work.forces[:] = external
    for n in range(len(x)):
        for i in range(3):
            work.ahead[n, i] = x[n, i] + lag * v[n, i]
    assemble_free(x, h * lag, polar, free, work)
    assemble_mixed(x, h * lag, polar, mixed, nodes, work)
    assemble_nodes(v, h, rayleigh_mass, nodes, work)
    add_lines(h, motion, border, lines, nodes, tree, work)


@kernel
def finish(
    motion: Motion, targets: Array, base_shift: float, lower: Array, upper: Array, h: float, lag: float,
    border: Border, tree: Tree, nodes: Nodes, lines: Lines, work: Work,
) -> float:  # fmt: skip
    """Solve border and interior, advance, report joint efforts; returns the largest speed, or NaN."""
    joints, velocities = len(motion.joint_positions), motion.border_velocities
    size, right = len(velocities), len(work.schur)
    first = size - joints
    known = np.zeros(size, dtype=np.bool_)
    change = work.solution[3 * len(nodes.free) :]
    for j in range(joints):
        b, stiffness = first + j, border.stiffness[j]
        gap = targets[j] - motion.joint_positions[j]
        work.schur[b, b] += border.inertia[j] + h * lag * stiffness
        work.schur[b, right] += h * stiffness * (gap - lag * velocities[b])
        if stiffness == 0.0:
            known[b] = True
            change[b] = gap / h - velocities[b]
    eliminate_border(work.schur, known, change, work.scratch)
    hold_lines(h, lower, upper, change, size, lines, work.scratch)
    solve_border(known, change, work.scratch)
    solve_backward(tree, work)
    speed, finite = 0.0, True
    for f in range(len(nodes.free)):
        node, place = nodes.free[f], nodes.unknown[f]
        for i in range(3):
            motion.velocities[node, i] += work.solution[place + i]
            motion.positions[node, i] += h * motion.velocities[node, i]
            speed = max(speed, abs(motion.velocities[node, i]))
            finite = finite and motion.velocities[node, i] == motion.velocities[node, i]
    for j in range(joints):
        b = first + j
        if known[b]:
            impulse = -work.schur[b, right]
            for a in range(right):
                impulse += (work.schur[a, b] if a < b else work.schur[b, a]) * change[a]
            motion.joint_efforts[j] = impulse / h
    for b in range(size):
        velocities[b] += change[b]
        speed = max(speed, abs(velocities[b]))
        finite = finite and velocities[b] == velocities[b]
    advance_border(h, motion)
    motion.base_shift[0] = base_shift
    for j in range(joints):
        if known[first + j]:
            motion.joint_positions[j] = targets[j]  # exactly, without rounding
        else:
            motion.joint_efforts[j] = border.stiffness[j] * (targets[j] - motion.joint_positions[j])
    place_zones(motion, border, nodes, work)
    report_lines(motion, border, lines)
    return speed if finite else np.nan


@kernel
def advance(
    motion: Motion, external: Array, targets: Array, base_shift: float, lower: Array, upper: Array, h: float,
    lag: float, rayleigh_mass: float, polar: bool, border: Border, free: Elements, mixed: Elements,
    nodes: Nodes, lines: Lines, tree: Tree, work: Work,
) -> tuple[float, float, float, float]:  # fmt: skip
    """One whole step; returns the largest speed, and the seconds for assembly, factorisation and the rest."""
    started = steady_seconds()
    assemble(motion, external, h, lag, rayleigh_mass, polar, border, free, mixed, nodes, lines, tree, work)
    assembled = steady_seconds()
    factor(tree, work)
    factored = steady_seconds()
    speed = finish(motion, targets, base_shift, lower, upper, h, lag, border, tree, nodes, lines, work)
    return speed, assembled - started, factored - assembled, steady_seconds() - factored


class NumbaStepper:
    """Plan once, then step in one compiled call."""

    name = "numba"

    def __init__(self, model: Model, cables: Cables) -> None:
        self.model, self.cables = model, cables
        self.stage_times: dict[str, float] = {}
        self._prepared = prepare(model, cables)
        self.cable_gaps = self._prepared.lines.gap
        self._polar = model.law == "polar"
        self._soft = bool(model.spring.any())
        self._weight = model.mass[:, None] * model.gravity
        self._tuned: tuple[bytes, float, float] | None = None
        self._upper = np.triu(np.ones((model.border_size + len(cables),) * 2, dtype=bool))
        at = Unknowns(model)
        self._first_border = at.first_border
        self._prescribed, self._solved_border = (
            at.prescribed,
            np.setdiff1d(np.arange(model.border_size), at.fixed - at.first_border),
        )
        self._spans = np.zeros((len(self._prepared.tree.columns), 2), dtype=np.int64)
        self._spread = self._arriving = self._border_answer = np.zeros((0, 0))
        self._column, self._room = np.zeros(0, np.int64), np.zeros(0)
        self._advance, self._respond_to = OneSignature(advance), OneSignature(respond)
        self._apply, self._factor = OneSignature(apply_impulses), OneSignature(factor)
        self._assemble_tangent = OneSignature(assemble_tangent)
        self._body_of_node = np.zeros(len(model.rest) + 1, np.int64)  # border unknowns come last
        self._body_of_node[model.elements.nodes] = model.element_body[:, None]

    def step(self, state: State, inputs: Inputs, parameters: Parameters) -> float:
        """See Stepper."""
        model, data = self.model, self._prepared
        self._take_bases()
        lag = model.dt + parameters.rayleigh_stiffness
        self._tune(parameters, lag)
        motion = _motion(state)
        external = inputs.forces + self._weight
        if self._soft:
            external -= model.spring[:, None] * (state.positions + lag * state.velocities - model.rest)
        targets, bounds = self.cables.travels(inputs.targets, state), self.cables.bounds(inputs.targets)
        speed, *seconds = self._advance(
            motion, external, targets, inputs.base_shift, *bounds, model.dt, lag, parameters.rayleigh_mass,
            self._polar, data.border, data.free, data.mixed, data.nodes, data.lines, data.tree, data.work,
        )  # fmt: skip
        stages = ("assemble", "factor", "solve")
        self.stage_times = {stage: 1e3 * each for stage, each in zip(stages, seconds, strict=True)}
        return float(speed)

    def compliance(self, rows: Rows, before: State) -> Array:
        """See Stepper."""
        border, cables = self.model.border_size, len(self.cables)
        compliance = np.empty((cables + rows.height,) * 2)
        compliance[cables:, cables:] = self._respond(rows, _motion(before))
        schur, arriving = self._condensed(), self._spread[self._first_border :, self._column]
        compliance[:cables, :cables] = -schur[border:, border:]
        compliance[:cables, cables:] = -arriving[border:]
        compliance[cables:, :cables] = -arriving[border:].T
        self._arriving = np.concatenate([schur[:border, border:], arriving[:border]], axis=1)
        self._border_answer = np.zeros_like(self._arriving)
        if len(solved := self._solved_border):
            block = schur[np.ix_(solved, solved)]
            self._border_answer[solved] = np.linalg.solve(block, self._arriving[solved])
            compliance += self._arriving.T @ self._border_answer
        return compliance

    def correct(self, state: State, before: State, impulses: Array) -> float:
        """See Stepper."""
        model, data, cables = self.model, self._prepared, len(self.cables)
        change = self._border_answer @ impulses
        free = state.joint_positions.copy()
        placed = np.zeros(self._spread.shape[1])
        placed[self._column] = impulses[cables:]
        speed = self._apply(
            _motion(state), _motion(before), placed, np.concatenate([change, -impulses[:cables]]), model.dt,
            data.border, data.nodes, data.tree, data.work, self._spread, self._spans,
        )  # fmt: skip
        if len(free):
            first, held = model.border_size - len(free), self._prescribed
            schur = self._condensed()[first : model.border_size, : model.border_size]
            reaction = (schur @ change - self._arriving[first:] @ impulses) / model.dt
            state.joint_efforts[held] += reaction[held]
            state.joint_efforts -= data.border.stiffness * (state.joint_positions - free)
        if cables:
            tensions = data.lines.tension + impulses[:cables] / model.dt
            self.cables.report(model, state, tensions)
        return float(speed)

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """See Stepper."""
        model, data = self.model, self._prepared
        moduli = parameters.lame[model.element_body]
        result = np.zeros(len(moduli))
        data.work.ahead[:] = state.positions
        for elements, ids in ((data.free, data.free_ids), (data.mixed, data.mixed_ids)):
            von_mises_stress(state.positions, self._polar, elements, ids, moduli, data.work, result)
        return result

    def border_stiffness(self, state: State, parameters: Parameters, forces: Array) -> Array:
        """See Stepper."""
        return border_stiffness(self, state, parameters, forces)

    def border_response(
        self, state: State, parameters: Parameters, forces: Array, rows: Rows
    ) -> tuple[Array, Array, Array]:
        """See Stepper."""
        model, data = self.model, self._prepared
        if self._polar:
            self._tune(parameters, model.dt + parameters.rayleigh_stiffness)
            self._take_bases()
            motion = _motion(state)
            loads = forces + self._weight
            if self._soft:
                loads -= model.spring[:, None] * (state.positions - model.rest)
            self._assemble_tangent(
                motion, loads, model.spring, data.border, data.free, data.mixed, data.nodes, data.work
            )
            self._factor(data.tree, data.work)
            border = model.border_size
            stiffness = self._condensed()[:border, :border]
            if np.isfinite(stiffness).all():
                if not rows.height:
                    return stiffness, np.zeros((border, 0)), np.zeros((0, 0))
                compliance, first = self._respond(rows, motion), self._first_border
                return stiffness, self._spread[first : first + border, self._column], compliance
        # no Cholesky factor: a law without symmetric tangent, or a state on its way that is not stable
        return ScipyStepper(model, self.cables).border_response(state, parameters, forces, rows)

    def _take_bases(self) -> None:
        """Take over where the bases of the model's joints are; they may have been moved."""
        for place, joint in zip(self._prepared.border.base_position, self.model.joints, strict=True):
            place[:] = joint.base_position

    def _respond(self, rows: Rows, motion: Motion) -> Array:
        """H A^-1 H^T with the border held, (r, r); leaves Y and what reaches the border in self._spread."""
        data = self._prepared
        padded = rows.height + (-rows.height) % LANES
        unknowns, lines = len(data.work.solution), int(data.tree.columns.max(initial=0)) + 2 * ROWS
        self._spread, space, product = self._rooms(
            (unknowns, padded),
            (lines * (int(data.tree.width.max(initial=0)) + padded),),
            (padded, padded),
        )
        self._column, result = self._columns(rows), np.empty((rows.height, rows.height))
        self._respond_to(
            *rows, self._column, motion, data.border, data.nodes, data.tree, data.work, self._spread,
            self._spans, space, product, result,
        )  # fmt: skip
        return result

    def _columns(self, rows: Rows) -> IndexArray:
        """Where each row stands: rows of one body side by side, so that supernodes meet few of them."""
        body = np.zeros(rows.height, dtype=np.int64)
        if len(rows.place):
            first = rows.place[np.minimum(rows.start[:-1], len(rows.place) - 1)]
            body = self._body_of_node[np.minimum(first, len(self._body_of_node) - 1)]
        column = np.empty(rows.height, dtype=np.int64)
        column[np.argsort(body, kind="stable")] = np.arange(rows.height)
        return column

    def _rooms(self, *shapes: tuple[int, ...]) -> list[Array]:
        """Arrays to work in, uninitialised; they are kept for the next call, and grow."""
        sizes = [int(np.prod(shape)) for shape in shapes]
        if sum(sizes) > len(self._room):
            self._room = np.empty(2 * sum(sizes))
        ends = np.cumsum(sizes)
        return [
            self._room[end - size : end].reshape(shape)
            for end, size, shape in zip(ends, sizes, shapes, strict=True)
        ]

    def _condensed(self) -> Array:
        """The border's matrix that elimination of the free nodes left, whole, shape (b + c, b + c)."""
        schur = self._prepared.work.schur[:, :-1]
        return np.where(self._upper, schur, schur.T)

    def _tune(self, parameters: Parameters, lag: float) -> None:
        """Take over tunable parameters when they have changed."""
        tuned = (parameters.lame.tobytes(), lag, parameters.rayleigh_mass)
        if tuned == self._tuned:
            return
        self._tuned = tuned
        model, data = self.model, self._prepared
        moduli = parameters.lame[model.element_body] * model.elements.volumes[:, None]
        set_moduli(data.free, moduli[data.free_ids])
        set_moduli(data.mixed, moduli[data.mixed_ids])
        inertia = (1.0 + model.dt * parameters.rayleigh_mass) * model.mass
        data.nodes.diagonal[:] = inertia + model.dt * lag * model.spring


def _motion(state: State) -> Motion:
    """The state's arrays for the kernels."""
    return Motion(*(getattr(state, name) for name in Motion._fields))
