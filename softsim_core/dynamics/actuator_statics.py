"""Actuators in an equilibrium: their rows on all unknowns, their geometric stiffness, and the solve.

With T the tangent, geometric stiffness included, t the multipliers and g = s - q + c t (see
actuation.actuator):

    T dx - H^T dt = r,    H dx + c dt = -g  where t stays within its bounds, else dt leads to the bound
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from softsim_core.actuation.actuator import GeometricStiffness
from softsim_core.actuation.actuators import Actuators
from softsim_core.arrays import Array
from softsim_core.dynamics.assembly import Unknowns, jacobian
from softsim_core.dynamics.stepper import Stepper
from softsim_core.errors import SceneError, listing
from softsim_core.linalg.bounded import solve_bounded
from softsim_core.linalg.linear_solver import Factors
from softsim_core.mechanics.control import Parameters
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.rows import Rows, joined, no_rows, sparse_rows
from softsim_core.mechanics.state import State


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

    Drives and the turning of the loads (weight and `forces` (n, 3) in [N]) are included; actuators keep their
    coordinates, at a bound or not, and their joints stand for their commands q. With S, Z and W of
    StaticTangent.condensed it is S + Z (W + D)^-1 Z^T: D is c for s - q and 1 / w for a row of geometric
    stiffness w.

    Raises:
        FactorisationError: the free nodes have no equilibrium that stays.
        SceneError: an actuator is commanded by its multiplier, so its joint has no stiffness.
    """
    model, actuators = stepper.model, stepper.actuators
    if not len(actuators):
        return stepper.static_tangent(state, parameters, forces).condensed(no_rows()).stiffness
    if len(actuators.multiplied):
        names = listing(model.joints[j].name for j in actuators.multiplied)
        raise SceneError(
            f"inverse control needs actuators that are commanded by how far they go, not {names}: change "
            "their `control` in the scene"
        )
    multipliers = state.joint_efforts[actuators.joint]
    rows = actuators.rows(model, state)
    spread, _ = sparse_rows(rows, len(model.rest), model.reduced_size)
    loads = forces + (spread.T @ multipliers).reshape(-1, 3)
    pressed = actuators.surface_stiffness(state, multipliers)
    tangent = stepper.static_tangent(state, parameters, loads, pressed)
    within = bool(pressed) and tangent.positive  # else, as past the maximum of a balloon, they come as rows
    if pressed and not within:
        tangent = stepper.static_tangent(state, parameters, loads)
    geometric = actuators.geometric_stiffness(model, state, multipliers, without_surfaces=within)
    every = joined([_less_command(model, actuators, rows), geometric.rows])
    stiffness, arriving, compliance = tangent.condensed(every)
    compliance[range(every.height), range(every.height)] += np.append(
        actuators.compliance, 1.0 / geometric.weight
    )
    return np.asarray(stiffness + arriving @ np.linalg.solve(compliance, arriving.T))


def _less_command(model: Model, actuators: Actuators, rows: Rows) -> Rows:
    """The rows of s - q: the command stands at the place of the actuator's joint."""
    ends, first = rows.start[1:], len(model.rest) + 6 * len(model.frame_names)
    coefficient = np.insert(rows.coefficient, ends, np.array([-1.0, 0.0, 0.0]), axis=0)
    place = np.insert(rows.place, ends, first + actuators.joint)
    return Rows(rows.start + np.arange(rows.height + 1), place, coefficient)
