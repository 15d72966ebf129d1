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
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.actuation import drive_stiffness
from softsim_core.physics.dynamics.assembly import top_speed, viscosity_matrix, viscous_forces
from softsim_core.physics.dynamics.report import StepReport
from softsim_core.physics.dynamics.stepper import FreeMotion, Stepper, StepperAround
from softsim_core.physics.fem import cell_forces, cell_stiffness, mean_volume_answer
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


class IteratedStepper(StepperAround):
    """Advance by up to `most` Newton iterations of an implicit Euler step.

    Args:
        inner: Implicit Euler stepper, linearised once.
        most: Largest number of iterations, >= 1.
        tolerance: Iterations stop once one has moved no node farther than this, in [m]. An iteration that
            moves a node farther than the one before did is taken back and is the last.

    Attributes:
        inner, most, tolerance: As given.
        begun: Number of steps so far.
        before: State at the start of the step.
        reached: State about which the newest iteration is linearised.
        saved: Copy of that state with the velocities of the step, to restore it.
    """

    def __init__(self, inner: Stepper, most: int = 1, tolerance: float = 0.0) -> None:
        super().__init__(inner)
        model = inner.model
        self.inner, self.most, self.tolerance, self.begun = inner, most, tolerance, 0
        self.before, self.reached, self.saved = (model.empty_state() for _ in range(3))
        self._start, self._trial = model.empty_state(), model.empty_state()
        self._turning, self._drive = FreeTurning(model), drive_stiffness(model)
        self._inertia = np.array([joint.inertia for joint in model.joints])
        self._compliant = model.compliant_joints
        others = np.append(self._compliant, self.actuators.joint)
        self._driven = np.setdiff1d(np.arange(len(model.joints)), others)

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance the state by one dt with up to `most` Newton iterations, in place."""
        if self.most > 1:
            motion = self.free_motion(state, control, parameters)
            while motion.wants_more():
                further = motion.again(state)
                if further.strays():
                    break
                motion = further
            return replace(motion.report, estimate=partial(self.next_move, motion))
        self._begin(state)
        report = self.inner.step(state, control, parameters)
        report.estimate = partial(self._move_after, self.begun, state, control, parameters)
        report.dilate = partial(self.dilation, self.begun, state, parameters)
        return report

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> IteratedFreeMotion:
        """Return the unconstrained motion of the first Newton iteration."""
        self._begin(state)
        motion = self.inner.free_motion(state, control, parameters)
        return IteratedFreeMotion(self, motion, state, control, parameters)

    def _begin(self, state: State) -> None:
        self.before.copy_from(state)
        self.begun += 1

    def next_move(
        self, motion: IteratedFreeMotion, complete: Callable[[IteratedFreeMotion], object] | None = None
    ) -> float:
        """Return the largest node displacement of one more iteration in [m]; NaN once another step has begun.

        Args:
            motion: The last iteration.
            complete: Completes an iteration, for example by solving the contacts.
        """
        if motion.begun != self.begun:
            return math.nan
        trial = self._trial
        trial.copy_from(motion.state)
        if (trial.base_positions != self.before.base_positions).any():  # the base was moved since
            trial.base_positions[:] = self.before.base_positions
            self.model.place_regions(trial)
        start = trial.positions.copy()
        further = motion.again(trial)
        if complete is not None:
            complete(further)
        return farthest(start, trial.positions)

    def dilation(self, begun: int, state: State, parameters: Parameters) -> float:
        """Return the largest spurious strain that turning adds to a body in the first iteration.

        NaN if the stepper has begun another step than number `begun` since.
        """
        if begun != self.begun:
            return math.nan
        strain = self._turning.dilation(self.before.positions, state.positions)
        return strain * (1.0 + parameters.rayleigh_stiffness / self.model.dt)

    def _move_after(self, begun: int, state: State, control: Control, parameters: Parameters) -> float:
        """Return `next_move` after a step of a single iteration."""
        if begun != self.begun:
            return math.nan
        return self.next_move(IteratedFreeMotion(self, None, state, control, parameters))

    def about(self, state: State, control: Control, parameters: Parameters) -> FreeMotion:
        """Return the unconstrained step that is the next iteration about `state`."""
        model, h, before, reached, start = self.model, self.model.dt, self.before, self.reached, self._start
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
        return self.inner.free_motion(start, control, parameters)

    def _strain_rates(self, reached: State) -> Array:
        """Return velocities (n, 3) in [m/s] over the step, without the rigid motion of the bodies."""
        begun = self.before.positions
        if reached.base_shift[0] != self.before.base_shift[0]:  # bases are placed again, not moved
            trial = self._trial
            trial.copy_from(self.before)
            trial.base_shift[:] = reached.base_shift
            self.model.place_regions(trial)
            begun = trial.positions
        turned = self._turning.fit_rigidly(begun, reached.positions)
        return np.asarray((reached.positions - turned) / self.model.dt)

    def _compute_strain_forces(self, parameters: Parameters, straining: Array) -> Array:
        """Return (f(x_k) - f(x)) / h + K v in [N/s] of layers, fibres and rods about `reached`, shape (n, 3).

        The step subtracts K v again; f(x) rotates with the bodies.
        """
        at, result = self.reached.positions, np.zeros_like(straining)
        begun = at - self.model.dt * straining
        for group in self.model.groups:
            if isinstance(group.material, StrainMaterial):
                p = group.values(parameters.materials)
                stiffness = cell_stiffness(group, at, p, positive=True, moved=self.reached.extra[MOVED])
                answer = np.einsum("mabij,mbj->mai", stiffness, straining[group.cells])
                answer += (cell_forces(group, at, p) - cell_forces(group, begun, p)) / self.model.dt
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
        model, h, before = self.model, self.model.dt, self.before
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
        return state.reduced_velocities[6 * len(self.model.frame_names) :]

    def _gains(self, state: State) -> Array:
        """Return the inertial effort of each joint since the step's start in [N m] or [N], shape (j,)."""
        gained = self._joint_rates(state) - self._joint_rates(self.before)
        return np.asarray(self._inertia * gained / self.model.dt)


class IteratedFreeMotion:
    """Unconstrained motion of one Newton iteration, from which the next one can start.

    Args:
        stepper: Stepper of the iteration.
        motion: Unconstrained step of the iteration; None: the iteration is over.
        state: State that it is written into.
        control, parameters: Control and parameters of the step.
        earlier: The previous iteration; None: this is the first.

    Attributes:
        count: Number of iterations so far.
        begun: Number of the stepper's step.
        moved: Largest node displacement of the iteration in [m]; set by `wants_more`.
    """

    def __init__(
        self,
        stepper: IteratedStepper,
        motion: FreeMotion | None,
        state: State,
        control: Control,
        parameters: Parameters,
        earlier: IteratedFreeMotion | None = None,
    ) -> None:
        self.state, self.before, self.begun = state, stepper.before, stepper.begun
        self.moved, self.report = math.inf, StepReport()
        self._stepper, self._motion, self._control, self._parameters = stepper, motion, control, parameters
        self.count, self._last, self._times = 1, math.inf, Counter[str]()
        self._from, self._fallback = stepper.before.positions, 0
        if earlier is not None:
            self.count, self._last = earlier.count + 1, earlier.moved
            self._from, self._fallback = stepper.reached.positions, earlier.report.fallback
            self._times.update(earlier.report.times)
        self.violations = np.zeros(0) if motion is None else motion.violations
        if motion is not None:
            self.report = self._complete_report(motion.report)

    @property
    def defect(self) -> Array | None:
        """Row velocities in [m/s] that the approximate compliance left out, shape (r,); None: it is exact."""
        return None if self._motion is None else self._motion.defect

    def wants_more(self) -> bool:
        """Return whether another iteration should follow; `state` is the end of this one."""
        if self.count >= self._stepper.most:
            return False
        self.moved = farthest(self._from, self.state.positions)
        return self.moved > self._stepper.tolerance

    def strays(self) -> bool:
        """Return whether this iteration moved farther than the last; then restore `state` from before it.

        The third iteration may move twice as far, because the second one may find little where the third
        finds more. Further iterations must be shorter.
        """
        moved = farthest(self._from, self.state.positions)
        if moved <= max(self._last * (2.0 if self.count == 3 else 1.0), self._stepper.tolerance):
            return False
        self.state.copy_from(self._stepper.saved)
        return True

    def again(self, state: State) -> IteratedFreeMotion:
        """Return the next iteration, about `state` and written into it.

        Contacts are not included, and rigid bodies are as at the start of the step.
        """
        stepper, control = self._stepper, self._control
        stepper.saved.copy_from(state)
        stepper.before.warm_start = state.warm_start
        motion = stepper.about(state, control, self._parameters)
        for name in _RIGID:
            setattr(state, name, getattr(stepper.before, name))
        stepper.take(state, motion.state, control)
        return IteratedFreeMotion(stepper, motion, state, control, self._parameters, self)

    def compliance(self, rows: Rows) -> Array:
        """Return the compliance H A^-1 H^T of actuators and rows in [1/kg], shape (c + r, c + r)."""
        assert self._motion is not None
        return self._motion.compliance(rows)

    def correct(self, impulses: Array) -> StepReport:
        """Add the effect of impulses [N s] on the rows to this iteration's free motion, in place."""
        assert self._motion is not None
        report = self._motion.correct(impulses)
        if self.count > 1:
            self._stepper.take(self.state, self._motion.state, self._control)
        return self._complete_report(report)

    def _complete_report(self, report: StepReport) -> StepReport:
        if self.count == 1:
            report.dilate = partial(self._stepper.dilation, self.begun, self.state, self._parameters)
            return report
        return replace(
            report,
            top_speed=top_speed(self._stepper.model, self.state),
            times=dict(self._times + Counter(report.times)),
            fallback=max(self._fallback, report.fallback),
            iterations=self.count,
        )


def farthest(before: Array, after: Array) -> float:
    """Return the largest distance in [m] between places (n, 3); NaN if a place is NaN."""
    return float(np.sqrt(((after - before) ** 2).sum(axis=1).max(initial=0.0)))
