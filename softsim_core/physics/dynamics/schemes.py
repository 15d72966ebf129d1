r"""Time integration schemes: implicit Euler, and the second-order method of Wood, Bossak and Zienkiewicz.

Both solve an implicit Euler step; a scheme says of which length, with which masses, from which velocities and
under which forces, and how its end becomes that of the scheme's own step. For implicit Euler nothing changes.

Bossak's method damps high frequencies only. With h = dt, a the accelerations, and f all forces at the end of
the step:

.. math:: M ((1 - \alpha) a^+ + \alpha a) = f^+, \quad
    x^+ = x + h v + h^2 ((\tfrac12 - \beta) a + \beta a^+), \quad v^+ = v + h ((1 - \gamma) a + \gamma a^+)

with alpha = (r - 1) / (r + 1), gamma = 1/2 - alpha, beta = (1 - alpha)^2 / 4: the member of generalised-alpha
that takes forces at the end of the step; r is the spectral radius at infinite frequency. Linearised once,
it is an implicit Euler step of length p = h beta / gamma with other masses, initial velocities and forces:

.. math:: v \to (v + h (\tfrac12 - \beta / \gamma) a) h / p, \quad M \to M p / s, \quad
    f \to f + M a ((1 - \gamma) (1 - \alpha) / \gamma - \alpha), \quad s = h \gamma / (1 - \alpha)

The steppers therefore compute it as they compute implicit Euler. Damping uses the mean velocity of the step
and is of first order; the velocity at its end belongs to positions that the nodes have not reached, and would
damp the rotation of a body. Where no acceleration is known yet, it is taken from an implicit Euler step that
is then taken back.

A node that a contact holds in place has velocities and accelerations that decay by r per step with
alternating sign, because r is their double eigenvalue. With r = 0 they vanish after two steps, and contacts
come to rest; see step.

Sources: Wood, Bossak, Zienkiewicz 1980, An alpha modification of Newmark's method; Chung, Hulbert 1993.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.actuation import drive_stiffness
from softsim_core.physics.dynamics.assembly import top_speed
from softsim_core.physics.dynamics.report import StepReport
from softsim_core.physics.fem.materials import DAMPING
from softsim_core.physics.mechanics import (
    ACCELERATION,
    FREE,
    REDUCED_ACCELERATION,
    Control,
    Model,
    Parameters,
    State,
    cross,
)


class Scheme(Protocol):
    """A time integration scheme, computed by an implicit Euler step.

    Attributes:
        solved: Model of that step: its masses and its dt.
        ratio: dt of that step divided by the scheme's.
    """

    solved: Model
    ratio: float

    def enter(
        self, state: State, before: State, control: Control, parameters: Parameters
    ) -> tuple[Control, Parameters]:
        """Make `state` the start of the implicit Euler step; return the control and parameters of that step.

        `before` is a copy of `state` that stays as it is until the step has ended.
        """
        ...

    def leave(self, state: State, before: State, control: Control, report: StepReport) -> StepReport:
        """Make `state`, the end of the implicit Euler step, that of the scheme's; return the report.

        It may be called several times after `enter`, each time with another end; `before` and `control` are
        those of `enter`.
        """
        ...


class ImplicitEuler:
    """First-order scheme: the step that is solved is the scheme's own."""

    ratio = 1.0

    def __init__(self, model: Model) -> None:
        self.solved = model

    def enter(
        self, state: State, before: State, control: Control, parameters: Parameters
    ) -> tuple[Control, Parameters]:
        """Return control and parameters unchanged."""
        return control, parameters

    def leave(self, state: State, before: State, control: Control, report: StepReport) -> StepReport:
        """Return the report unchanged."""
        return report


class Bossak:
    """Second-order scheme with numerical damping of high frequencies.

    Args:
        model: The model; its `dt` is the length of a step.
        spectral_radius: r, from 0 to 1: factor by which each step scales the highest frequencies.
    """

    def __init__(self, model: Model, spectral_radius: float) -> None:
        self.model = model
        alpha = (spectral_radius - 1.0) / (spectral_radius + 1.0)
        self._gamma = 0.5 - alpha
        share = 0.25 * (1.0 - alpha) ** 2 / self._gamma  # beta / gamma
        self._carried = (1.0 - self._gamma) * (1.0 - alpha) / self._gamma - alpha
        self._length, self._span = share * model.dt, model.dt * self._gamma / (1.0 - alpha)
        self._start, self._drift = 1.0 / share, model.dt * (0.5 - share)
        self.ratio = self._length / model.dt
        self.solved = model.with_inertia(self._length / self._span, self._length)
        self._velocities, self._reduced = np.zeros_like(model.rest), np.zeros(model.reduced_size)
        compliant = model.compliant_joints
        self._compliant, self._stiffness = compliant, drive_stiffness(model)
        driven = np.setdiff1d(np.arange(len(model.joints)), compliant)
        self._driven_joints, self._driven = driven, 6 * len(model.frame_names) + driven
        self._regions = _RegionNodes(model)
        self._in_regions = model.region_of_node != FREE
        self._inertia = np.array([joint.inertia for joint in model.joints])

    def enter(
        self, state: State, before: State, control: Control, parameters: Parameters
    ) -> tuple[Control, Parameters]:
        """Make `state` the start of the implicit Euler step; return the control and parameters of that step.

        The accelerations must be known, see `goes_on`.
        """
        solved = self._start_of(before, control)
        state.velocities[:], state.reduced_velocities[:] = self._velocities, self._reduced
        return solved, replace(  # damping uses the mean velocity of the step
            parameters,
            materials=[_scale_damping(each, self.ratio) for each in parameters.materials],
            rayleigh_stiffness=parameters.rayleigh_stiffness * self.ratio,
            rayleigh_mass=parameters.rayleigh_mass * self._span / self.model.dt,
        )

    def leave(self, state: State, before: State, control: Control, report: StepReport) -> StepReport:
        """Set velocities, accelerations and spring efforts from the changes within the step."""
        h = self.model.dt
        a, b = state.extra[ACCELERATION], state.extra[REDUCED_ACCELERATION]
        a[:], b[:] = before.extra[ACCELERATION], before.extra[REDUCED_ACCELERATION]
        change, turn = state.velocities - self._velocities, state.reduced_velocities - self._reduced
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
        springs = self._stiffness * (control.targets - state.joint_positions)
        state.joint_efforts[self._compliant] = springs[self._compliant]
        return replace(report, top_speed=top_speed(self.model, state))

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

    def _start_of(self, before: State, control: Control) -> Control:
        """Set the initial velocities of the implicit Euler step of other length; return its control."""
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
        self._velocities, self._reduced = start, reduced
        return replace(control, targets=targets, forces=forces)


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
        drifts = (moved_by @ (motion.linear - cross(motion.angular, motion.origin)))[:, self._region]
        return np.asarray(cross(spins, state.positions[self.nodes]) + drifts)


def _scale_damping(values: dict[str, float], factor: float) -> dict[str, float]:
    """Return values of a law by name, with its damping, if any, times a factor."""
    damping = values.get(DAMPING.name)
    return {**values, DAMPING.name: factor * damping} if damping else values
