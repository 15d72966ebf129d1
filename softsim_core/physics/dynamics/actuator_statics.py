"""Actuators in an equilibrium: their rows on all unknowns, their geometric stiffness, and the solve.

With T the tangent, geometric stiffness included, t the multipliers and g = s - q + c t (see
actuation.actuators):

    T dx - H^T dt = r,    H dx + c dt = -g  where t stays within its bounds, else dt leads to the bound
"""

from __future__ import annotations

from collections.abc import Callable
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

MOST_ROUNDS, SETTLED = 30, 1e-13
"""Rounds in which multipliers and the laws that depend on them are solved, and their last relative change."""

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
    """Factors of T, and the compliance of the actuators' rows computed with them.

    Args:
        factors: The factors.
        rows: H of all c rows on the solved unknowns.
        laws: Returns the transmissions at this state if the multipliers were (c,).
        depends: Whether these depend on the multipliers, as friction does on tensions.
    """

    def __init__(
        self, factors: Factors, rows: sp.csr_matrix, laws: Callable[[Array], Transmissions], depends: bool
    ) -> None:
        self.positive = factors.positive
        self._factors, self._rows, self._laws = factors, rows.toarray(), laws
        self._rounds = MOST_ROUNDS if depends else 1
        self._answer = factors.solve(self._rows.T)
        self._response = self._rows @ self._answer

    def solve(self, residual: Array, violations: Array, multipliers: Array) -> tuple[Array, Array]:
        """Return the step of the solved unknowns, and that of the multipliers (c,)."""
        free = self._factors.solve(residual)
        start = violations + self._rows @ free - self._response @ multipliers
        first = law = self._laws(multipliers)
        start += first.command - first.compliance * multipliers
        before = multipliers
        for _ in range(self._rounds):
            found = solve_bounded(
                self._response + np.diag(law.compliance), start - law.command, law.lower, law.upper
            )
            if not np.abs(found - before).max() > SETTLED * np.abs(found).max():
                break
            before, law = found, self._laws(found)
        return free + self._answer @ (found - multipliers), found - multipliers


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
    coordinates, at a bound or not, and their joints stand for what is commanded. Passive rows keep their
    forces, as where a cable slides. With S, Z and W of
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
    multipliers = actuators.multipliers(state)
    pulling = actuators.rows(model, state)
    loads = forces + distribute(pulling, multipliers, len(model.rest), model.reduced_size)[0]
    pressed = actuators.surface_stiffness(state, multipliers)
    tangent = stepper.static_tangent(state, parameters, loads, pressed)
    within = bool(pressed) and tangent.positive  # else, as past a balloon's maximum, add them as rows
    if pressed and not within:
        tangent = stepper.static_tangent(state, parameters, loads)
    geometric = actuators.geometric_stiffness(model, state, multipliers, without_surfaces=within)
    transmissions, pulling = _transmissions_at(stepper, state), _first_rows(pulling, len(actuators.joint))
    by_multiplier = actuators.constraints.by_multiplier[: pulling.height]
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
    count, efforts = len(actuators.joint), actuators.multipliers(state)
    one_sided = (transmissions.lower >= 0.0) & ~actuators.constraints.by_multiplier[:count]
    slack = one_sided & (efforts[:count] <= 0.0)
    taut, pulls = commands.copy(), np.zeros(len(commands), dtype=np.bool_)
    taut[actuators.joint[slack]] = actuators.commands_of(actuators.values(stepper.model, state), efforts)[
        slack
    ]
    pulls[actuators.joint[one_sided]] = True
    return taut, pulls


def _transmissions_at(stepper: Stepper, state: State) -> Transmissions:
    """Return the transmissions of the actuators, without passive rows, at a state, as if it were at rest."""
    actuators, model = stepper.actuators, stepper.model
    commands = actuators.commands_of(actuators.values(model, state), actuators.multipliers(state))
    every = actuators.transmissions(model, state, commands)
    return Transmissions(*(each[: len(commands)] for each in every))


def _first_rows(rows: Rows, count: int) -> Rows:
    """Return the first `count` rows."""
    last = rows.start[count]
    return Rows(rows.start[: count + 1], rows.place[:last], rows.coefficient[:last])


def _less_command(model: Model, actuators: Actuators, rows: Rows, gain: Array) -> Rows:
    """Return the rows of s - q: the command, times `gain` (c,), is at the place of the actuator's joint."""
    ends, first = rows.start[1:], len(model.rest) + 6 * len(model.frame_names)
    coefficient = np.insert(rows.coefficient, ends, np.outer(-gain, [1.0, 0.0, 0.0]), axis=0)
    place = np.insert(rows.place, ends, first + actuators.joint)
    return Rows(rows.start + np.arange(rows.height + 1), place, coefficient)
