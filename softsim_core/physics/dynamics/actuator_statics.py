"""Actuators in an equilibrium: their rows on all unknowns, their geometric stiffness, and the solve.

With T the tangent, geometric stiffness included, t the multipliers and g = s - q + c t (see
actuation.actuator):

    T dx - H^T dt = r,    H dx + c dt = -g  where t stays within its bounds, else dt leads to the bound
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array, BoolArray
from softsim_core.physics.actuation import Actuators, GeometricStiffness
from softsim_core.physics.dynamics.assembly import Unknowns, jacobian
from softsim_core.physics.dynamics.stepper import Condensed, Stepper
from softsim_core.physics.linalg import Factors, solve_bounded
from softsim_core.physics.mechanics import (
    Model,
    Parameters,
    Rows,
    State,
    Transmissions,
    joined,
    no_rows,
    sparse_rows,
)

SAME = 1e-6
"""Part of its own compliance by which an actuator yields: several of one route have a tangent, too."""


@dataclass(frozen=True, slots=True, eq=False)
class RowsOnUnknowns:
    """Rows on the nodes (r, 3 n), on frames and joints (r, b), and on all unknowns (r, d)."""

    on_nodes: sp.csr_matrix
    on_reduced: sp.csr_matrix
    on_unknowns: sp.csr_matrix


def rows_on_unknowns(model: Model, at: Unknowns, state: State, rows: Rows) -> RowsOnUnknowns:
    """Rows as matrices."""
    on_nodes, on_reduced = sparse_rows(rows, len(model.rest), model.reduced_size)
    tail = sp.csr_matrix(
        (on_reduced.data, on_reduced.indices + at.first_reduced, on_reduced.indptr), (rows.height, at.size)
    )
    return RowsOnUnknowns(on_nodes, on_reduced, on_nodes @ jacobian(model, at, state) + tail)


def on_nodes(model: Model, geometric: GeometricStiffness) -> sp.csr_matrix:
    """Geometric stiffness of the nodes alone in [N/m], shape (3 n, 3 n)."""
    across, _ = sparse_rows(geometric.rows, len(model.rest), model.reduced_size)
    return (across.T @ sp.diags(geometric.weight) @ across).tocsr()


class ActuatedFactors:
    """Factors of T, and the compliance at the actuators on top of them."""

    def __init__(
        self, factors: Factors, rows: sp.csr_matrix, compliance: Array, bounds: tuple[Array, Array]
    ) -> None:
        self.positive = factors.positive
        self._factors, self._rows, self._bounds = factors, rows.toarray(), bounds
        self._answer = factors.solve(self._rows.T)
        self._compliance = self._rows @ self._answer + np.diag(compliance)

    def solve(self, residual: Array, violations: Array, multipliers: Array) -> tuple[Array, Array]:
        """Step of the solved unknowns, and of the multipliers (c,)."""
        lower, upper = self._bounds
        free = self._factors.solve(residual)
        violations = violations + self._rows @ free - self._compliance @ multipliers
        change = solve_bounded(self._compliance, violations, lower, upper) - multipliers
        return free + self._answer @ change, change


def reduced_stiffness(stepper: Stepper, state: State, parameters: Parameters, forces: Array) -> Array:
    """Static stiffness of frames and joints, the free nodes following in equilibrium, shape (b, b).

    See `condensed`, of which it is the first part.

    Raises:
        FactorisationError: the free nodes have no equilibrium that stays.
    """
    return condensed(stepper, state, parameters, forces, no_rows()).stiffness


def condensed(stepper: Stepper, state: State, parameters: Parameters, forces: Array, rows: Rows) -> Condensed:
    """The static tangent with free nodes and actuators eliminated, and what forces on `rows` do beside it.

    Drives and the turning of the loads (weight and `forces` (n, 3) in [N]) are included; actuators keep their
    coordinates, at a bound or not, and their joints stand for what is commanded. With S, Z and W of
    StaticTangent.condensed, h the rows that hold (s - q, and those of geometric stiffness w) and D = diag(c,
    1 / w), each of the three loses what h takes:

        S + Z_h (W_hh + D)^-1 Z_h^T,    Z_r - Z_h (W_hh + D)^-1 W_hr,    W_rr - W_rh (W_hh + D)^-1 W_hr

    The row of an actuator in S tells of its multiplier times its gain, see command_gains. Of one that is
    commanded by its multiplier, the row tells of -s instead: it is one of r, and its joint stands for it.

    Raises:
        FactorisationError: the free nodes have no equilibrium that stays.
    """
    model, actuators = stepper.model, stepper.actuators
    if not len(actuators):
        return stepper.static_tangent(state, parameters, forces).condensed(rows)
    multipliers = state.joint_efforts[actuators.joint]
    pulling = actuators.rows(model, state)
    spread, _ = sparse_rows(pulling, len(model.rest), model.reduced_size)
    loads = forces + (spread.T @ multipliers).reshape(-1, 3)
    pressed = actuators.surface_stiffness(state, multipliers)
    tangent = stepper.static_tangent(state, parameters, loads, pressed)
    within = bool(pressed) and tangent.positive  # else, as past the maximum of a balloon, they come as rows
    if pressed and not within:
        tangent = stepper.static_tangent(state, parameters, loads)
    geometric = actuators.geometric_stiffness(model, state, multipliers, without_surfaces=within)
    kept = _kept_at(stepper, state)
    given = actuators.constraints.by_multiplier
    gain = np.where(given, 0.0, kept.gain)
    own = [_less_command(model, actuators, pulling, gain), geometric.rows]
    before = sum(each.height for each in own)
    stiffness, arriving, compliance = tangent.condensed(joined([*own, rows]))
    diagonal = range(before)
    compliance[diagonal, diagonal] += np.append(kept.compliance, 1.0 / geometric.weight)
    compliance[diagonal, diagonal] *= 1.0 + SAME  # rows that say the same share what they hold
    imposed = np.flatnonzero(given)
    held = np.setdiff1d(np.arange(before), imposed)
    left = np.append(imposed, np.arange(before, len(compliance)))
    answer = np.linalg.solve(
        compliance[np.ix_(held, held)], np.hstack([arriving[:, held].T, compliance[np.ix_(held, left)]])
    )
    size, many = len(stiffness), len(imposed)
    stiffness = stiffness + arriving[:, held] @ answer[:, :size]
    reaching = arriving[:, left] - arriving[:, held] @ answer[:, size:]
    moved = compliance[np.ix_(left, left)] - compliance[np.ix_(left, held)] @ answer[:, size:]
    if many:
        at = size - len(model.joints) + actuators.joint[imposed]
        stiffness[:, at] -= reaching[:, :many]
        stiffness[at] -= reaching[:, :many].T
        stiffness[np.ix_(at, at)] -= moved[:many, :many]
        reaching[at] += moved[:many]
    return Condensed(np.asarray(stiffness), reaching[:, many:], moved[many:, many:])


def command_gains(stepper: Stepper, state: State) -> Array:
    """How much of what it holds a unit of each joint's command is, shape (j,); 0 where that is its effort."""
    actuators, gains = stepper.actuators, np.ones(len(stepper.model.joints))
    gains[actuators.joint] = _kept_at(stepper, state).gain
    gains[actuators.multiplied] = 0.0
    return gains


def taut_commands(stepper: Stepper, state: State, commands: Array) -> tuple[Array, BoolArray]:
    """Commands (j,) with the slack of actuators taken up, and which joints' actuators can only pull (j,)."""
    actuators, kept = stepper.actuators, _kept_at(stepper, state)
    efforts = state.joint_efforts[actuators.joint]
    one_sided = (kept.lower >= 0.0) & ~actuators.constraints.by_multiplier
    slack = one_sided & (efforts <= 0.0)
    taut, pulls = commands.copy(), np.zeros(len(commands), dtype=np.bool_)
    taut[actuators.joint[slack]] = actuators.commands_of(actuators.values(stepper.model, state), efforts)[
        slack
    ]
    pulls[actuators.joint[one_sided]] = True
    return taut, pulls


def _kept_at(stepper: Stepper, state: State) -> Transmissions:
    """What the actuators keep where a state is, as if it were at rest."""
    actuators, multipliers = stepper.actuators, state.joint_efforts[stepper.actuators.joint]
    values = actuators.values(stepper.model, state)
    return actuators.transmissions(actuators.commands_of(values, multipliers), multipliers)


def _less_command(model: Model, actuators: Actuators, rows: Rows, gain: Array) -> Rows:
    """The rows of s - q: the command, times `gain` (c,), stands at the place of the actuator's joint."""
    ends, first = rows.start[1:], len(model.rest) + 6 * len(model.frame_names)
    coefficient = np.insert(rows.coefficient, ends, np.outer(-gain, [1.0, 0.0, 0.0]), axis=0)
    place = np.insert(rows.place, ends, first + actuators.joint)
    return Rows(rows.start + np.arange(rows.height + 1), place, coefficient)
