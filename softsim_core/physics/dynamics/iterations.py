r"""Further Newton iterations of an implicit Euler step, and the rotation of whole bodies within one.

Stiffness-proportional damping acts on changing strains, and a rotation of the body changes none. In a step of
h that rotates a body by R, the nodes at x move by (R - I) x. The velocity (R - I) x / h, taken as a strain
rate, has the contraction

.. math:: \frac{\cos a - 1}{h} \approx -\frac{a^2}{2 h} = -\frac{h \omega^2}{2}

so K v would stretch the body by :math:`r_K h \omega^2 / 2`, and the stiffness within a linearised step by
:math:`h^2 \omega^2 / 2`. Iterated steps use the displacement of the nodes without the rotation of their body.

A step that is linearised once does the same for bodies without fixed nodes and of laws with a potential. It
adds the force -lag K v to the right-hand side. K of stressed elements responds to a rotation w of the body
with the rotation of its forces, K (w x r) = -w x f. That is right to first order, but evaluated at the start
of the step, which slows the spin of a free body by (h w)^2 per step. All other bodies use K v as the
reference simulator does, and are dilated as above; see StepReport.dilation.

From nodes x and velocities v at the start of a step of h, the nonlinear step requires at its end

.. math:: M (v^+ - v) + h\, r_M M v^+ + h\, r_K K(x^+) v^+ = h\, f(x^+), \qquad x^+ = x + h v^+ .

A step of `Stepper` is the first Newton iteration, about x. Where iterations have reached x_k, with
v_k = (x_k - x) / h, the next one solves for y = v^+ - v_k, about x_k:

.. math:: ((1 + h r_M) M + h (h + r_K) K(x_k))\, y = h f(x_k) - M (v_k - v) - h\, r_M M v_k - h\, r_K K v_k .

This is a step of the same stepper from x_k at rest under additional forces, so that contacts, actuators and
the stress that cells take from the last linear solve are handled as in any step. Contacts are solved again in
each iteration. The error of an iteration is about the square of the previous one, in [m] per size of the
body; with stiffness-proportional damping, whose K follows x without a derivative, it is a share of the
previous one that grows with r_K / h.

In all of these, r_K K acts on the displacement x^+ - x without the rotation of the body as a whole. Only
steps of one iteration damp K v^+ as it is, as the reference simulator does.

Cells that are axially stiff and flexible in bending, such as layers, fibres and rods, have the damping force

.. math:: \frac{r_K}{h} \bigl(f(x^+) - f(x)\bigr)

instead, which is the same to first order, with x rotated with the body. K v would treat a rotation of a part
by the angle a within the step as a strain of a^2 / 2, which outweighs all bending; and here K has the
derivative of all terms. The damping of the rods' law uses the change of the strains from x to x^+ in the same
way.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.actuation import drive_stiffness
from softsim_core.physics.dynamics.assembly import top_speed, viscosity_matrix, viscous_forces
from softsim_core.physics.dynamics.report import StepReport
from softsim_core.physics.dynamics.schemes import ImplicitEuler, Scheme
from softsim_core.physics.dynamics.stepper import FreeMotion, Stepper
from softsim_core.physics.fem import LinearMove, cell_forces, cell_stiffness, mean_volume_answer
from softsim_core.physics.fem.materials import StrainMaterial
from softsim_core.physics.mechanics import (
    FREE,
    MOVED,
    Control,
    Model,
    Parameters,
    Rows,
    State,
    rotation_exp,
    rotation_log,
)


class FreeTurning:
    """Bodies of a model, divided into freely rotating ones and others.

    A freely rotating body has no fixed nodes and only laws with a potential.

    Attributes:
        bodies: Nodes of each freely rotating body, shape (k,).
        attached: Nodes of each of the others, shape (k,).
    """

    def __init__(self, model: Model) -> None:
        self._mass, self._dt = model.mass, model.dt
        attached: set[int] = set()
        nodes: dict[int, list[Array]] = {}
        for group in model.groups:
            for body in np.unique(group.body).tolist():
                own = np.unique(group.cells[group.body == body])
                nodes.setdefault(body, []).append(own)
                still = (model.region_of_node[own] != FREE).any() or model.spring[own].any()
                if still or not group.material.has_potential:
                    attached.add(body)
        every = {body: np.unique(np.concatenate(own)) for body, own in nodes.items()}
        self.bodies = [own for body, own in every.items() if body not in attached]
        self.attached = [own for body, own in every.items() if body in attached]

    def lagging(self, state: State, control: Control, share: float) -> Array:
        """Return the velocities (n, 3) by which a step multiplies K, plus a `share` of `control.carried`."""
        result = self._without_turning(state.positions, state.velocities)
        return result if control.carried is None else np.asarray(result + share * control.carried)

    def fit_rigidly(self, places: Array, onto: Array) -> Array:
        """Return places (n, 3) in [m] with each body moved rigidly to fit its position in `onto` (n, 3)."""
        result = places.copy()
        for own in (*self.bodies, *self.attached):
            centre, middle, rotation = self._fit_rigid_motion(own, places, onto)
            result[own] = middle + (places[own] - centre) @ rotation
        return result

    def dilation(self, before: Array, after: Array) -> float:
        """Return the largest a^2 / 2 of the held bodies, which turn by a between places (n, 3) in [m]."""
        turns = [self._fit_rigid_motion(own, before, after)[2] for own in self.attached]
        return max((0.5 * (3.0 - float(np.trace(turn))) for turn in turns), default=0.0)

    def _fit_rigid_motion(self, own: Array, places: Array, onto: Array) -> tuple[Array, Array, Array]:
        """Return a body's centres of mass (3,) at both places, and its rotation R: x R for arms x (k, 3)."""
        mass = self._mass[own, None]
        centre, middle = ((mass * each[own]).sum(axis=0) / mass.sum() for each in (places, onto))
        u, _, vt = np.linalg.svd((mass * (places[own] - centre)).T @ (onto[own] - middle))
        u[:, 2] *= np.linalg.det(u @ vt)  # no reflection
        return centre, middle, u @ vt

    def _without_turning(self, positions: Array, velocities: Array) -> Array:
        """Return velocities (n, 3) in [m/s] without the rotation of free bodies about their centres."""
        if not self.bodies:
            return velocities
        result = velocities.copy()
        for own in self.bodies:
            mass, points = self._mass[own, None], positions[own]
            total = mass.sum()
            arms = points - (mass * points).sum(axis=0) / total
            drift = velocities[own] - (mass * velocities[own]).sum(axis=0) / total
            momentum = np.cross(arms, mass * drift).sum(axis=0)
            inertia = (mass * (arms**2).sum(axis=1, keepdims=True)).sum() * np.eye(3) - (mass * arms).T @ arms
            spin = np.linalg.lstsq(inertia, momentum, rcond=None)[0]
            result[own] -= arms @ (rotation_exp(self._dt * spin).T - np.eye(3)) / self._dt
        return result


_TAKEN = (
    "positions",
    "frame_positions",
    "frame_rotations",
    "joint_positions",
    "joint_efforts",
    "base_shift",
)
_RIGID = ("rigid_positions", "rigid_rotations", "rigid_velocities")


class _Inputs(NamedTuple):
    """Inputs of one step.

    Attributes:
        number: Number of the step, counted by its `Newton`.
        control: Control of the scheme's own step.
        solved, parameters: Control and parameters of the implicit Euler step that is solved instead.
    """

    number: int
    control: Control
    solved: Control
    parameters: Parameters


class Newton:
    """Newton iterations of an implicit step by one time integration scheme.

    Args:
        stepper: Solves an implicit Euler step of `scheme.solved`, linearised once.
        scheme: Time integration scheme.
        most: Largest number of iterations, >= 1.
        tolerance: Iterations stop once one has moved no node farther than this, in [m]. An iteration that
            moves a node farther than the one before did is taken back and is the last.

    Attributes:
        stepper, scheme, most, tolerance: The arguments.
        number: Number of steps so far.
        before: State at the start of the scheme's own step.
        entered: State at the start of the implicit Euler step that is solved instead.
        reached: State about which the newest iteration is linearised.
        saved: Copy of that state with the velocities of the step, to restore it.
    """

    def __init__(self, stepper: Stepper, scheme: Scheme, most: int = 1, tolerance: float = 0.0) -> None:
        self.stepper, self.scheme, self.most, self.tolerance, self.number = (
            stepper,
            scheme,
            most,
            tolerance,
            0,
        )
        self._model = model = stepper.model
        self.before, self.reached, self.saved = (model.empty_state() for _ in range(3))
        self.entered = self.before if isinstance(scheme, ImplicitEuler) else model.empty_state()
        self._start, self._trial = model.empty_state(), model.empty_state()
        self._turning, self._drive = FreeTurning(model), drive_stiffness(model)
        self._inertia = np.array([joint.inertia for joint in model.joints])
        self._compliant = model.compliant_joints
        others = np.append(self._compliant, stepper.actuators.joint)
        self._driven = np.setdiff1d(np.arange(len(model.joints)), others)

    def first(
        self, state: State, control: Control, parameters: Parameters, responds: bool = True
    ) -> tuple[Iteration, StepReport]:
        """Return the first iteration of a step from `state`, which becomes its end, and its report.

        Args:
            state: State at the start of the step.
            control: Control of the step.
            parameters: Parameters of the step.
            responds: Whether `compliance` and `correct` of the iteration will be called.
        """
        self.number += 1
        self.before.copy_from(state)
        solved, parameters = self.scheme.enter(state, self.before, control, parameters)
        if self.entered is not self.before:
            self.entered.copy_from(state)
        inputs = _Inputs(self.number, control, solved, parameters)
        if responds:
            motion = self.stepper.free_motion(state, solved, parameters)
            iteration, report = Iteration(self, inputs, state, motion), motion.report
        else:
            iteration, report = Iteration(self, inputs, state), self.stepper.step(state, solved, parameters)
        return iteration, iteration.complete(report)

    def next(self, iteration: Iteration, state: State) -> tuple[Iteration, StepReport]:
        """Return the iteration that follows `iteration`, about `state` and written into it, and its report.

        Contacts are not included, and rigid bodies are as at the start of the step.
        """
        self.saved.copy_from(state)
        self.entered.warm_start = state.warm_start  # `before` too, but for Bossak's method
        motion = self._linearise(state, iteration.inputs)
        for name in _RIGID:
            setattr(state, name, getattr(self.before, name))
        self.take(state, motion.state, iteration.inputs.solved)
        following = Iteration(self, iteration.inputs, state, motion, iteration)
        return following, following.complete(motion.report)

    def next_move(self, iteration: Iteration, correct: Callable[[Iteration, StepReport], object]) -> float:
        """Return the largest node displacement of one more iteration in [m]; NaN once another step has begun.

        Args:
            iteration: The last iteration.
            correct: Solves the contacts of an iteration.
        """
        if iteration.inputs.number != self.number:
            return math.nan
        trial = self._trial
        trial.copy_from(iteration.state)
        if (trial.base_positions != self.before.base_positions).any():  # the base was moved since
            trial.base_positions[:] = self.before.base_positions
            self._model.place_regions(trial)
        start = trial.positions.copy()
        correct(*self.next(iteration, trial))
        return farthest(start, trial.positions)

    def dilation(self, number: int, state: State, parameters: Parameters) -> float:
        """Return the largest spurious strain that turning adds to a body in the first iteration.

        NaN if another step than number `number` has begun since.
        """
        if number != self.number:
            return math.nan
        strain = self._turning.dilation(self.before.positions, state.positions)
        return strain * (1.0 + parameters.rayleigh_stiffness / self._model.dt)

    def _linearise(self, state: State, inputs: _Inputs) -> FreeMotion:
        """Return the unconstrained step that is the next iteration about `state`."""
        model, h, before, reached, start = (
            self._model,
            self._model.dt,
            self.entered,
            self.reached,
            self._start,
        )
        control, parameters = inputs.solved, inputs.parameters
        reached.copy_from(state)
        self._set_rates(reached)
        start.copy_from(reached)
        start.velocities[:], start.reduced_velocities[:] = 0.0, 0.0
        rates, damping, carried = reached.velocities, parameters.rayleigh_stiffness, None
        gained = (1.0 + h * parameters.rayleigh_mass) * rates - before.velocities
        forces = control.forces - model.momentum(gained) / h
        if damping > 0.0:
            straining = carried = self._strain_rates(reached)
            for group in model.groups:  # the mean volume is not damped
                p = group.values(parameters.materials)
                answer = mean_volume_answer(group, reached.positions, p, straining)
                forces += h / (h + damping) * damping * answer
            forces += damping * self._compute_strain_forces(parameters, straining)
            viscous = viscosity_matrix(model, reached, parameters)
            if viscous is not None:  # damping of the rods' laws uses the strains' change
                forces += damping / (h + damping) * (viscous @ straining.ravel()).reshape(-1, 3)
        dragging = viscous_forces(model, before.positions, reached.positions, parameters, h)
        if dragging is not None:
            forces += dragging
        targets, compliant = control.targets, self._compliant
        if len(compliant):
            rate, gains = self._joint_rates(reached)[compliant], self._gains(reached)[compliant]
            targets = targets.copy()
            targets[compliant] -= gains / self._drive[compliant] + damping * rate
        control = replace(control, targets=targets, forces=forces, carried=carried)
        return self.stepper.free_motion(start, control, parameters)

    def _strain_rates(self, reached: State) -> Array:
        """Return velocities (n, 3) in [m/s] over the step, without the rigid motion of the bodies."""
        begun = self.before.positions
        if reached.base_shift[0] != self.before.base_shift[0]:  # bases are placed again, not moved
            trial = self._trial
            trial.copy_from(self.before)
            trial.base_shift[:] = reached.base_shift
            self._model.place_regions(trial)
            begun = trial.positions
        turned = self._turning.fit_rigidly(begun, reached.positions)
        return np.asarray((reached.positions - turned) / self._model.dt)

    def _compute_strain_forces(self, parameters: Parameters, straining: Array) -> Array:
        """Return (f(x_k) - f(x)) / h + K v in [N/s] of layers, fibres and rods about `reached`, shape (n, 3).

        The step subtracts K v again; f(x) rotates with the bodies.
        """
        at, result = self.reached.positions, np.zeros_like(straining)
        begun = at - self._model.dt * straining
        for group in self._model.groups:
            if isinstance(group.material, StrainMaterial):
                p, moved = group.values(parameters.materials), self.reached.extra[MOVED]
                last = LinearMove(at - moved, moved)
                stiffness = cell_stiffness(group, at, p, positive=True, last=last)
                answer = np.einsum("mabij,mbj->mai", stiffness, straining[group.cells])
                answer += (cell_forces(group, at, p) - cell_forces(group, begun, p)) / self._model.dt
                np.add.at(result, group.cells, answer)
        return result

    def take(self, state: State, end: State, control: Control) -> None:
        """Write the end of an iteration into `state`, without the rigid bodies."""
        for name in _TAKEN:
            getattr(state, name)[:] = getattr(end, name)
        if MOVED in state.extra:
            state.extra[MOVED][:] = end.extra[MOVED]
        self._set_rates(state)
        state.joint_efforts[self._driven] += self._gains(state)[self._driven]
        springs = self._drive * (control.targets - state.joint_positions)
        state.joint_efforts[self._compliant] = springs[self._compliant]

    def _set_rates(self, state: State) -> None:
        """Set velocities from the displacements since the start of the step."""
        model, h, before = self._model, self._model.dt, self.before
        free = model.free_nodes
        state.velocities[free] = (state.positions[free] - before.positions[free]) / h
        for f in range(len(model.frame_names)):
            gone = state.frame_positions[f] - before.frame_positions[f]
            turn = rotation_log(state.frame_rotations[f] @ before.frame_rotations[f].T)
            state.reduced_velocities[6 * f : 6 * f + 6] = np.concatenate([gone, turn]) / h
        self._joint_rates(state)[:] = (state.joint_positions - before.joint_positions) / h
        if model.regions:
            model.place_regions(state)

    def _joint_rates(self, state: State) -> Array:
        return state.reduced_velocities[6 * len(self._model.frame_names) :]

    def _gains(self, state: State) -> Array:
        """Return the inertial effort of each joint since the step's start in [N m] or [N], shape (j,)."""
        gained = self._joint_rates(state) - self._joint_rates(self.entered)
        return np.asarray(self._inertia * gained / self._model.dt)


class Iteration:
    """One Newton iteration: the unconstrained end of the step, and its response to impulses on rows.

    Args:
        newton: Iterations that it belongs to.
        inputs: Inputs of the step.
        state: State that its end is written into.
        motion: Unconstrained step of the iteration; None: no impulses will be added.
        earlier: The previous iteration; None: this is the first.

    Attributes:
        state, inputs: The arguments.
        before: State at the start of the step.
        control: Control of the step.
        count: Number of iterations so far.
        violations: See FreeMotion.
        times, fallback: See StepReport; those of all iterations so far.
    """

    def __init__(
        self,
        newton: Newton,
        inputs: _Inputs,
        state: State,
        motion: FreeMotion | None = None,
        earlier: Iteration | None = None,
    ) -> None:
        self.state, self.inputs, self.before, self.control = state, inputs, newton.before, inputs.control
        self._newton, self._motion, self._moved = newton, motion, math.inf
        self.times: Mapping[str, float] = {}
        self.count, self.fallback, self._last, self._from = 1, 0, math.inf, newton.before.positions
        if earlier is not None:
            self.count, self._last, self._from = earlier.count + 1, earlier._moved, newton.reached.positions
            self._earlier_times, self.fallback = earlier.times, earlier.fallback
        self.violations = np.zeros(0) if motion is None else motion.violations

    @property
    def defect(self) -> Array | None:
        """Row velocities in [m/s] that the approximate compliance left out, shape (r,); None: it is exact."""
        left = None if self._motion is None else self._motion.defect
        return None if left is None else self._newton.scheme.ratio * left

    def wants_more(self) -> bool:
        """Return whether another iteration should follow; `state` is the end of this one."""
        if self.count >= self._newton.most:
            return False
        self._moved = farthest(self._from, self.state.positions)
        return self._moved > self._newton.tolerance

    def strays(self) -> bool:
        """Return whether this iteration moved farther than the last; then restore `state` from before it.

        The third iteration may move twice as far, because the second one may find little where the third
        finds more. Further iterations must be shorter.
        """
        moved = farthest(self._from, self.state.positions)
        if moved <= max(self._last * (2.0 if self.count == 3 else 1.0), self._newton.tolerance):
            return False
        self.state.copy_from(self._newton.saved)
        return True

    def compliance(self, rows: Rows) -> Array:
        """Return the compliance H A^-1 H^T of actuators and rows in [1/kg], shape (c + r, c + r).

        It is a displacement at the end of the step per force and dt^2.
        """
        assert self._motion is not None
        compliance = self._motion.compliance(rows)
        compliance *= self._newton.scheme.ratio**2
        return compliance

    def correct(self, impulses: Array) -> StepReport:
        """Add the effect of impulses on the rows to this iteration's unconstrained motion, in place.

        An impulse in [N s] is the force at the end of the step times dt.
        """
        assert self._motion is not None
        report = self._motion.correct(self._newton.scheme.ratio * impulses)
        if self.count > 1:
            self._newton.take(self.state, self._motion.state, self.inputs.solved)
        return self.complete(report)

    def complete(self, report: StepReport) -> StepReport:
        """Make the state the end of the scheme's own step; return the report of all iterations so far.

        `report` is that of the linear solve.
        """
        newton, inputs = self._newton, self.inputs
        if self.count == 1:
            report.dilate = partial(newton.dilation, inputs.number, self.state, inputs.parameters)
        else:
            report = replace(
                report,
                top_speed=top_speed(newton.scheme.solved, self.state),
                times=dict(Counter(self._earlier_times) + Counter(report.times)),
                fallback=max(self.fallback, report.fallback),
                iterations=self.count,
            )
        self.times, self.fallback = report.times, report.fallback
        return newton.scheme.leave(self.state, self.before, self.control, report)


def farthest(before: Array, after: Array) -> float:
    """Return the largest distance in [m] between places (n, 3); NaN if a place is NaN."""
    return float(np.sqrt(((after - before) ** 2).sum(axis=1).max(initial=0.0)))
