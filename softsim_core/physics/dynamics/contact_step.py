"""Contacts and free rigid bodies of a step, around the unconstrained motion of nodes, joints and actuators.

1. rows H and gaps g of all contacts, linearised about the start of the step;
2. compliance C = h^2 H A^-1 H^T in [m/N] of actuators and contacts, rigid bodies included;
3. forces f for which g + C f satisfies every actuator's coordinate and every contact's law;
4. the velocities that the change of h f adds to the unconstrained motion;
5. the true shapes at the end: where surfaces are closer than allowed, or something has passed through a
   surface, repeat from 1, linearised about that end, or about the last configuration before the passing.

Source: Duriez et al. 2006, Realistic haptic rendering of interacting deformable objects (constraint-based).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.contact import CollisionModel, LinearisedContacts, Place, linearise
from softsim_core.physics.contact.detection import Proximities, measured_gaps
from softsim_core.physics.contact.solver import ContactSolution, solve_contacts
from softsim_core.physics.dynamics.iterations import Iteration
from softsim_core.physics.dynamics.report import ContactReport, StepReport
from softsim_core.physics.mechanics import Model, RigidBodies, State, no_warm_start

MOST_PASSES = 10
"""Largest number of times that the contacts of a step are solved."""
RUNAWAY_SIZES = 100.0
"""A displacement within one step of more than this many sizes of the scene counts as a runaway."""
MOST_ROUNDS = 10
"""Largest number of contact solutions per pass where the response to forces is approximate."""

_TOO_DEEP = 0.5
"""Share of the contact distance by which surfaces may come too close within a step that is not cut."""
_BEFORE_PASSING = 0.95
"""Share of the motion up to the first passing at which contacts are linearised again."""


def runaway_speed(size: float, dt: float) -> float:
    """Return the speed in [m/s] that counts as a runaway in a scene of `size` [m] with steps of `dt` [s]."""
    return RUNAWAY_SIZES * size / dt


class Pass(NamedTuple):
    """Result of one solution of the contacts of a step.

    Attributes:
        touching: The contacts.
        solution: Their forces, without those of actuators.
        report: Report of the step.
        end: Configuration at the end of the step.
        near: Contacts there.
        margin: Share of the motion without passing through a surface, and the smallest gap at the end in [m].
        values: State.buffer at the end.
    """

    touching: LinearisedContacts
    solution: ContactSolution
    report: StepReport
    end: Place
    near: Proximities
    margin: tuple[float, float]
    values: Array


class Stopwatch:
    """Times of stages in [ms]; repeated stages are added up."""

    def __init__(self) -> None:
        self.times: dict[str, float] = {}
        self._last = perf_counter()

    def mark(self, part: str) -> None:
        """Attribute the time since the last mark to `part`."""
        now = perf_counter()
        self.times[part] = self.times.get(part, 0.0) + 1e3 * (now - self._last)
        self._last = now

    def stages(self) -> dict[str, float]:
        """Return the stages of a step with contacts: `detect`, `contact`, and the parts of the latter."""
        parts = {part: self.times.get(part, 0.0) for part in ("compliance", "forces", "correct")}
        return {"detect": self.times.get("detect", 0.0), "contact": sum(parts.values()), **parts}


class ContactPhase:
    """Moves the rigid bodies of a step and finds its contact forces.

    Args:
        model: The model.
        actuators: Its actuators, which are solved again together with the contacts.
        collisions: Collision surfaces; None: there are none.
    """

    def __init__(self, model: Model, actuators: Actuators, collisions: CollisionModel | None) -> None:
        self.model, self.actuators, self.collisions = model, actuators, collisions
        self._free = model.empty_state()
        self._last: Pass | None = None
        self._apart = math.inf  # smallest gap at the start of the last step in [m]

    @property
    def failed(self) -> bool:
        """Whether something passed a surface in the last step, or surfaces came much too close in it.

        What was too close before counts only where it came closer still.
        """
        if self._last is None:
            return False
        distance = self._last.touching.collisions.settings.contact_distance
        allowed = min(self._apart, distance) - _TOO_DEEP * distance
        return self._last.margin < (1.0, allowed)

    @property
    def active(self) -> IndexArray:
        """Keys of the contacts of the last step that press on more than rigid bodies, shape (k,)."""
        if self._last is None:
            return np.zeros(0, np.int64)
        touching, solution = self._last.touching, self._last.solution
        carried, sides = touching.collisions.carried, touching.vertices[:, [0, 3]]
        reaches = (carried.soft[sides] | (carried.reduced[sides, 0] >= 0)).any(axis=1)
        return np.asarray(touching.keys[reaches & solution.forces.any(axis=1)], dtype=np.int64)

    def has_struck(self, start: State) -> bool:
        """Return whether a contact of the step was not active in the state at its start."""
        active = start.warm_start[start.warm_start[:, 1:].any(axis=1), 0]
        return not bool(np.isin(self.active, active).all())

    def correct(self, motion: Iteration, report: StepReport) -> StepReport:
        """Move the rigid bodies, and add the contact forces of an iteration to its end, in place.

        `report` is that of the iteration; return the report with the contacts.
        """
        model, collisions, state, before = self.model, self.collisions, motion.state, motion.before
        if collisions is None and not model.rigid.names:
            return report
        if model.rigid.names:
            model.rigid.predict(state, model.gravity, model.dt, motion.control.rigid_forces)
            model.rigid.advance(state, before, model.dt)
            report = _faster(report, state, model.rigid)
        state.warm_start, self._last = no_warm_start(), None
        if collisions is None or not report.top_speed < runaway_speed(collisions.size, model.dt):
            if model.rigid.names and np.isfinite(report.top_speed):
                model.rigid.finish(state, before)
                report = _faster(report, state, model.rigid)
            return report
        return self._hold(motion, report, collisions)

    def _hold(
        self,
        motion: Iteration,
        report: StepReport,
        collisions: CollisionModel,
    ) -> StepReport:
        """Solve the contacts of a step, linearised again until the true shapes have enough clearance.

        If MOST_PASSES do not suffice, the end with the largest gap counts. If something has passed a surface
        nevertheless, everything rests at the last position before that for the remaining step.
        """
        watch, state, before = Stopwatch(), motion.state, motion.before
        self._free.copy_from(state)
        start = collisions.start(before)
        free = collisions.end(start, self._free)
        place, warm_start = start, before.warm_start
        near, first_slides = collisions.at_start(start, free)
        self._apart = collisions.clearance(near)
        slides: Array | None = first_slides
        best: Pass | None = None
        earlier = warm_start[warm_start[:, 1] > 0.0, 0].astype(np.int64)  # no friction without a normal force
        for count in range(1, MOST_PASSES + 1):
            touching = linearise(collisions, near, start, place, free, slides, earlier, warm_start)
            watch.mark("detect")
            reached, solution, end = self._press(motion, report, touching, (start, free), watch)
            if not reached.top_speed < runaway_speed(collisions.size, self.model.dt):
                return reached
            end = end._replace(state=state)
            self.model.rigid.finish(state, before)
            near = collisions.at_end(end)
            margin = (collisions.free_share(start, end), collisions.clearance(near))
            if collisions.any_astray(touching.near, solution.forces, place, end):
                margin = (margin[0], -math.inf)  # unusable, whatever its clearance
            if best is None or margin > best.margin:
                best = Pass(touching, solution, reached, end, near, margin, state.buffer.copy())
            if margin >= (1.0, collisions.least_gap):
                break
            warm_start = touching.warm_start(solution.forces)
            earlier = np.union1d(earlier, touching.near.key)
            if count < MOST_PASSES:
                share = margin[0]
                place = end if share == 1.0 else collisions.between(start, end, _BEFORE_PASSING * share)
                slides = None if place is end else end.points - place.points
                near = collisions.at(place, free, end)
        assert best is not None
        state.buffer[:] = best.values
        if best.margin[0] < 1.0:
            best = self._cut(best, state, collisions, start)
        state.warm_start = best.touching.warm_start(best.solution.forces)
        self._last = best
        watch.mark("detect")
        return replace(
            best.report,
            times={**report.times, **watch.stages()},
            measure=partial(_measure, best, collisions, count),
        )

    def _press(
        self,
        motion: Iteration,
        report: StepReport,
        touching: LinearisedContacts,
        way: tuple[Place, Place],
        watch: Stopwatch,
    ) -> tuple[StepReport, ContactSolution, Place]:
        """Solve the contacts that press, of all that may.

        Most contacts within the alarm distance bear no force. The first solution is one of those that bore
        one and of those that are about to close. Others that it leaves too close join them; then all do.

        Args:
            motion: The iteration.
            report: Its report.
            touching: All contacts that may bear a force.
            way: Configurations at the start of the step, and at its end without contact forces.
            watch: Measures the stages.

        Returns:
            Report of the step, forces of all contacts (k, 3), and the configuration at the end.
        """
        (start, end), forces = way, touching.forces
        pressing = touching.closing | (forces[:, 0] > 0.0)
        solution = ContactSolution(np.zeros_like(forces), 0.0, 0)
        for rest in (False, True, True):
            motion.state.copy_from(self._free)
            if pressing.any():
                report, solution = self._solve(motion, report, touching, pressing, forces, watch)
                if not math.isfinite(report.top_speed):
                    break
                end = touching.collisions.end(start, motion.state)
            missed = touching.too_close(end) & ~pressing
            if not missed.any():
                break
            pressing, forces = pressing | missed | rest, solution.forces
        return report, solution, end

    def _cut(self, best: Pass, state: State, collisions: CollisionModel, start: Place) -> Pass:
        """Stop everything before something passes through a surface, with the velocities of the end."""
        place = collisions.between(start, best.end._replace(state=state), _BEFORE_PASSING * best.margin[0])
        for name in ("velocities", "reduced_velocities", "rigid_velocities"):
            setattr(place.state, name, getattr(state, name))
        state.buffer[:] = place.state.buffer
        self.model.place_regions(state)
        end = collisions.end(start, state)
        return best._replace(end=end, near=collisions.at_end(end))

    def _solve(
        self,
        motion: Iteration,
        report: StepReport,
        touching: LinearisedContacts,
        pressing: BoolArray,
        warm_forces: Array,
        watch: Stopwatch,
    ) -> tuple[StepReport, ContactSolution]:
        """Find the forces of the contacts `pressing` and add their effect to the free motion.

        Returns:
            Report of the step, and forces (k, 3) of all contacts, without the multipliers of actuators.
        """
        model, h, state, before = self.model, self.model.dt, motion.state, motion.before
        rows, on_rigid = touching.rows(pressing)
        reaches = len(rows.place) > 0  # some contacts act on more than rigid bodies
        acting = len(self.actuators) if reaches else 0
        compliance = np.zeros((len(on_rigid),) * 2)
        transmissions = self.actuators.transmissions_of_step(before, motion.control, model)
        if reaches:
            compliance = motion.compliance(rows)
            compliance *= h * h
        moves = model.rigid.response(before, on_rigid)
        compliance[acting:, acting:] += h * h * (moves @ on_rigid.T)
        multipliers = self.actuators.multipliers(state)[:acting]
        gap, first = touching.gap[pressing].ravel(), warm_forces[pressing].ravel()
        if acting:
            np.einsum("ii->i", compliance)[:acting] += transmissions.compliance
            gap = np.append(motion.violations, gap) - compliance[:, :acting] @ multipliers
            first = np.append(self.actuators.multipliers(before), first)
        watch.mark("compliance")
        friction = touching.friction[pressing]
        wrong = np.zeros_like(gap)  # error of the approximate compliance in each row
        for _ in range(MOST_ROUNDS):
            solution = solve_contacts(
                compliance,
                gap + wrong,
                (transmissions.lower[:acting], transmissions.upper[:acting]),
                friction,
                first,
                touching.settings.iterations,
                touching.settings.tolerance,
            )
            first, forces = solution.forces, solution.forces[acting:]
            watch.mark("forces")
            if not reaches:
                break
            velocities = state.rigid_velocities.copy()
            report = motion.correct(h * np.append(first[:acting] - multipliers, forces))
            state.rigid_velocities = velocities
            watch.mark("correct")
            if motion.defect is None:
                break
            before_it, wrong = wrong, np.append(np.zeros(acting), h * motion.defect)
            off = float(np.abs(wrong - before_it).max(initial=0.0))
            if off <= touching.settings.tolerance:
                break
            solution = solution._replace(residual=max(solution.residual, off))
        if model.rigid.names:
            state.rigid_velocities += (h * (forces @ moves)).reshape(-1, 6)
            model.rigid.advance(state, before, h)
            report = _faster(report, state, model.rigid)
        watch.mark("correct")
        result = np.zeros_like(warm_forces)
        result[pressing] = forces.reshape(-1, 3)
        return report, solution._replace(forces=result)


def _faster(report: StepReport, state: State, rigid: RigidBodies) -> StepReport:
    """Return the report with a top speed in [m/s] that includes the rigid bodies; NaN stays NaN."""
    if not rigid.names or report.top_speed != report.top_speed:
        return report
    speed = float(np.abs(state.rigid_velocities * rigid.speeds).max())
    return report if speed <= report.top_speed else replace(report, top_speed=speed)


def _measure(done: Pass, collisions: CollisionModel, passes: int) -> ContactReport:
    """Return the contacts of the step, measured at its end."""
    touching, solution, near, points = done.touching, done.solution, done.near, done.end.points
    settings = collisions.settings
    gaps, others = measured_gaps(
        touching.near, near, points, collisions.carried.radius, settings.alarm_distance
    )
    forces = np.einsum("kd,kdi->ki", solution.forces, touching.directions)
    pairs = np.concatenate([touching.near.pair, others.pair])
    sides = np.einsum("kc,kci->ki", others.a_weights, points[others.a])
    sides += np.einsum("kc,kci->ki", others.b_weights, points[others.b])
    shown = (touching.near, others)
    return ContactReport(
        points=np.concatenate([touching.points, 0.5 * sides]),
        forces=np.concatenate([forces, np.zeros((len(others.key), 3))]),
        normals=np.concatenate([each.normal for each in shown]),
        gaps=np.concatenate([gaps, others.distance]) - settings.contact_distance,
        pairs=pairs,
        bodies=collisions.owner[pairs],
        body_names=collisions.body_names,
        vertices=np.concatenate([np.concatenate([each.a, each.b], axis=1) for each in shown]),
        weights=np.concatenate([np.concatenate([each.a_weights, each.b_weights], axis=1) for each in shown]),
        residual=solution.residual,
        sweeps=solution.sweeps,
        passes=passes,
    )
