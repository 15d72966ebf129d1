"""Interface of a time step, its unconstrained motion and its static tangent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from softsim_core.base import Array
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.dynamics.report import StepReport
from softsim_core.physics.mechanics import Control, Model, Parameters, Rows, State


class Stepper(Protocol):
    """One implicit Euler step, linearised once, with all frames and joints solved together with the nodes.

    With h = dt, r_K and r_M the Rayleigh coefficients, K the stiffness of the elements at x:

        A dv = b,   A = (1 + h r_M) M + h (h + r_K) K,   b = h (f - r_M M v - (h + r_K) K v)
        v+ = v + dv,   x+ = x + h v+

    K is the derivative of the forces with the negative eigenvalues of each element set to zero; see
    Material.positive_tangent. A robot therefore comes to rest where it is in equilibrium. A law without
    potential has no symmetric derivative; there K is what the law defines, such as the stiffness with frozen
    element rotations.

    Actuators are solved in the same step: multipliers t within their bounds add h H^T t to b, so that at its
    end, to first order, s - q + c t = 0 or a bound is reached; see actuation.actuators.

    A stepper is planned for one model, whose pattern, order and places it stores; the model is therefore no
    argument of a step. Everything that changes is in the state, the control and the parameters; between two
    steps, a stepper stores only buffers.

    Source: Baraff and Witkin 1998.

    Attributes:
        name: Name of the implementation.
        compiled: Whether a step is compiled code.
        model, actuators: The model and its actuators.
    """

    name: str
    compiled: bool
    model: Model
    actuators: Actuators

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance `state` by one dt, in place; the caller decides by the report whether to accept it.

        Raises:
            ArrayError: the control is for another model.
            FactorisationError: the matrix of the step is singular; `state` is unchanged.
        """
        ...

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> FreeMotion:
        """Advance as `step`, and return the motion, to which forces on constraint rows can be added.

        Raises:
            As `step`.
        """
        ...

    def static_tangent(
        self, state: State, parameters: Parameters, forces: Array, pressed: Sequence[Array] = ()
    ) -> StaticTangent:
        """Return the exact static tangent at `state` under node forces (n, 3) in [N], weight and elasticity.

        Cells that take their stress from the last linear solve use what the last step found, because the
        volumetric pressure of a state that is not in equilibrium may be far off. `pressed` is the stiffness
        of the actuators' surfaces, see ActuatorGroup; it is left out if empty.

        The compiled implementation uses the tangent of the law `corotational` for `corotational_qr`, too, as
        an approximation. For an unstable state it uses the tangent with negative eigenvalues of elements set
        to zero.

        Raises:
            FactorisationError: the tangent is singular with frames and joints fixed.
        """
        ...

    def without_mass(self) -> MasslessStepper | None:
        """Return a stepper of the model without mass and with dt = 1 s: its steps from rest lead to statics.

        It shares buffers with this one, so only one of them may compute at a time. None: there is none.
        """
        ...

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """Return the von Mises stress of each element in [Pa], shape (m,); zero inside one rigid region."""
        ...


class MasslessStepper(Protocol):
    """Steps of a model without mass, each an iteration of statics, and the check of what they find."""

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance the state, in place; see Stepper. The forces of the control include weight."""
        ...

    def is_stable(self, state: State, parameters: Parameters, forces: Array) -> bool:
        """Return whether an equilibrium under node forces (n, 3) in [N], all but elastic ones, is stable.

        Where actuators add to the pattern of the step, their positive stiffness counts; elsewhere False may
        be an equilibrium that they stabilise.
        """
        ...


class FreeMotion(Protocol):
    """An unconstrained step, and the response to impulses on constraint rows.

    It is valid until its stepper computes something else: another step or a static tangent.

    Attributes:
        state: State at the end of the step; `correct` writes into it.
        before: State at its start.
        report: Report of the step.
        violations: First-order constraint violations s - q + c t of the actuators after the step, shape (c,).
    """

    state: State
    before: State
    report: StepReport
    violations: Array

    @property
    def defect(self) -> Array | None:
        """Row velocities in [m/s] that an approximate `compliance` left out, shape (r,); set by `correct`.

        The rows of actuators are not included. None: the compliance is exact.
        """
        ...

    def compliance(self, rows: Rows) -> Array:
        """Return H A^-1 H^T of the step's matrix in [1/kg], (c + r, c + r), with prescribed joints fixed.

        Args:
            rows: Constraint rows at the start of the step; H holds those of the c actuators, then these.

        Raises:
            ArrayError: rows of other types or shapes.
        """
        ...

    def correct(self, impulses: Array) -> StepReport:
        """Set `state` to the free motion plus the response to `impulses` [N s] on the last `compliance` rows.

        The impulses have shape (c + r,); those of actuators are added to what the step found. Each call
        starts from the free motion, independent of earlier corrections. Rigid bodies are left unchanged.

        Returns:
            Report of the corrected step, with the times of the free motion.
        """
        ...


class Condensed(NamedTuple):
    """Static tangent with the free nodes eliminated, and the response to forces on rows H.

    Attributes:
        stiffness: S = K_bb - K_bi K_ii^-1 K_ib, symmetric, shape (b, b) in [N/m], [N/rad], [N m/rad]; in the
            order of Model's degrees of freedom of frames and joints.
        arriving: Z = H_b^T - K_bi K_ii^-1 H_i^T, force on frames and joints per unit of each row's force,
            shape (b, r).
        compliance: W = H_i K_ii^-1 H_i^T with frames and joints fixed, in [m/N], shape (r, r).
    """

    stiffness: Array
    arriving: Array
    compliance: Array


class StaticTangent(Protocol):
    """Exact static tangent of a model at a state.

    It includes the stiffness of drives and soft fixings and the rotation of the loads on rigid regions, but
    not the actuators. It is valid until its stepper computes something else.

    Attributes:
        positive: Whether it is positive definite on the free nodes. If not, an implementation that needs it
            sets the negative eigenvalues of elements to zero.
    """

    positive: bool

    def condense(self, rows: Rows) -> Condensed:
        """Eliminate the free nodes, which follow frames and joints in equilibrium, and return the rest."""
        ...
