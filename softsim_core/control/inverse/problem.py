"""One step of differential inverse kinematics: build and solve a quadratic program in the joint increments.

minimise    1/2 |W (s e - J dq)|^2 + 1/2 a |s tau + T dq|^2 + 1/2 b |s (q - q_p) + dq|^2 + 1/2 c |dq|^2
    subject to  lower <= dq <= upper,    G dq <= h

e is the tasks' error, s the share of it to remove, J its derivative, tau the joint efforts, T their
derivative, q_p the posture. a and b are below the least curvature of the tasks. The bounds enforce joint
interval and speed. The rows enforce torque limits and further constraints (contacts). c (Levenberg-Marquardt)
slows a step and moves no equilibrium. Increments are scaled by units of their joints, see Limits.scale,
because volumes in m^3 and pressures in Pa differ by ten orders of magnitude.

daqp finds the active set. The equations of that set are then solved again, so that bounds hold exactly. This
module checks stationarity P dq + q + G^T z - z_l + z_u = 0, feasibility and complementarity itself.

Source: Arnström, Bemporad, Axehill 2022 (daqp); Nocedal and Wright 2006, ch. 16.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from scipy.linalg.lapack import dposv

from softsim_core.base import Array, BoolArray, SceneError
from softsim_core.control.inverse.sensitivity import Sensitivity
from softsim_core.control.inverse.tasks import Task, scale_to_limits
from softsim_core.physics.mechanics import Pose
from softsim_core.scene import InverseSettings, SceneDescription

FLOOR = 1e-10
"""Least damping, as a part of the mean diagonal entry of J^T W^2 J.

It makes the program strictly convex even if joints have the same effect and their efforts differ by orders of
magnitude.
"""


NOTHING = 1e-8
"""Curvature below this part of the largest one counts as zero: joints have the same effect."""

_ONE = np.ones(1)


class StepTarget(NamedTuple):
    """Part of the error that one step shall remove.

    Attributes:
        share: Share of the error to remove, > 0.
        full: Share with which the settings' largest error is scaled.
        ahead: Displacement of the effector to add to the error in [m] and [rad], shape (6,); None: none.
    """

    share: float = 1.0
    full: float = 1.0
    ahead: Array | None = None


WHOLE = StepTarget()
"""Remove the whole error at once."""


class Linearisation(NamedTuple):
    """Linearised robot of one program.

    Attributes:
        sensitivity: Derivatives at the current state.
        pose: Pose of the effector.
        joints: Commanded joints q in [rad] or [m], shape (j,). The bounds lead a joint outside its interval
            back at its speed.
        efforts: Joint efforts tau in [N m] or [N], shape (j,).
    """

    sensitivity: Sensitivity
    pose: Pose
    joints: Array
    efforts: Array


class Constraint(NamedTuple):
    """Named rows G dq <= h; G (r, j), h (r,)."""

    G: Array
    h: Array
    names: tuple[str, ...]

    @property
    def inactive(self) -> bool:
        """Whether there are no rows."""
        return not len(self.h)


class QP(NamedTuple):
    """Quadratic program: minimise 1/2 y^T P y + q^T y with lower <= y <= upper, G y <= h, dq = scale y.

    P (j, j) and q (j,) are scaled so that the mean diagonal entry of P is 1: residuals are increments. A
    bound comes from the joint's interval where `at_lower` or `at_upper` is set, else from its speed. `names`
    contains the names of the joints, then of the rows.
    """

    P: Array
    q: Array
    G: Array
    h: Array
    lower: Array
    upper: Array
    at_lower: BoolArray
    at_upper: BoolArray
    names: tuple[str, ...]
    scale: Array = _ONE


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Limits of the joints within one step.

    Attributes:
        names: Joint names.
        lower, upper: Interval in [rad] or [m], shape (j,).
        step: Largest increment of one step in [rad] or [m], shape (j,).
        torque: Largest effort in [N m] or [N], shape (j,); infinite where not limited.
        scale: Joint displacement equivalent to 1 rad of a hinge, shape (j,).
        tension: Least tension of tendons in [N].
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    step: Array
    torque: Array
    scale: Array = field(default_factory=lambda: _ONE)
    tension: float = 0.0

    @classmethod
    def of(cls, scene: SceneDescription, settings: InverseSettings, period: float) -> Limits:
        """Return the joints' own limits, narrowed by the settings, for a step of `period` [s]."""
        limits = [joint.limits for joint in scene.joints]
        lower = np.array([max(each.lower, _or(settings.lower, -np.inf)) for each in limits])
        upper = np.array([min(each.upper, _or(settings.upper, np.inf)) for each in limits])
        speed = np.array([min(each.speed, _or(settings.speed, np.inf)) for each in limits])
        torque = np.full(len(limits), _or(settings.torque_limit, np.inf))
        interval = lower, np.maximum(lower, upper)
        return cls(scene.joint_names, *interval, speed * period, torque, scales(scene), settings.min_tension)

    def clamp(self, joints: Array) -> Array:
        """Clamp joint positions to the interval, shape (j,)."""
        return np.clip(joints, self.lower, self.upper)


def scales(scene: SceneDescription) -> Array:
    """Return the command of each joint that is equivalent to 1 rad of a hinge, shape (j,).

    It is 1 m for a slide or a cable, which therefore takes equally careful steps. For other units it is the
    range of a slider.
    """
    units = [joint.units.command for joint in scene.joints]
    return np.array([1.0 if unit.si in ("rad", "m") else unit.reach for unit in units], dtype=float)


def build(
    tasks: Sequence[Task],
    robot: Linearisation,
    limits: Limits,
    settings: InverseSettings,
    *,
    aim: StepTarget = WHOLE,
    posture: Array | None = None,
    damping: float = 0.0,
    constraints: Sequence[Constraint] = (),
) -> QP:
    """Build the program of one step; see the module.

    Args:
        tasks: Goals of the effector; none: only the posture draws the joints.
        robot: The linearised robot.
        limits: Limits of the joints.
        settings: Weights, and limits of the target.
        aim: Part of the error to remove.
        posture: q_posture in [rad] or [m], shape (j,); required with a posture weight.
        damping: c in [m^2/rad^2] or [-], >= 0.
        constraints: Further rows.
    """
    sensitivity, current, joints, efforts = robot
    size, unit = len(joints), limits.scale
    P, q = np.zeros((size, size)), np.zeros(size)
    for task in tasks:
        J = task.weights[:, None] * task.jacobian(sensitivity.effector, current) * unit
        P += J.T @ J
        q -= (task.weights * compute_step_error(task, current, settings, aim)) @ J
    scale, least = (max(float(P.trace()) / size, 1e-300), _least_curvature(P)) if tasks else (1.0, 1.0)
    T = sensitivity.effort * unit
    if settings.effort_weight > 0.0:
        square = T.T @ T
        weight = settings.effort_weight * least * size / max(float(square.trace()), 1e-300)
        P += weight * square
        q += aim.share * weight * (efforts @ T)
    if settings.posture_weight > 0.0 and posture is not None:
        weight = settings.posture_weight * least
        P.flat[:: size + 1] += weight
        q += aim.share * weight * (joints - posture) / unit
    P.flat[:: size + 1] += scale * FLOOR + damping
    scale = max(float(P.trace()) / size, 1e-300)

    back, forth, slow = limits.lower - joints, limits.upper - joints, -limits.step
    torques = torque_rows(sensitivity.effort, efforts, limits, aim.share)
    rows = [torques, *constraints]
    return QP(
        P / scale,
        q / scale,
        (np.concatenate([each.G for each in rows]) if len(rows) > 1 else rows[0].G) * unit,
        np.concatenate([each.h for each in rows]) if len(rows) > 1 else rows[0].h,
        np.minimum(np.maximum(back, slow), limits.step) / unit,
        np.minimum(np.maximum(forth, slow), limits.step) / unit,
        back > slow,
        forth < limits.step,
        sum((each.names for each in rows), limits.names),
        unit,
    )


def _least_curvature(P: Array) -> float:
    """Return the least eigenvalue of a positive semidefinite matrix that is above rounding, > 0."""
    values = np.linalg.eigvalsh(P)
    return max(float(values[values >= NOTHING * values[-1]][0]), 1e-300)


def compute_step_error(
    task: Task, current: Pose, settings: InverseSettings, aim: StepTarget = WHOLE
) -> Array:
    """Return the part of a task's error that one step shall remove, in [m] and [rad], shape (k,)."""
    most = aim.full / aim.share
    near = aim.share * scale_to_limits(
        task.error(current), task.angular, most * settings.max_shift, most * settings.max_turn
    )
    return near if aim.ahead is None else near + task.jacobian(aim.ahead[:, None], current)[:, 0]


def torque_rows(T: Array, efforts: Array, limits: Limits, gain: float = 1.0) -> Constraint:
    """Return rows for |tau + T dq| <= torque.

    A step approaches the limit by at most `gain` of the distance. An exceeded limit is left as fast as a step
    allows.
    """
    limited_joints = np.flatnonzero(limits.torque < np.inf)
    if not len(limited_joints):
        return Constraint(np.zeros((0, len(efforts))), np.zeros(0), ())
    excess = np.sign(efforts) * np.maximum(np.abs(efforts) - limits.torque, 0.0)
    share = gain
    if excess.any():  # dq = -share T^-1 excess must fit into the step
        back = np.abs(np.linalg.lstsq(T, excess, rcond=None)[0])
        share *= min(1.0, 0.5 * float(np.min(limits.step / np.maximum(back, 1e-300))))
    margin = np.concatenate([limits.torque - efforts, limits.torque + efforts])
    chosen = np.concatenate([limited_joints, len(efforts) + limited_joints])
    names = [f"{limits.names[j]} torque" for j in limited_joints]
    return Constraint(
        np.concatenate([T, -T])[chosen],
        np.where(margin > 0.0, gain * margin, share * margin)[chosen],
        tuple(names + names),
    )


def _or(value: float | None, default: float) -> float:
    return default if value is None else value


Status: TypeAlias = Literal["solved", "infeasible", "not_converged"]

KKT_TOLERANCE = 1e-8
"""A solution with a larger residual is rejected."""

ACTIVE = 1e-12
"""A multiplier above this marks an active limit."""

ENDLESS = 1e30
"""Number that daqp treats as infinity."""

_INFEASIBLE = -1

WAYS = ((1e-11, 0.0), (1e-9, 1e-6), (1e-7, 1e-4))
"""Primal tolerances and proximal weights of daqp, exact first: nearly parallel limits need larger ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of a program.

    Attributes:
        dq: Joint increments in the units of the joint commands, shape (j,); zero unless solved.
        status: "solved"; "infeasible": no increment satisfies all limits; "not_converged": the check failed.
        kkt_residual: Largest violation of the optimality conditions, in units of QP.scale; infinite without a
            candidate.
        active: Names of the limits that constrain the step.
    """

    dq: Array
    status: Status
    kkt_residual: float
    active: tuple[str, ...]


def need_daqp() -> Any:
    """Return the module daqp.

    Raises:
        SceneError: it is not installed.
    """
    try:
        return importlib.import_module("daqp")
    except ModuleNotFoundError as error:
        raise SceneError("inverse control needs the package daqp: pip install daqp") from error


def solve(qp: QP) -> Solution:
    """Solve a program for the joint increments and check the result.

    A program without solution is a result, not an error.

    Raises:
        SceneError: the package daqp is not installed.
    """
    _, free, failed = dposv(qp.P, -qp.q)  # most steps are not constrained
    if not failed and (free >= qp.lower).all() and (free <= qp.upper).all() and (qp.G @ free <= qp.h).all():
        return _check_candidate(qp, free, np.zeros(len(qp.q) + len(qp.h)))
    return _by_active_set(qp)


def _by_active_set(qp: QP) -> Solution:
    """Solve with the active-set solver daqp."""
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
                solution = _check_candidate(qp, *candidate)
                if solution.status == "solved":
                    return solution
    return solution


def _check_candidate(qp: QP, dq: Array, multipliers: Array) -> Solution:
    """Return the candidate as a solution if it meets its optimality conditions."""
    residual = kkt_residual(qp, dq, multipliers)
    if not residual <= KKT_TOLERANCE:  # also catches NaN
        return _nothing(qp, "not_converged", residual)
    dq = qp.scale * np.minimum(np.maximum(dq, qp.lower), qp.upper)
    return Solution(dq, "solved", residual, _active(qp, multipliers))


def _nothing(qp: QP, status: Status, residual: float = math.inf) -> Solution:
    return Solution(np.zeros(len(qp.q)), status, residual, ())


def kkt_residual(qp: QP, dq: Array, multipliers: Array) -> float:
    """Return the largest violation of stationarity, feasibility, sign and complementarity of a candidate.

    Args:
        qp: The program.
        dq: Increments in units of QP.scale, shape (j,).
        multipliers: Multipliers of the bounds, then of the rows, shape (j + r,): positive at an upper limit,
            negative at a lower bound.
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
        push = np.flatnonzero(multipliers)  # inactive limits have no multiplier
        parts.append(np.abs(multipliers[push] * np.where(multipliers > 0.0, above, below)[push]))
    return float(np.concatenate(parts).max(initial=0.0))  # unlike max(), propagates NaN


def _polish(qp: QP, multipliers: Array) -> tuple[Array, Array] | None:
    """Return increments and multipliers from the equations of the active set alone."""
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
    except np.linalg.LinAlgError:  # dependent limits
        return None
    refined = np.zeros_like(multipliers)
    refined[active] = answer[size:]
    dq = answer[:size]
    bounds = active[active < size]
    dq[bounds] = values[: len(bounds)]  # exact, without rounding
    return dq, refined


def _active(qp: QP, multipliers: Array) -> tuple[str, ...]:
    """Return the names of the limits with a multiplier."""
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
