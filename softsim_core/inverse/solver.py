"""Solve the quadratic program of a step and check the answer: nothing is believed.

Stationarity P dq + q + G^T z - z_l + z_u = 0, feasibility and complementarity are computed here. daqp finds
the active set; the equations of that set are then solved anew, so that bounds hold exactly.

Source: Arnström, Bemporad, Axehill 2022 (daqp); Nocedal and Wright 2006, ch. 16.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import SceneError
from softsim_core.inverse.problem import QP

Status: TypeAlias = Literal["solved", "infeasible", "not_converged"]

KKT_TOLERANCE = 1e-8
"""A solution with a larger residual is not used."""

ACTIVE = 1e-12
"""A multiplier above this marks an active limit."""

_INFEASIBLE = -1


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What came out of a program.

    Attributes:
        dq: Joint increments in [rad] or [m], shape (j,); zero unless solved.
        status: "solved"; "infeasible": no increment keeps all limits; "not_converged": the check failed.
        kkt_residual: Largest violation of the optimality conditions, in joint increments; infinite unless
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
    size, rows = len(qp.q), len(qp.h)
    nothing = np.zeros(size)
    daqp = need_daqp()
    if not all(np.isfinite(part).all() for part in (qp.P, qp.q, qp.G)):
        return Solution(nothing, "not_converged", float("inf"), ())
    upper = np.concatenate([qp.upper, qp.h])
    lower = np.concatenate([qp.lower, np.full(rows, -np.inf)])
    if (lower > upper).any():
        return Solution(nothing, "infeasible", float("inf"), ())
    x, _, flag, info = daqp.solve(
        qp.P, qp.q, qp.G, _endless(upper), _endless(lower), np.zeros(size + rows, np.int32),
        primal_tol=1e-11, eps_prox=0.0,
    )  # fmt: skip
    if flag == _INFEASIBLE:
        return Solution(nothing, "infeasible", float("inf"), ())
    multipliers = np.asarray(info["lam"], dtype=float)
    x, multipliers = np.asarray(x, dtype=float), multipliers
    polished = _polish(qp, multipliers)
    if polished is not None and kkt_residual(qp, *polished) <= kkt_residual(qp, x, multipliers):
        x, multipliers = polished
    residual = kkt_residual(qp, x, multipliers)
    if not residual <= KKT_TOLERANCE:  # also catches NaN
        return Solution(nothing, "not_converged", residual, ())
    dq = np.minimum(np.maximum(x, qp.lower), qp.upper)
    return Solution(dq, "solved", residual, _active(qp, multipliers))


def kkt_residual(qp: QP, dq: Array, multipliers: Array) -> float:
    """Largest violation of stationarity, feasibility, sign and complementarity of a candidate.

    Args:
        qp: The program.
        dq: Increments, shape (j,).
        multipliers: Of the bounds, then of the rows, shape (j + r,): positive at an upper limit, negative
            at a lower bound.
    """
    size = len(dq)
    stationarity = qp.P @ dq + qp.q + multipliers[:size] + qp.G.T @ multipliers[size:]
    value = np.concatenate([dq, qp.G @ dq])
    above = value - np.concatenate([qp.upper, qp.h])
    below = np.concatenate([qp.lower - dq, np.full(len(qp.h), -np.inf)])
    push, pull = np.maximum(multipliers, 0.0), np.maximum(-multipliers, 0.0)
    slack = np.concatenate([_product(push, above), _product(pull, below)])
    parts = (np.abs(stationarity), np.maximum(above, 0.0), np.maximum(below, 0.0), np.abs(slack))
    return float(max(part.max(initial=0.0) for part in parts))


def _product(multiplier: Array, distance: Array) -> Array:
    """Complementarity products; a limit that is nowhere near cannot push."""
    product = np.zeros_like(multiplier)
    np.multiply(multiplier, distance, out=product, where=multiplier > 0.0)
    return product


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
    size = len(qp.q)
    found: dict[str, None] = {}
    for i in np.flatnonzero(np.abs(multipliers) > ACTIVE).tolist():
        if i >= size:
            found[qp.names[i - size]] = None
        else:
            found[qp.upper_names[i] if multipliers[i] > 0.0 else qp.lower_names[i]] = None
    return tuple(found)


def _endless(limits: Array) -> Array:
    """Limits with 1e30, daqp's infinity."""
    return np.nan_to_num(limits, posinf=1e30, neginf=-1e30)
