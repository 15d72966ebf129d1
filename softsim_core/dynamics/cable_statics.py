"""Cables in an equilibrium: their rows on all unknowns, the stiffness of their directions, and the solve.

With T the tangent without cables' travels, t the tensions and g = s - q the travel beyond the commanded one:

    T dq - H^T dt = r,    H dq = -g  where the tension is within its bounds, else dt leads to the bound
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from softsim_core.actuation.cable import Cables
from softsim_core.arrays import Array
from softsim_core.dynamics.assembly import Unknowns, jacobian
from softsim_core.dynamics.bounded import solve_bounded
from softsim_core.dynamics.rows import Rows, joined, sparse_rows
from softsim_core.dynamics.stepper import Parameters, Stepper, no_rows
from softsim_core.errors import SceneError
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State


@dataclass(frozen=True, slots=True, eq=False)
class CableRows:
    """H on the nodes (c, 3 n), on the border unknowns (c, b), and on all unknowns (c, d)."""

    on_nodes: sp.csr_matrix
    on_border: sp.csr_matrix
    on_unknowns: sp.csr_matrix


def cable_rows(model: Model, at: Unknowns, cables: Cables, state: State) -> tuple[CableRows, Array]:
    """Rows of all cables, and g in [m], shape (c,)."""
    points = cables.points(model, state)
    pulls, lengths = cables.pulls(points)
    rows = cables.rows(model, state, points, pulls)
    on_nodes, on_border = sparse_rows(rows, len(model.rest), model.border_size)
    tail = sp.csr_matrix(
        (on_border.data, on_border.indices + at.first_border, on_border.indptr), (len(cables), at.size)
    )
    return CableRows(on_nodes, on_border, on_nodes @ jacobian(model, at, state) + tail), cables.gaps(
        state, lengths
    )


def turning_rows(model: Model, cables: Cables, state: State, tensions: Array) -> tuple[Rows, Array]:
    """How segments turn: two rows across each segment, and the length over tension of each in [m/N].

    A segment of length l under tension t resists turning with the stiffness t / l across itself. Pull points
    are taken as fixed: they move only with prescribed joints.
    """
    points = cables.points(model, state)
    unit, length = cables.directions(points)
    start, index, coefficient, softness = [0], [], [], []
    for c in range(len(cables)):
        if tensions[c] <= 0.0:
            continue
        for p in range(cables.first[c], cables.first[c + 1] - 1):
            for across in _across(unit[p]):
                for point, sign in ((p + 1, 1.0), (p, -1.0)):
                    index.append(cables.nodes[point])
                    coefficient.append(sign * cables.weights[point][:, None] * across)
                start.append(start[-1] + 8)
                softness.append(length[p] / tensions[c])
    none = (np.zeros(0, np.int64), np.zeros((0, 3)))
    rows = Rows(np.array(start), np.concatenate([none[0], *index]), np.concatenate([none[1], *coefficient]))
    return rows, np.array(softness)


def cable_stiffness(model: Model, cables: Cables, state: State, tensions: Array) -> sp.csr_matrix:
    """What tensions add to the stiffness of the nodes in [N/m], shape (3 n, 3 n)."""
    rows, softness = turning_rows(model, cables, state, tensions)
    across, _ = sparse_rows(rows, len(model.rest), model.border_size)
    return (across.T @ sp.diags(1.0 / softness) @ across).tocsr()


class CableFactors:
    """Factors of T, and the cables' compliance on top of them."""

    def __init__(self, factors: Any, rows: sp.csr_matrix, bounds: tuple[Array, Array]) -> None:
        self.U, self.perm_r, self.perm_c = factors.U, factors.perm_r, factors.perm_c
        self._factors, self._rows, self._bounds = factors, rows.toarray(), bounds
        self._answer = np.column_stack([factors.solve(row) for row in self._rows])
        self._compliance = self._rows @ self._answer

    def solve(self, residual: Array, gaps: Array, tensions: Array) -> tuple[Array, Array]:
        """Step of the solved unknowns, and of the tensions (c,) in [N]."""
        lower, upper = self._bounds
        free = self._factors.solve(residual)
        gaps = gaps + self._rows @ free - self._compliance @ tensions
        change = solve_bounded(self._compliance, gaps, lower, upper) - tensions
        return free + self._answer @ change, change


def border_stiffness(stepper: Stepper, state: State, parameters: Parameters, forces: Array) -> Array:
    """Stepper.border_stiffness; its cables keep their travels, taut or not, shape (b, b).

    With Z what rows do to the border and W their compliance with the border held, S + Z (W + c)^-1 Z^T: c is
    0 for a travel and length over tension for the turning of a segment.

    Raises:
        SceneError: a cable is commanded by force, so its joint has no stiffness.
    """
    model, cables = stepper.model, stepper.cables
    if not len(cables):
        return stepper.border_response(state, parameters, forces, no_rows())[0]
    if cables.forced:
        raise SceneError(
            "inverse control needs cables commanded by displacement: set control: displacement in the scene"
        )
    points = cables.points(model, state)
    held = cables.rows(model, state, points, cables.pulls(points)[0])
    tensions = np.maximum(state.joint_efforts[cables.joint], 0.0)
    turning, softness = turning_rows(model, cables, state, tensions)
    rows = joined([held, turning])
    on_nodes, _ = sparse_rows(held, len(model.rest), model.border_size)
    loads = forces + (on_nodes.T @ state.joint_efforts[cables.joint]).reshape(-1, 3)
    stiffness, arriving, compliance = stepper.border_response(state, parameters, loads, rows)
    compliance[range(len(cables), rows.height), range(len(cables), rows.height)] += softness
    return np.asarray(stiffness + arriving @ np.linalg.solve(compliance, arriving.T))


def _across(unit: Array) -> tuple[Array, Array]:
    """Two unit vectors across a unit vector, each (3,)."""
    aside = np.zeros(3)
    aside[int(np.argmin(np.abs(unit)))] = 1.0
    first = np.cross(unit, aside)
    first /= np.linalg.norm(first)
    return first, np.cross(unit, first)
