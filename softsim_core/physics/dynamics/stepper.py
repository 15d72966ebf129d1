"""The interface of a time step, and of the objects that answer questions about it."""

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

    K is the derivative of the forces, the negative eigenvalues of each element taken as zero: a robot comes
    to rest where it is in equilibrium; see Material.positive_tangent. The forces of a law without potential
    have no symmetric one; there K is what the law says, such as the stiffness with frozen element rotations.

    Actuators hold in the same step: multipliers t within their bounds add h H^T t to b, so that at its end,
    to first order, s - q + c t = 0 or a bound is reached; see actuation.actuator.

    A stepper is planned for one model, whose pattern, order and places it keeps: so the model is no argument
    of a step. Everything that changes is in the state, the control and the parameters; what a stepper holds
    between two steps is room to work in.

    Source: Baraff and Witkin 1998.

    Attributes:
        name: Of the implementation.
        compiled: Whether a step is compiled code.
        model, actuators: What moves, and what moves it.
    """

    name: str
    compiled: bool
    model: Model
    actuators: Actuators

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        """Advance `state` by one dt, in place; the caller decides by the report whether to keep it.

        Raises:
            ArrayError: a control for another model.
            FactorisationError: the matrix of the step is singular; `state` is unchanged.
        """
        ...

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> FreeMotion:
        """`step`, with what is needed to add forces on constraint rows to it.

        Raises:
            As `step`.
        """
        ...

    def static_tangent(
        self, state: State, parameters: Parameters, forces: Array, pressed: Sequence[Array] = ()
    ) -> StaticTangent:
        """The exact static tangent at `state` under node forces (n, 3) in [N] beside weight and elasticity.

        Cells that keep their stress take what the last step found: in a state on its way the pressure of its
        volume may be far off. `pressed` is the stiffness of the actuators' surfaces, see ActuatorGroup;
        without it, it is left out.

        The compiled implementation takes that of the law `polar` for `qr`, too, as an approximation; and
        for a state on its way that is not stable, the tangent with negative eigenvalues of elements taken
        as zero.

        Raises:
            FactorisationError: it is singular with frames and joints held.
        """
        ...

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """Von Mises stress of each element in [Pa], shape (m,); elements of one rigid region have none."""
        ...


class StepperAround:
    """What a step around another one takes from it: all but the step itself.

    Args:
        inner: The other one.
    """

    def __init__(self, inner: Stepper) -> None:
        self._inner = inner
        self.name, self.compiled = inner.name, inner.compiled
        self.model, self.actuators = inner.model, inner.actuators

    def free_motion(self, state: State, control: Control, parameters: Parameters) -> FreeMotion:
        """See Stepper; that of the inner one."""
        return self._inner.free_motion(state, control, parameters)

    def static_tangent(
        self, state: State, parameters: Parameters, forces: Array, pressed: Sequence[Array] = ()
    ) -> StaticTangent:
        """See Stepper; that of the inner one."""
        return self._inner.static_tangent(state, parameters, forces, pressed)

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """See Stepper; that of the inner one."""
        return self._inner.von_mises(state, parameters)


class FreeMotion(Protocol):
    """A step as if nothing touched, and what impulses on constraint rows add to it.

    It stands until its stepper computes something else: another step or a static tangent.

    Attributes:
        state: The state at the end of the step; `correct` writes into it.
        before: The state at its start.
        report: Of the step.
        violations: Constraint violations s - q + c t of the actuators that the step left to first order,
            shape (c,).
    """

    state: State
    before: State
    report: StepReport
    violations: Array

    @property
    def defect(self) -> Array | None:
        """After `correct`, where `compliance` is approximate: what it left out of the rows' speed.

        In [m/s], of all rows but those of actuators, shape (r,); None: it is exact.
        """
        ...

    def compliance(self, rows: Rows) -> Array:
        """H A^-1 H^T of the step's matrix, prescribed joints held, in [1/kg], shape (c + r, c + r).

        Args:
            rows: Constraint rows at the start of the step; H holds those of the c actuators, then these.

        Raises:
            ArrayError: rows of other types or shapes.
        """
        ...

    def correct(self, impulses: Array) -> StepReport:
        """Make `state` the free motion plus what `impulses` [N s] on the rows of the last `compliance` do.

        Shape (c + r,); those of actuators come on top of what the step found. It starts from the
        free motion each time, whatever an earlier correction did. Rigid bodies are left as they are.

        Returns:
            What the corrected step tells; its times are those of the free motion.
        """
        ...


class Condensed(NamedTuple):
    """The static tangent with the free nodes eliminated, and what forces on rows H do beside it.

    Attributes:
        stiffness: S = K_bb - K_bi K_ii^-1 K_ib, symmetric, shape (b, b) in [N/m], [N/rad], [N m/rad]; order
            as Model numbers the degrees of freedom of frames and joints.
        arriving: Z = H_b^T - K_bi K_ii^-1 H_i^T, what reaches frames and joints a unit of each row's force,
            shape (b, r).
        compliance: W = H_i K_ii^-1 H_i^T with frames and joints held, in [m/N], shape (r, r).
    """

    stiffness: Array
    arriving: Array
    compliance: Array


class StaticTangent(Protocol):
    """The exact static tangent of a model at a state.

    The stiffness of drives and soft fixings and the turning of the loads on rigid regions are in it,
    actuators are not. It stands until its stepper computes something else.

    Attributes:
        positive: Whether it is positive definite on the free nodes. Where it is not, an implementation that
            needs it takes the negative eigenvalues of elements as zero.
    """

    positive: bool

    def condensed(self, rows: Rows) -> Condensed:
        """Eliminate the free nodes: they follow frames and joints in equilibrium."""
        ...
