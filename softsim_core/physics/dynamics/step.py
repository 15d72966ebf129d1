"""The time step of a scene: its phases, and the loops over parts of a step and Newton iterations.

The step of nodes, frames, joints and actuators is linear and implicit; see stepper. Around it, in order:

- Parts: a step in which a cell would be torn, or in which surfaces come too close in spite of their contacts,
  is repeated in halves; see substeps.
- State of actuators, such as the gas mass of a pressure line, and memory of viscoelastic bodies: what they
  exert during the part is known at its start, and they advance at its end.
- Scheme: implicit Euler, or Bossak's method; see schemes. Its first step is taken for its accelerations only,
  by implicit Euler. A step with an impact is one of implicit Euler, because the effect of an impact on
  accelerations must be discarded. While a contact is active, Bossak's method damps high frequencies most.
- Newton iterations: the nonlinear step, linearised again about the end of the previous iteration; see
  iterations.
- Contacts and free rigid bodies, solved in each iteration; see contact_step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property, partial
from typing import NamedTuple, Protocol

from softsim_core.base import FactorisationError
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.contact import CollisionModel
from softsim_core.physics.dynamics.contact_step import ContactPhase
from softsim_core.physics.dynamics.iterations import FreeTurning, Newton
from softsim_core.physics.dynamics.memory import Memory
from softsim_core.physics.dynamics.report import StepReport
from softsim_core.physics.dynamics.schemes import Bossak, ImplicitEuler, Scheme
from softsim_core.physics.dynamics.stepper import MasslessStepper, Stepper
from softsim_core.physics.dynamics.substeps import (
    StepParts,
    StrainWatch,
    control_of_first_half,
    torn_by_rough_steps,
)
from softsim_core.physics.mechanics import HOLDING, Control, Model, Parameters, State


class StepSettings(NamedTuple):
    """How a step is computed.

    Attributes:
        iterations: Largest number of Newton iterations, >= 1.
        tolerance: Iterations end once one has moved no node farther than this, in [m].
        spectral_radius: Of Bossak's method, 0 to 1; None: implicit Euler.
        parts: Largest number of parts of a step, a power of two.
    """

    iterations: int = 1
    tolerance: float = 0.0
    spectral_radius: float | None = None
    parts: int = 1


class MakeStepper(Protocol):
    """Makes the implementation of the linear step of a model, like that of another copy of the scene."""

    def __call__(self, model: Model, *, like: Stepper | None) -> Stepper:
        """Return the stepper; see backends.make_stepper."""
        ...


class Phases:
    """Phases of a step of one dt, planned once.

    Args:
        model: The model; its dt is that of the step.
        actuators: Its actuators.
        collisions: Its collision surfaces; None: there are none.
        settings: How a step is computed.
        newton: Makes the Newton iterations of a scheme.

    Attributes:
        model, actuators: The arguments.
        euler: Newton iterations of implicit Euler.
        contacts: Contacts and rigid bodies.
        memory: Memory of viscoelastic bodies.
        start: Copy of the state at the start of the step, with the stress that `memory` knows.
        keeps_start: Whether `solvers` needs `start`.
        responds: Whether impulses are added to an iteration.
    """

    def __init__(
        self,
        model: Model,
        actuators: Actuators,
        collisions: CollisionModel | None,
        settings: StepSettings,
        newton: Callable[[Scheme], Newton],
    ) -> None:
        self.model, self.actuators, self.start = model, actuators, model.empty_state()
        self.euler = newton(ImplicitEuler(model))
        self._smooth: list[tuple[Newton, Bossak]] = []  # without active contacts, and with them
        if settings.spectral_radius is not None:
            radii = [settings.spectral_radius] + [0.0] * (collisions is not None)
            schemes = [Bossak(model, radius) for radius in radii]
            self._smooth = [(newton(scheme), scheme) for scheme in schemes]
        self.keeps_start = bool(self._smooth)
        self.contacts = ContactPhase(model, actuators, collisions)
        self.memory = Memory(model, self.euler.stepper.compiled)
        self.responds = self.euler.most > 1 or collisions is not None

    def begin_actuators(self, state: State, control: Control) -> Control:
        """Return the control with what actuators with internal state exert during the step."""
        if not self.actuators.internal_size:
            return control
        transmissions = self.actuators.begin(self.model, state, control.targets)
        return replace(control, transmissions=transmissions)

    def solvers(self, state: State) -> Iterator[Newton]:
        """Yield the solvers whose steps are to be done one after the other; the last one counts."""
        if not self._smooth:
            yield self.euler
            return
        holding = state.extra[HOLDING]
        newton, scheme = self._smooth[min(int(holding[0]), len(self._smooth) - 1)]
        if not scheme.goes_on(state):
            yield self.euler
            scheme.take_back(state, self.start)
        yield newton
        if self.contacts.has_struck(self.start):
            state.copy_from(self.start)
            yield self.euler
            scheme.forget_acceleration(state)
        holding[:] = len(self.contacts.active) > 0


class TimeStep:
    """The time step of a scene.

    Args:
        model, actuators: The model and its actuators.
        settings: How a step is computed.
        make_stepper: Makes the implementation of the linear step.
        collisions_of: Returns the collision surfaces of the model with some dt; None: there are none.
        like: Time step of another copy of the scene that never runs at the same time: the plans and buffers
            of its steppers are used again.

    Attributes:
        model, actuators: The arguments.
        stepper: The linear step, for everything but steps: static tangents, stresses.
    """

    def __init__(
        self,
        model: Model,
        actuators: Actuators,
        settings: StepSettings,
        make_stepper: MakeStepper,
        collisions_of: Callable[[Model], CollisionModel | None],
        like: TimeStep | None = None,
    ) -> None:
        self.model, self.actuators = model, actuators
        self._settings, self._make_stepper, self._collisions_of = settings, make_stepper, collisions_of
        self._like, self._steppers = like, list[Stepper]()
        if settings.spectral_radius is not None and FreeTurning(model).bodies and settings.iterations < 2:
            # linearised once, a free body gains energy as it rotates
            self._settings = settings._replace(iterations=2)
        self._phases = [self._plan(model)]
        self.stepper = self._steppers[0]
        watched = torn_by_rough_steps(model.groups) if settings.parts > 1 else []
        self._strains = StrainWatch(watched, self.stepper.compiled)
        cuts = bool(watched) or self._phases[0].contacts.collisions is not None
        self._deepest = settings.parts.bit_length() - 1 if cuts else 0

    @cached_property
    def massless(self) -> MasslessStepper | None:
        """Its stepper without mass, for statics; see Stepper.without_mass."""
        return self.stepper.without_mass()

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance `state` by one dt, in place; the caller decides by the report whether to accept it.

        Raises:
            ArrayError: the control is for another model.
            DetectionOverflowError: more contacts than fit into memory.
            FactorisationError: the matrix of the step is singular.
        """
        parts, waiting = StepParts(state), [(0, control)]
        while waiting:  # the step, or the parts left of it
            depth, inputs = waiting.pop()
            phases = self._phases_of(depth)
            driven = phases.begin_actuators(state, inputs)
            stressed = phases.memory.begin(state, parameters)
            if phases.keeps_start or depth < self._deepest:
                phases.start.copy_from(state)
            try:
                for newton in phases.solvers(state):
                    iteration, solved = newton.first(state, driven, stressed, phases.responds)
                    report = phases.contacts.correct(iteration, solved)
                    while iteration.wants_more():
                        following, solved = newton.next(iteration, state)
                        corrected = phases.contacts.correct(following, solved)
                        if following.strays():
                            break
                        iteration, report = following, corrected
                    if not math.isfinite(report.top_speed):
                        break
                phases.memory.end(state, parameters)
                phases.actuators.end(phases.model, state, inputs.targets)
                parts.times.append(report.times)
                failed = phases.contacts.failed or self._strains.is_rough(phases.start, state)
                accepted = depth == self._deepest or not failed
            except FactorisationError:
                if depth == self._deepest:
                    raise
                accepted = False
            if accepted:
                report.estimate = partial(newton.next_move, iteration, phases.contacts.correct)
                parts.accept(0.5**depth, state, inputs, report)
            else:  # again in halves, the first one next
                state.copy_from(phases.start)
                first = control_of_first_half(phases.model, phases.actuators, state, inputs)
                waiting += [(depth + 1, inputs), (depth + 1, first)]
        return parts.finish(state, report)

    def _phases_of(self, depth: int) -> Phases:
        """Return the phases of a part of dt / 2^depth, planned on first use."""
        while len(self._phases) <= depth:
            dt = self.model.dt / 2 ** len(self._phases)
            self._phases.append(self._plan(replace(self.model, dt=dt)))
        return self._phases[depth]

    def _plan(self, model: Model) -> Phases:
        return Phases(model, self.actuators, self._collisions_of(model), self._settings, self._newton)

    def _newton(self, scheme: Scheme) -> Newton:
        earlier = [] if self._like is None else self._like._steppers[len(self._steppers) :]
        stepper = self._make_stepper(scheme.solved, like=earlier[0] if earlier else None)
        self._steppers.append(stepper)
        return Newton(stepper, scheme, self._settings.iterations, self._settings.tolerance)
