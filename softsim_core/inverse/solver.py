"""Solve the quadratic program of a step and check the answer: nothing is believed.

Stationarity P dq + q + G^T z - z_l + z_u = 0, feasibility and complementarity are computed here. daqp finds
the active set; the equations of that set are then solved anew, so that bounds hold exactly.

Source: Arnström, Bemporad, Axehill 2022 (daqp); Nocedal and Wright 2006, ch. 16.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.linalg.lapack import dposv

from softsim_core.arrays import Array
from softsim_core.errors import SceneError
from softsim_core.inverse.problem import QP

Status: TypeAlias = Literal["solved", "infeasible", "not_converged"]

KKT_TOLERANCE = 1e-8
"""A solution with a larger residual is not used."""

ACTIVE = 1e-12
"""A multiplier above this marks an active limit."""

ENDLESS = 1e30
"""daqp's infinity."""

_INFEASIBLE = -1

WAYS = ((1e-11, 0.0), (1e-9, 1e-6), (1e-7, 1e-4))
"""Primal tolerances and proximal weights of daqp, exact first: limits that nearly say the same want more."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What came out of a program.

    Attributes:
        dq: Joint increments in what joints are commanded in, shape (j,); zero unless solved.
        status: "solved"; "infeasible": no increment keeps all limits; "not_converged": the check failed.
        kkt_residual: Largest violation of the optimality conditions, in units of QP.scale; infinite unless
            there is a candidate.
        active: Names of the limits that hold the step back.
    """

    dq: Array
    status: Status
    kkt_residual: float
    active: tuple[str, ...]


def need_daqp() -> Any:
    """The module daqp.

    Raises:
        SceneError: it is not installed.
    """
    try:
        return importlib.import_module("daqp")
    except ModuleNotFoundError as error:
        raise SceneError("inverse control needs the package daqp: pip install daqp") from error


def solve(qp: QP) -> Solution:
    """The joint increments of a program, checked; a program without solution is a result, not an error.

    Raises:
        SceneError: the package daqp is not installed.
    """
    _, free, failed = dposv(qp.P, -qp.q)  # most steps touch no limit
    if not failed and (free >= qp.lower).all() and (free <= qp.upper).all() and (qp.G @ free <= qp.h).all():
        return _checked(qp, free, np.zeros(len(qp.q) + len(qp.h)))
    return _by_active_set(qp)


def _by_active_set(qp: QP) -> Solution:
    """Solve with daqp."""
    if not all(np.isfinite(part).all() for part in (qp.P, qp.q, qp.G)):
        return _nothing(qp, "not_converged")
    upper = np.concatenate([qp.upper, qp.h])
    lower = np.concatenate([qp.lower, np.full(len(qp.h), -np.inf)])
    if (lower > upper).any():
        return _nothing(qp, "infeasible")
    solution = _nothing(qp, "not_converged")
    for tolerance, proximal in WAYS:
        x, _, flag, info = need_daqp().solve(
            qp.P, qp.q, qp.G, np.minimum(upper, ENDLESS), np.maximum(lower, -ENDLESS),
            np.zeros(len(upper), np.int32), primal_tol=tolerance, eps_prox=proximal,
        )  # fmt: skip
        if flag == _INFEASIBLE:
            if not solution.kkt_residual < math.inf:
                solution = _nothing(qp, "infeasible")
            continue
        multipliers = np.asarray(info["lam"], dtype=float)
        polished = _polish(qp, multipliers)
        for candidate in (polished, (np.asarray(x, dtype=float), multipliers)):
            if candidate is not None:
                solution = _checked(qp, *candidate)
                if solution.status == "solved":
                    return solution
    return solution


def _checked(qp: QP, dq: Array, multipliers: Array) -> Solution:
    """The candidate as a solution, if it meets its optimality conditions."""
    residual = kkt_residual(qp, dq, multipliers)
    if not residual <= KKT_TOLERANCE:  # also catches NaN
        return _nothing(qp, "not_converged", residual)
    dq = qp.scale * np.minimum(np.maximum(dq, qp.lower), qp.upper)
    return Solution(dq, "solved", residual, _active(qp, multipliers))


def _nothing(qp: QP, status: Status, residual: float = math.inf) -> Solution:
    return Solution(np.zeros(len(qp.q)), status, residual, ())


def kkt_residual(qp: QP, dq: Array, multipliers: Array) -> float:
    """Largest violation of stationarity, feasibility, sign and complementarity of a candidate.

    Args:
        qp: The program.
        dq: Increments in units of QP.scale, shape (j,).
        multipliers: Of the bounds, then of the rows, shape (j + r,): positive at an upper limit, negative
            at a lower bound.
    """
    size = len(dq)
    stationarity = qp.P @ dq + qp.q + multipliers[:size]
    above, below = dq - qp.upper, qp.lower - dq
    if len(qp.h):
        stationarity += multipliers[size:] @ qp.G
        above = np.concatenate([above, qp.G @ dq - qp.h])
        below = np.concatenate([below, np.full(len(qp.h), -np.inf)])
    parts = [np.abs(stationarity), above, below]
    if multipliers.any():
        push = np.flatnonzero(multipliers)  # a limit that is nowhere near cannot push
        parts.append(np.abs(multipliers[push] * np.where(multipliers > 0.0, above, below)[push]))
    return float(np.concatenate(parts).max(initial=0.0))  # unlike max(), keeps NaN


def _polish(qp: QP, multipliers: Array) -> tuple[Array, Array] | None:
    """Increments and multipliers from the equations of the active set alone."""
    size = len(qp.q)
    active = np.flatnonzero(np.abs(multipliers) > ACTIVE)
    rows = np.concatenate([np.eye(size), qp.G])[active]
    upper = np.concatenate([qp.upper, qp.h])[active]
    lower = np.concatenate([qp.lower, np.full(len(qp.h), -np.inf)])[active]
    values = np.where(multipliers[active] > 0.0, upper, lower)
    count = len(active)
    matrix = np.zeros((size + count, size + count))
    matrix[:size, :size] = qp.P
    matrix[size:, :size], matrix[:size, size:] = rows, rows.T
    try:
        answer = np.linalg.solve(matrix, np.concatenate([-qp.q, values]))
    except np.linalg.LinAlgError:  # limits that say the same
        return None
    refined = np.zeros_like(multipliers)
    refined[active] = answer[size:]
    dq = answer[:size]
    bounds = active[active < size]
    dq[bounds] = values[: len(bounds)]  # exactly, without rounding
    return dq, refined


def _active(qp: QP, multipliers: Array) -> tuple[str, ...]:
    """Names of the limits with a multiplier."""
    if not multipliers.any():
        return ()
    size = len(qp.q)
    found: dict[str, None] = {}
    for i in np.flatnonzero(np.abs(multipliers) > ACTIVE).tolist():
        if i >= size:
            found[qp.names[i]] = None
        elif multipliers[i] > 0.0:
            found[f"{qp.names[i]} {'upper' if qp.at_upper[i] else 'speed'}"] = None
        else:
            found[f"{qp.names[i]} {'lower' if qp.at_lower[i] else 'speed'}"] = None
    return tuple(found)
