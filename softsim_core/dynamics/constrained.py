"""The step with cables and contacts: free motion, constraint rows, forces, correction.

1. the free step, as if nothing touched and no cable held;
2. rows H and gaps g of all cables and contacts, from the start of the step and the free motion;
3. compliance C = h^2 H A^-1 H^T in [m/N], rigid bodies included;
4. forces f so that g + C f keeps every cable's travel and every contact's cone;
5. the velocities that h f adds.

Source: Duriez et al. 2006, Realistic haptic rendering of interacting deformable objects (constraint-based).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from softsim_core.actuation.cable import Cables
from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.solver import solve_contacts
from softsim_core.dynamics.bounded import solve_bounded
from softsim_core.dynamics.cable_statics import cable_border_stiffness
from softsim_core.dynamics.contacts import Contacts, Touching, no_memory
from softsim_core.dynamics.rows import Rows, joined
from softsim_core.dynamics.stepper import Inputs, Parameters, Stepper
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State


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


class ConstrainedStepper:
    """A step with cables, rigid bodies and contacts around one without."""

    def __init__(
        self, inner: Stepper, model: Model, cables: Cables | None, contacts: Contacts | None
    ) -> None:
        self._inner, self.model, self._cables, self._contacts = inner, model, cables, contacts
        self.name = inner.name
        self.stage_times: dict[str, float] = {}
        self.report = NOTHING
        self._before = model.empty_state()

    def step(self, state: State, inputs: Inputs, parameters: Parameters) -> float:
        """See Stepper."""
        model, before, h = self.model, self._before, self.model.dt
        before.copy_from(state)
        speed = self._inner.step(state, self._positions_only(state, inputs), parameters)
        if model.rigid.names:
            model.rigid.predict(state, model.gravity, h)
            model.rigid.advance(state, before, h)
            speed = float(np.max([speed, np.abs(state.rigid_velocities).max()]))  # keeps NaN
        if not np.isfinite(speed):
            return speed
        moved = perf_counter()
        bounds = self._cable_bounds(inputs)
        rows, gap, touching = self._constraints(before, state)
        found = perf_counter()
        parts = dict.fromkeys(("compliance", "forces", "correct"), 0.0)
        if len(gap):
            speed = self._hold(state, before, rows, gap, bounds, touching, parts)
        else:
            state.memory, self.report = no_memory(), NOTHING
        self.stage_times = {
            **self._inner.stage_times,
            "detect": 1e3 * (found - moved),
            "contact": 1e3 * (perf_counter() - found),
            **parts,
        }
        return speed

    def _constraints(self, before: State, free: State) -> tuple[list[Rows], Array, Touching | None]:
        """Rows of cables, then contacts, and their gaps in [m] after free motion."""
        model, rows, gaps = self.model, [], [np.zeros(0)]
        if self._cables is not None:
            points = self._cables.points(model, before)
            pulls, lengths = self._cables.pulls(points)
            moved = self._cables.points(model, free) - points
            rows.append(self._cables.rows(model, before, points, pulls))
            travel = self._cables.shortening(pulls, moved) + self._cables.gaps(before, lengths)
            change = free.joint_positions - before.joint_positions
            gaps.append(travel - change[self._cables.joint])
        touching = None
        if self._contacts is not None:
            touching = self._contacts.find(model, before, free)
            if len(touching):
                rows.append(touching.rows)
                gaps.append(touching.gap)
        return rows, np.concatenate(gaps), touching

    def _hold(
        self,
        state: State,
        before: State,
        rows: list[Rows],
        gap: Array,
        bounds: tuple[Array, Array],
        touching: Touching | None,
        times: dict[str, float],
    ) -> float:
        """Find the forces and add what they do; returns the largest speed, in `times` the parts in [ms]."""
        model, h, cables = self.model, self.model.dt, len(bounds[0])
        started = perf_counter()
        compliance = h * h * self._inner.compliance(joined(rows), before)
        on_rigid = np.zeros((len(gap), 6 * len(model.rigid.names)))
        moves = on_rigid
        if touching is not None and len(touching):
            on_rigid[cables:] = touching.on_rigid
            moves = model.rigid.response(before, on_rigid)
            compliance += h * h * (moves @ on_rigid.T)
        prepared = perf_counter()
        forces = self._forces(compliance, gap, before, bounds, touching)
        found = perf_counter()
        speed = self._inner.correct(state, before, h * forces)
        if len(model.rigid.names):
            state.rigid_velocities += (h * (forces @ moves)).reshape(-1, 6)
            model.rigid.advance(state, before, h)
            speed = float(np.max([speed, np.abs(state.rigid_velocities).max()]))
        seconds = (prepared - started, found - prepared, perf_counter() - found)
        times.update(zip(times, (1e3 * each for each in seconds), strict=True))
        if self._cables is not None:
            self._cables.report(model, state, forces[:cables])
        if touching is not None and len(touching):
            state.memory = touching.memory(forces[cables:])
            left = (gap + compliance @ forces)[cables::3]
            world = np.einsum("kd,kdi->ki", forces[cables:].reshape(-1, 3), touching.directions)
            self.report = replace(
                self.report, points=touching.points, forces=world, gaps=left, pairs=touching.pairs
            )
        else:
            state.memory, self.report = no_memory(), NOTHING
        return speed

    def _forces(
        self,
        compliance: Array,
        gap: Array,
        before: State,
        bounds: tuple[Array, Array],
        touching: Touching | None,
    ) -> Array:
        """Tensions and contact forces in [N]; the report gets the residual."""
        if touching is None or not len(touching):
            return solve_bounded(compliance, gap, *bounds)
        assert self._contacts is not None
        settings = self._contacts.settings
        start = touching.remembered(before.memory)
        if self._cables is not None:
            start = np.append(before.joint_efforts[self._cables.joint], start)
        solution = solve_contacts(
            compliance, gap, bounds, settings.friction, start, settings.iterations, settings.tolerance
        )
        self.report = replace(NOTHING, residual=solution.residual, sweeps=solution.sweeps)
        return np.asarray(solution.forces)

    def _cable_bounds(self, inputs: Inputs) -> tuple[Array, Array]:
        if self._cables is None:
            return np.zeros(0), np.zeros(0)
        return self._cables.bounds(inputs.targets)

    def _positions_only(self, state: State, inputs: Inputs) -> Inputs:
        """Inputs whose joints all have a position: a cable commanded by force keeps its travel."""
        if self._cables is None or not self._cables.by_force.any():
            return inputs
        forced = self._cables.joint[self._cables.by_force]
        targets = inputs.targets.copy()
        targets[forced] = state.joint_positions[forced]
        return replace(inputs, targets=targets)

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

    def border_response(
        self, state: State, parameters: Parameters, forces: Array, rows: Rows
    ) -> tuple[Array, Array, Array]:
        """See Stepper."""
        return self._inner.border_response(state, parameters, forces, rows)

    def border_stiffness(self, state: State, parameters: Parameters, forces: Array) -> Array:
        """See Stepper; cables keep their travels, contacts have no part in it."""
        if self._cables is None:
            return self._inner.border_stiffness(state, parameters, forces)
        return cable_border_stiffness(self._inner, self.model, self._cables, state, parameters, forces)
