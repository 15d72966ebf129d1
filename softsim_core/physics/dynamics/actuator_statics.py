"""Actuators in an equilibrium: their rows on all unknowns, their geometric stiffness, and the solve.

With T the tangent, geometric stiffness included, t the multipliers and g = s - q + c t (see
actuation.actuators):

    T dx - H^T dt = r,    H dx + c dt = -g  where t stays within its bounds, else dt leads to the bound
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array, BoolArray
from softsim_core.physics.actuation import Actuators, GeometricStiffness
from softsim_core.physics.dynamics.assembly import Unknowns
from softsim_core.physics.dynamics.stepper import Condensed, Stepper
from softsim_core.physics.linalg import Factors, solve_bounded
from softsim_core.physics.mechanics import (
    Model,
    Parameters,
    Rows,
    State,
    Transmissions,
    distribute,
    join_rows,
    no_rows,
    sparse_rows,
)

SAME = 1e-6
"""Share of its own compliance added to each actuator's, so that the system is regular.

Several actuators on one route would make it singular.
"""


@dataclass(frozen=True, slots=True, eq=False)
class RowsOnUnknowns:
    """Constraint rows on the nodes (r, 3 n), on frames and joints (r, b), and on all unknowns (r, d)."""

    on_nodes: sp.csr_matrix
    on_reduced: sp.csr_matrix
    on_unknowns: sp.csr_matrix


def rows_on_unknowns(model: Model, at: Unknowns, mapping: sp.csr_matrix, rows: Rows) -> RowsOnUnknowns:
    """Return constraint rows as sparse matrices; `mapping` is the `jacobian`."""
    on_nodes, on_reduced = sparse_rows(rows, len(model.rest), model.reduced_size)
    tail = sp.csr_matrix(
        (on_reduced.data, on_reduced.indices + at.first_reduced, on_reduced.indptr), (rows.height, at.size)
    )
    return RowsOnUnknowns(on_nodes, on_reduced, on_nodes @ mapping + tail)


def on_nodes(model: Model, geometric: GeometricStiffness) -> sp.csr_matrix:
    """Return the geometric stiffness of the nodes alone in [N/m], shape (3 n, 3 n)."""
    across, _ = sparse_rows(geometric.rows, len(model.rest), model.reduced_size)
    return (across.T @ sp.diags(geometric.weight) @ across).tocsr()


class ActuatedFactors:
    """Factors of T, and the compliance of the actuators' rows computed with them."""

    def __init__(
        self, factors: Factors, rows: sp.csr_matrix, compliance: Array, bounds: tuple[Array, Array]
    ) -> None:
        self.positive = factors.positive
        self._factors, self._rows, self._bounds = factors, rows.toarray(), bounds
        self._answer = factors.solve(self._rows.T)
        self._compliance = self._rows @ self._answer + np.diag(compliance)

    def solve(self, residual: Array, violations: Array, multipliers: Array) -> tuple[Array, Array]:
        """Return the step of the solved unknowns, and that of the multipliers (c,)."""
        lower, upper = self._bounds
        free = self._factors.solve(residual)
        violations = violations + self._rows @ free - self._compliance @ multipliers
        change = solve_bounded(self._compliance, violations, lower, upper) - multipliers
        return free + self._answer @ change, change


def reduced_stiffness(stepper: Stepper, state: State, parameters: Parameters, forces: Array) -> Array:
    """Return the static stiffness of frames and joints, with the free nodes in equilibrium, shape (b, b).

    This is the first part of `condense_tangent`.

    Raises:
        FactorisationError: the free nodes have no stable equilibrium.
    """
    return condense_tangent(stepper, state, parameters, forces, no_rows()).stiffness


def condense_tangent(
    stepper: Stepper, state: State, parameters: Parameters, forces: Array, rows: Rows
) -> Condensed:
    """Return the static tangent with free nodes and actuators eliminated, and the response on `rows`.

    Drives and the turning of the loads (weight and `forces` (n, 3) in [N]) are included; actuators keep their
    coordinates, at a bound or not, and their joints stand for what is commanded. With S, Z and W of
    StaticTangent.condense, h the rows that hold (s - q, and those of geometric stiffness w) and D = diag(c,
    1 / w), each of the three loses what h takes:

        S + Z_h (W_hh + D)^-1 Z_h^T,    Z_r - Z_h (W_hh + D)^-1 W_hr,    W_rr - W_rh (W_hh + D)^-1 W_hr

    The row of an actuator in S is for its multiplier times its gain, see command_gains. If a command gives
    its multiplier, the row is for -s instead: it is one of r, and its joint represents it.

    Raises:
        FactorisationError: the free nodes have no equilibrium that stays.
    """
    model, actuators = stepper.model, stepper.actuators
    if not len(actuators):
        return stepper.static_tangent(state, parameters, forces).condense(rows)
    multipliers = state.joint_efforts[actuators.joint]
    pulling = actuators.rows(model, state)
    loads = forces + distribute(pulling, multipliers, len(model.rest), model.reduced_size)[0]
    pressed = actuators.surface_stiffness(state, multipliers)
    tangent = stepper.static_tangent(state, parameters, loads, pressed)
    within = bool(pressed) and tangent.positive  # else, as past a balloon's maximum, add them as rows
    if pressed and not within:
        tangent = stepper.static_tangent(state, parameters, loads)
    geometric = actuators.geometric_stiffness(model, state, multipliers, without_surfaces=within)
    transmissions = _transmissions_at(stepper, state)
    by_multiplier = actuators.constraints.by_multiplier
    gain = np.where(by_multiplier, 0.0, transmissions.gain)
    own = [_less_command(model, actuators, pulling, gain), geometric.rows]
    before = sum(each.height for each in own)
    stiffness, arriving, compliance = tangent.condense(join_rows([*own, rows]))
    diagonal = range(before)
    compliance[diagonal, diagonal] += np.append(transmissions.compliance, 1.0 / geometric.weight)
    compliance[diagonal, diagonal] *= 1.0 + SAME  # identical rows share their force
    imposed = np.flatnonzero(by_multiplier)
    solved = np.setdiff1d(np.arange(before), imposed)
    left = np.append(imposed, np.arange(before, len(compliance)))
    answer = np.linalg.solve(
        compliance[np.ix_(solved, solved)],
        np.hstack([arriving[:, solved].T, compliance[np.ix_(solved, left)]]),
    )
    size, many = len(stiffness), len(imposed)
    stiffness = stiffness + arriving[:, solved] @ answer[:, :size]
    reaching = arriving[:, left] - arriving[:, solved] @ answer[:, size:]
    moved = compliance[np.ix_(left, left)] - compliance[np.ix_(left, solved)] @ answer[:, size:]
    if many:
        at = size - len(model.joints) + actuators.joint[imposed]
        stiffness[:, at] -= reaching[:, :many]
        stiffness[at] -= reaching[:, :many].T
        stiffness[np.ix_(at, at)] -= moved[:many, :many]
        reaching[at] += moved[:many]
    return Condensed(np.asarray(stiffness), reaching[:, many:], moved[many:, many:])


def command_gains(stepper: Stepper, state: State) -> Array:
    """Return the change of the held quantity per unit of each joint's command, shape (j,).

    0 for effort commands.
    """
    actuators, gains = stepper.actuators, np.ones(len(stepper.model.joints))
    gains[actuators.joint] = _transmissions_at(stepper, state).gain
    gains[actuators.multiplied] = 0.0
    return gains


def taut_commands(stepper: Stepper, state: State, commands: Array) -> tuple[Array, BoolArray]:
    """Return commands (j,) without the slack of actuators, and which joints have one-sided actuators (j,)."""
    actuators, transmissions = stepper.actuators, _transmissions_at(stepper, state)
    efforts = state.joint_efforts[actuators.joint]
    one_sided = (transmissions.lower >= 0.0) & ~actuators.constraints.by_multiplier
    slack = one_sided & (efforts <= 0.0)
    taut, pulls = commands.copy(), np.zeros(len(commands), dtype=np.bool_)
    taut[actuators.joint[slack]] = actuators.commands_of(actuators.values(stepper.model, state), efforts)[
        slack
    ]
    pulls[actuators.joint[one_sided]] = True
    return taut, pulls


def _transmissions_at(stepper: Stepper, state: State) -> Transmissions:
    """Return the transmissions of the actuators at a state, as if it were at rest."""
    actuators, multipliers = stepper.actuators, state.joint_efforts[stepper.actuators.joint]
    values = actuators.values(stepper.model, state)
    return actuators.transmissions(actuators.commands_of(values, multipliers), multipliers)


def _less_command(model: Model, actuators: Actuators, rows: Rows, gain: Array) -> Rows:
    """Return the rows of s - q: the command, times `gain` (c,), is at the place of the actuator's joint."""
    ends, first = rows.start[1:], len(model.rest) + 6 * len(model.frame_names)
    coefficient = np.insert(rows.coefficient, ends, np.outer(-gain, [1.0, 0.0, 0.0]), axis=0)
    place = np.insert(rows.place, ends, first + actuators.joint)
    return Rows(rows.start + np.arange(rows.height + 1), place, coefficient)
