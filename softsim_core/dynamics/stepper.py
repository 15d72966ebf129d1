"""The interface of a time step, shared by its two implementations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from softsim_core.actuation.cable import Cables
from softsim_core.arrays import Array
from softsim_core.dynamics.rows import Rows
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State


@dataclass(slots=True, eq=False)
class Parameters:
    """What a user may tune while the simulation runs.

    Attributes:
        lame: Lame parameters (lambda, mu) of each body in [Pa], shape (bodies, 2).
        rayleigh_stiffness: Damping per stiffness in [s].
        rayleigh_mass: Damping per mass in [1/s].
    """

    lame: Array
    rayleigh_stiffness: float
    rayleigh_mass: float


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """What acts during one step.

    Attributes:
        targets: Where each joint is commanded to be at the end of the step, in [rad] or [m], shape (j,).
        forces: External forces on the nodes in [N], shape (n, 3).
        base_shift: Shift in [m] of the joint bases at the end of the step. Bases are re-placed, not driven:
            their velocity stays zero, and the body feels the move from the next step on.
    """

    targets: Array
    forces: Array
    base_shift: float = 0.0


class Stepper(Protocol):
    """One implicit Euler step, linearised once, with all frames and joints solved together with the nodes.

    With h = dt, r_K and r_M the Rayleigh coefficients, K the (warped) stiffness:

        A dv = b,   A = (1 + h r_M) M + h (h + r_K) K,   b = h (f - r_M M v - (h + r_K) K v)
        v+ = v + dv,   x+ = x + h v+

    Cables hold in the same step: tensions t within their bounds add h H^T t to b, so that the travel at its
    end, to first order, is the commanded one or a bound is reached.

    Source: Baraff and Witkin 1998.

    Attributes:
        name: Of the implementation.
        model, cables: What moves.
        stage_times: Times of the last step's stages in [ms].
    """

    name: str
    model: Model
    cables: Cables
    stage_times: dict[str, float]

    @property
    def cable_gaps(self) -> Array:
        """Travel beyond the commanded one in [m] that the last step left to first order, shape (c,)."""
        ...

    def step(self, state: State, inputs: Inputs, parameters: Parameters) -> float:
        """Advance `state` by one dt, in place.

        Returns:
            The largest component of all new velocities, NaN if one is: the caller decides whether to keep the
            state.
        """
        ...

    def compliance(self, rows: Rows, before: State) -> Array:
        """H A^-1 H^T of the matrix of the last step, prescribed joints held, in [1/kg], shape (c + r, c + r).

        Args:
            rows: Constraint rows at the start of the step; H holds those of the c cables, then these.
            before: The state at the start of the step.
        """
        ...

    def correct(self, state: State, before: State, impulses: Array) -> float:
        """Add to the last step what `impulses` [N s] on the rows of the last `compliance` do, in place.

        Shape (c + r,); those of cables come on top of the tensions that the step found.

        Returns:
            As `step`.
        """
        ...

    def von_mises(self, state: State, parameters: Parameters) -> Array:
        """Von Mises stress of each element in [Pa], shape (m,); elements of one rigid zone have none."""
        ...

    def border_stiffness(self, state: State, parameters: Parameters, forces: Array) -> Array:
        """Static stiffness of frames and joints, the free nodes following in equilibrium.

        S = K_bb - K_bi K_ii^-1 K_ib of the exact static tangent at `state`, with the stiffness of the drives
        and the turning of the loads (mass weight and `forces` (n, 3) in [N]) included; symmetric.

        Returns:
            Shape (b, b): [N/m], [N/rad], [N m/rad]; order as Model numbers the border unknowns.
        """
        ...

    def border_response(
        self, state: State, parameters: Parameters, forces: Array, rows: Rows
    ) -> tuple[Array, Array, Array]:
        """`border_stiffness` without cables, and what forces on rows H do beside it.

        Returns:
            S (b, b) as `border_stiffness`; Z (b, r), the force that reaches the border a unit of each row's,
            H_b^T - K_bi K_ii^-1 H_i^T; and W (r, r) in [m/N], H_i K_ii^-1 H_i^T with the border held.
        """
        ...


def no_rows() -> Rows:
    """No constraint rows."""
    return Rows(np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)))


def joint_stiffness(model: Model) -> Array:
    """Stiffness in [N m/rad] or [N/m] of each joint's drive, 0 where the joint is prescribed, shape (j,)."""
    return np.array([joint.stiffness or 0.0 for joint in model.joints], dtype=float)
