"""The step with contacts and free rigid bodies, around the one of nodes, joints and cables.

1. the step as if nothing touched;
2. rows H and gaps g of all contacts, from the start of the step and that motion;
3. compliance C = h^2 H A^-1 H^T in [m/N] of cables and contacts, rigid bodies included;
4. forces f so that g + C f keeps every cable's travel and every contact's cone;
5. the velocities that the change of h f adds.

Source: Duriez et al. 2006, Realistic haptic rendering of interacting deformable objects (constraint-based).
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.solver import solve_contacts
from softsim_core.dynamics.contacts import Contacts, Touching, no_memory
from softsim_core.dynamics.rows import Rows
from softsim_core.dynamics.stepper import Inputs, Parameters, Stepper
from softsim_core.mechanics.state import State
from softsim_core.scene.objects import ContactSettings


@dataclass(frozen=True, slots=True, eq=False)
class ContactReport:
    """What touched in the last step.

    Attributes:
        points: Middle of each contact in [m], shape (k, 3).
        forces: Force on the first surface of each pair in [N], world axes, shape (k, 3).
        gaps: Gap between the surfaces in [m] beyond the contact distance at the end of the step, shape (k,).
        pairs: Numbers of the two surfaces, shape (k, 2).
        residual: How far the forces are from the contact law, in [m].
        sweeps: Sweeps of the contact solver.
    """

    points: Array
    forces: Array
    gaps: Array
    pairs: IndexArray
    residual: float
    sweeps: int


NOTHING = ContactReport(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2), np.int64), 0.0, 0)


class Stopwatch:
    """Times of parts in [ms], one behind the other."""

    def __init__(self) -> None:
        self.times: dict[str, float] = {}
        self._last = perf_counter()

    def mark(self, part: str) -> None:
        """Everything since the mark before was `part`."""
        now = perf_counter()
        self.times[part] = 1e3 * (now - self._last)
        self._last = now


class ContactStepper:
    """A step with rigid bodies and contacts around one without."""

    def __init__(self, inner: Stepper, contacts: Contacts | None) -> None:
        self._inner, self._contacts = inner, contacts
        self.name, self.model, self.cables = inner.name, inner.model, inner.cables
        self.stage_times: dict[str, float] = {}
        self.report = NOTHING
        self._before = inner.model.empty_state()

    @property
    def cable_gaps(self) -> Array:
        """See Stepper."""
        return self._inner.cable_gaps

    def step(self, state: State, inputs: Inputs, parameters: Parameters) -> float:
        """See Stepper."""
        model, before = self.model, self._before
        before.copy_from(state)
        speed = self._inner.step(state, inputs, parameters)
        if model.rigid.names:
            model.rigid.predict(state, model.gravity, model.dt)
            model.rigid.advance(state, before, model.dt)
            speed = float(np.max([speed, np.abs(state.rigid_velocities).max()]))  # keeps NaN
        state.memory, self.report = no_memory(), NOTHING
        if not np.isfinite(speed) or self._contacts is None:
            self.stage_times = self._inner.stage_times
            return speed
        watch = Stopwatch()
        touching = self._contacts.find(model, before, state)
        if not len(touching):
            touching = self._contacts.find_farther(touching, model, before, state)
        watch.mark("detect")
        if len(touching):
            speed = self._hold(speed, state, before, inputs, touching, self._contacts.settings, watch)
        parts = {part: watch.times.get(part, 0.0) for part in ("compliance", "forces", "correct")}
        self.stage_times = {
            **self._inner.stage_times,
            "detect": watch.times["detect"],
            "contact": sum(parts.values()),
            **parts,
        }
        return speed

    def _hold(
        self,
        speed: float,
        state: State,
        before: State,
        inputs: Inputs,
        touching: Touching,
        settings: ContactSettings,
        watch: Stopwatch,
    ) -> float:
        """Find the forces and add what they do; returns the largest speed, which was `speed` without them."""
        model, h = self.model, self.model.dt
        reaches = len(touching.rows.place) > 0  # what is not rigid
        cables = len(self.cables) if reaches else 0
        compliance = np.zeros((len(touching.gap),) * 2)
        if reaches:
            compliance = h * h * self._inner.compliance(touching.rows, before)
        moves = model.rigid.response(before, touching.on_rigid)
        compliance[cables:, cables:] += h * h * (moves @ touching.on_rigid.T)
        watch.mark("compliance")
        tensions = state.joint_efforts[self.cables.joint][:cables]
        gap = np.append(self.cable_gaps[:cables], touching.gap) - compliance[:, :cables] @ tensions
        lower, upper = self.cables.bounds(inputs.targets)
        solution = solve_contacts(
            compliance,
            gap,
            (lower[:cables], upper[:cables]),
            settings.friction,
            np.append(tensions, touching.remembered(before.memory)),
            settings.iterations,
            settings.tolerance,
        )
        forces = solution.forces[cables:]
        watch.mark("forces")
        if reaches:
            more = solution.forces[:cables] - tensions
            speed = self._inner.correct(state, before, h * np.append(more, forces))
        if model.rigid.names:
            state.rigid_velocities += (h * (forces @ moves)).reshape(-1, 6)
            model.rigid.advance(state, before, h)
            speed = float(np.max([speed, np.abs(state.rigid_velocities).max()]))
        watch.mark("correct")
        state.memory = touching.memory(forces)
        self.report = ContactReport(
            touching.points,
            np.einsum("kd,kdi->ki", forces.reshape(-1, 3), touching.directions),
            (gap + compliance @ solution.forces)[cables::3],
            touching.pairs,
            solution.residual,
            solution.sweeps,
        )
        return speed

    # --- what contacts have no part in ---

    def compliance(self, rows: Rows, before: State) -> Array:
        """See Stepper."""
        return self._inner.compliance(rows, before)

    def correct(self, state: State, before: State, impulses: Array) -> float:
        """See Stepper."""
        return self._inner.correct(state, before, impulses)

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """See Stepper."""
        return self._inner.von_mises(state, parameters)

    def border_stiffness(self, state: State, parameters: Parameters, forces: Array) -> Array:
        """See Stepper."""
        return self._inner.border_stiffness(state, parameters, forces)

    def border_response(
        self, state: State, parameters: Parameters, forces: Array, rows: Rows
    ) -> tuple[Array, Array, Array]:
        """See Stepper."""
        return self._inner.border_response(state, parameters, forces, rows)
