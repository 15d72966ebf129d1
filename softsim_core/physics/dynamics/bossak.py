r"""Second-order step that damps high frequencies only: the method of Wood, Bossak and Zienkiewicz.

With h = dt, a the accelerations, and f all forces at the end of the step:

.. math:: M ((1 - \alpha) a^+ + \alpha a) = f^+, \quad
    x^+ = x + h v + h^2 ((\tfrac12 - \beta) a + \beta a^+), \quad v^+ = v + h ((1 - \gamma) a + \gamma a^+)

with alpha = (r - 1) / (r + 1), gamma = 1/2 - alpha, beta = (1 - alpha)^2 / 4: the member of generalised-alpha
that takes forces at the end of the step; r is the spectral radius at infinite frequency. Linearised once,
it is an implicit Euler step of length p = h beta / gamma with other masses, initial velocities and forces:

.. math:: v \to (v + h (\tfrac12 - \beta / \gamma) a) h / p, \quad M \to M p / s, \quad
    f \to f + M a ((1 - \gamma) (1 - \alpha) / \gamma - \alpha), \quad s = h \gamma / (1 - \alpha)

The implicit Euler steppers therefore compute it. Damping uses the mean velocity of the step and is of first
order; the velocity at its end belongs to positions that the nodes have not reached, and would damp the
rotation of a body. Where no acceleration is known yet, it is taken from an implicit Euler step that is then
taken back.

A node that a contact holds in place has velocities and accelerations that decay by r per step with
alternating sign, because r is their double eigenvalue. With r = 0 they vanish after two steps, and contacts
come to rest; see contact_step.

Sources: Wood, Bossak, Zienkiewicz 1980, An alpha modification of Newmark's method; Chung, Hulbert 1993.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.actuation import drive_stiffness
from softsim_core.physics.dynamics.assembly import top_speed
from softsim_core.physics.dynamics.iterations import IteratedFreeMotion, IteratedStepper
from softsim_core.physics.dynamics.report import StepReport
from softsim_core.physics.dynamics.stepper import StepperAround
from softsim_core.physics.fem.materials import DAMPING
from softsim_core.physics.mechanics import (
    ACCELERATION,
    FREE,
    REDUCED_ACCELERATION,
    Control,
    Model,
    Parameters,
    Rows,
    State,
)

_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


class _Start(NamedTuple):
    """Initial velocities of nodes (n, 3) and of frames and joints (r,), and the control."""

    velocities: Array
    reduced: Array
    control: Control


class BossakStepper(StepperAround):
    """Advance by the second-order Bossak method through an implicit Euler stepper of modified masses and dt.

    Args:
        euler: Implicit Euler stepper of the model.
        of_model: Makes an implicit Euler stepper of the same model with other masses and another dt.
        spectral_radius: r, from 0 to 1: factor by which each step scales the highest frequencies.
    """

    def __init__(
        self, euler: IteratedStepper, of_model: Callable[[Model], IteratedStepper], spectral_radius: float
    ) -> None:
        super().__init__(euler)
        model = euler.model
        alpha = (spectral_radius - 1.0) / (spectral_radius + 1.0)
        self._gamma = 0.5 - alpha
        ratio = 0.25 * (1.0 - alpha) ** 2 / self._gamma  # beta / gamma
        self._carried = (1.0 - self._gamma) * (1.0 - alpha) / self._gamma - alpha
        self._length, self._span = ratio * model.dt, model.dt * self._gamma / (1.0 - alpha)
        self._start, self._drift = 1.0 / ratio, model.dt * (0.5 - ratio)
        self._lighter = self._length / self._span
        self._step = of_model(model.with_inertia(self._lighter, self._length))
        self._before = model.empty_state()
        compliant = model.compliant_joints
        self._compliant, self._stiffness = compliant, drive_stiffness(model)
        driven = np.setdiff1d(np.arange(len(model.joints)), compliant)
        self._driven_joints, self._driven = driven, 6 * len(model.frame_names) + driven
        self._regions = _RegionNodes(model)
        self._in_regions = model.region_of_node != FREE
        self._inertia = np.array([joint.inertia for joint in model.joints])

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance the state by one Bossak step, in place.

        Where its accelerations are unknown, an implicit Euler step finds them first and is then taken back.
        """
        if not self.goes_on(state):
            before = self._before
            before.copy_from(state)
            self._inner.step(state, control, parameters)
            self.take_back(state, before)
        start, damping = self._enter(state, control, parameters)
        report = self._step.step(state, start.control, damping)
        return self._leave(report, state, start, control)

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> BossakFreeMotion:
        """Return the unconstrained Bossak step from a state whose accelerations are known."""
        start, damping = self._enter(state, control, parameters)
        motion = self._step.free_motion(state, start.control, damping)
        leave = partial(self._leave, start=start, control=control)
        return BossakFreeMotion(motion, self._before, self._length / self.model.dt, leave)

    def next_move(self, motion: BossakFreeMotion, complete: Callable[[BossakFreeMotion], object]) -> float:
        """Return the largest node displacement of one more Newton iteration in [m]."""
        return self._step.next_move(motion.inner, lambda further: complete(motion.after(further)))

    def _enter(self, state: State, control: Control, parameters: Parameters) -> tuple[_Start, Parameters]:
        """Make `state` the start of the implicit Euler step of other length.

        Return its start and its damping.
        """
        self._before.copy_from(state)
        start = self._start_of(self._before, control)
        state.velocities[:], state.reduced_velocities[:] = start.velocities, start.reduced
        length = self._length / self.model.dt
        damping = replace(  # uses the mean velocity of the step
            parameters,
            materials=[_scale_damping(each, length) for each in parameters.materials],
            rayleigh_stiffness=parameters.rayleigh_stiffness * length,
            rayleigh_mass=parameters.rayleigh_mass * self._span / self.model.dt,
        )
        return start, damping

    def _leave(self, report: StepReport, state: State, start: _Start, control: Control) -> StepReport:
        """Convert `state`, the end of that step, to the end of this one; return the report."""
        self._end(state, self._before, start)
        springs = self._stiffness * (control.targets - state.joint_positions)
        state.joint_efforts[self._compliant] = springs[self._compliant]
        return replace(report, top_speed=top_speed(self.model, state))

    def _start_of(self, before: State, control: Control) -> _Start:
        """Return the initial velocities and the control of the implicit Euler step of other length."""
        model, h = self.model, self.model.dt
        a, b = before.extra[ACCELERATION], before.extra[REDUCED_ACCELERATION]
        start = self._start * (before.velocities + self._drift * a)
        reduced = self._start * (before.reduced_velocities + self._drift * b)
        if len(self._driven):  # displacement and acceleration of driven joints are known
            way = control.targets[self._driven_joints] - before.joint_positions[self._driven_joints]
            gains = (way / h - before.reduced_velocities[self._driven]) * self._span / h
            reduced[self._driven] = way / self._length - gains
        carried = self._carried * a
        if model.regions:
            rates = np.stack([reduced, self._carried * b])
            own = self._regions.nodes
            start[own], carried[own] = self._regions.rates(before, rates)
        targets, forces = control.targets.copy(), control.forces + model.momentum(carried)
        if len(self._compliant):
            joints, first = self._compliant, len(b) - len(targets)
            inert = self._carried * self._inertia[joints] * b[first + joints]
            targets[joints] += inert / self._stiffness[joints]
        return _Start(start, reduced, replace(control, targets=targets, forces=forces))

    def _end(self, state: State, before: State, start: _Start) -> None:
        """Set velocities and accelerations from the changes in the step."""
        h, a, b = self.model.dt, state.extra[ACCELERATION], state.extra[REDUCED_ACCELERATION]
        a[:], b[:] = before.extra[ACCELERATION], before.extra[REDUCED_ACCELERATION]
        change, turn = state.velocities - start.velocities, state.reduced_velocities - start.reduced
        state.velocities[:] = before.velocities + change
        state.reduced_velocities[:] = before.reduced_velocities + turn
        a += (change / h - a) / self._gamma
        b += (turn / h - b) / self._gamma
        moved = state.joint_positions - before.joint_positions
        state.reduced_velocities[self._driven], b[self._driven] = moved[self._driven_joints] / h, 0.0
        if self.model.regions:
            rates = self._regions.rates(state, state.reduced_velocities[None])
            state.velocities[self._regions.nodes] = rates[0]
            a[self._in_regions] = 0.0

    def goes_on(self, state: State) -> bool:
        """Return whether accelerations are known."""
        return any(state.extra[name].any() for name in (ACCELERATION, REDUCED_ACCELERATION))

    def forget_acceleration(self, state: State) -> None:
        """Discard the accelerations after an impact: the next step starts again."""
        state.extra[ACCELERATION][:] = state.extra[REDUCED_ACCELERATION][:] = 0.0

    def take_back(self, state: State, before: State) -> None:
        """Restore `before`, but with the accelerations of the implicit Euler step from there to `state`."""
        h = self.model.dt
        acceleration = (state.velocities - before.velocities) / h
        acceleration[self._in_regions] = 0.0
        reduced = (state.reduced_velocities - before.reduced_velocities) / h
        reduced[self._driven] = 0.0
        state.copy_from(before)
        state.extra[ACCELERATION][:], state.extra[REDUCED_ACCELERATION][:] = acceleration, reduced


class BossakFreeMotion:
    """Unconstrained Bossak step, converted from the implicit Euler step of another length.

    Args:
        inner: Unconstrained motion of the other step.
        before: State at the start.
        ratio: Length of the other step divided by the length of this one.
        leave: Converts the end of the other step to that of this one.

    Attributes:
        inner: As given.
    """

    def __init__(
        self,
        inner: IteratedFreeMotion,
        before: State,
        ratio: float,
        leave: Callable[[StepReport, State], StepReport],
    ) -> None:
        self.inner, self.state, self.before = inner, inner.state, before
        self._ratio, self._leave = ratio, leave
        self.violations = inner.violations
        self.report = leave(inner.report, inner.state)

    @property
    def defect(self) -> Array | None:
        """Row velocities in [m/s] that the approximate compliance left out, shape (r,); None: it is exact."""
        left = self.inner.defect
        return None if left is None else self._ratio * left

    def compliance(self, rows: Rows) -> Array:
        """Return the compliance of the rows in [1/kg], shape (c + r, c + r).

        It is a displacement per force and dt^2.
        """
        return self._ratio**2 * self.inner.compliance(rows)

    def correct(self, impulses: Array) -> StepReport:
        """Add the effect of impulses on the rows to the free motion, in place.

        An impulse is the force at the end of the step times dt.
        """
        return self._leave(self.inner.correct(self._ratio * impulses), self.state)

    def wants_more(self) -> bool:
        """Return whether another Newton iteration should follow."""
        return self.inner.wants_more()

    def strays(self) -> bool:
        """Return whether this iteration moved a node farther than the one before."""
        return self.inner.strays()

    def again(self, state: State) -> BossakFreeMotion:
        """Return the next Newton iteration, started from where this one ended."""
        return self.after(self.inner.again(state))

    def after(self, further: IteratedFreeMotion) -> BossakFreeMotion:
        """Return the Bossak motion of a further iteration."""
        return BossakFreeMotion(further, self.before, self._ratio, self._leave)


class _RegionNodes:
    """Nodes of all moving regions, and their velocities from those of frames and joints."""

    def __init__(self, model: Model) -> None:
        self._model = model
        none: list[IndexArray] = [np.zeros(0, np.int64)]
        self.nodes = np.concatenate([*none, *(region.nodes for region in model.regions)])
        reduced = np.arange(model.reduced_size)
        self._moved_by = np.array([np.isin(reduced, region.reduced) for region in model.regions], dtype=float)
        self._region = np.repeat(np.arange(len(model.regions)), [len(each.nodes) for each in model.regions])

    def rates(self, state: State, reduced: Array) -> Array:
        """Return rates (c, k, 3) of the k nodes from rates (c, r) of frames and joints."""
        motion = self._model.motion_subspace(state)
        moved_by = reduced[:, None, :] * self._moved_by
        spins = (moved_by @ motion.angular)[:, self._region]
        drifts = (moved_by @ (motion.linear - _cross(motion.angular, motion.origin)))[:, self._region]
        return np.asarray(_cross(spins, state.positions[self.nodes]) + drifts)


def _scale_damping(values: dict[str, float], factor: float) -> dict[str, float]:
    """Return values of a law by name, with its damping, if any, times a factor."""
    damping = values.get(DAMPING.name)
    return {**values, DAMPING.name: factor * damping} if damping else values


def _cross(a: Array, b: Array) -> Array:
    """Return cross products along the last axis; faster than NumPy's for a few vectors."""
    left, right = a.take(_NEXT, -1) * b.take(_LAST, -1), a.take(_LAST, -1) * b.take(_NEXT, -1)
    return np.asarray(left - right)
