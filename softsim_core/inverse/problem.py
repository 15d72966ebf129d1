"""One step of differential inverse kinematics as a quadratic program in the joint increments dq.

    minimise    1/2 |W (s e - J dq)|^2 + 1/2 a |s tau + T dq|^2 + 1/2 b |s (q - q_p) + dq|^2 + 1/2 c |dq|^2
    subject to  lower <= dq <= upper,    G dq <= h

e is the tasks' error, s the share of it to take away, J its derivative, tau the joint efforts, T their
derivative, q_p the posture; a and b stay below the least curvature of the tasks. The bounds keep joint
interval and speed, the rows keep torque limits and whatever else is given (contacts). c (Levenberg-Marquardt)
slows a step and moves no equilibrium. Increments count in units of their joints, see Limits.scale: volumes in
m^3 and pressures in Pa stand ten orders of magnitude apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, BoolArray
from softsim_core.inverse.sensitivity import Sensitivity
from softsim_core.inverse.tasks import Task, limited
from softsim_core.mechanics.pose import Pose
from softsim_core.scene.control import InverseSettings
from softsim_core.scene.description import SceneDescription

FLOOR = 1e-10
"""Least damping, as a part of the mean diagonal entry of J^T W^2 J: the program stays strictly convex, also
where joints do the same and their efforts differ by orders of magnitude."""


NOTHING = 1e-8
"""Curvature below this part of the largest one counts as none: joints can do the same."""

_ONE = np.ones(1)


class Aim(NamedTuple):
    """What one step shall do about the error.

    Attributes:
        share: Of the error to take away, > 0.
        full: Share with which the largest error counts that the settings look at.
        ahead: Displacement of the effector to add to that in [m] and [rad], shape (6,); None: none.
    """

    share: float = 1.0
    full: float = 1.0
    ahead: Array | None = None


WHOLE = Aim()
"""All of the error at once."""


class Linearisation(NamedTuple):
    """The robot as one program sees it.

    Attributes:
        sensitivity: Derivatives at the current state.
        pose: Of the effector.
        joints: Commanded joints q in [rad] or [m], shape (j,). Where one is outside its interval, the bounds
            lead it back at its speed.
        efforts: Joint efforts tau in [N m] or [N], shape (j,).
    """

    sensitivity: Sensitivity
    pose: Pose
    joints: Array
    efforts: Array


class Constraint(NamedTuple):
    """Rows G dq <= h with a name each; G (r, j), h (r,)."""

    G: Array
    h: Array
    names: tuple[str, ...]

    @property
    def inactive(self) -> bool:
        """Whether there are no rows."""
        return not len(self.h)


class QP(NamedTuple):
    """minimise 1/2 y^T P y + q^T y subject to lower <= y <= upper and G y <= h, with dq = scale y.

    P (j, j), q (j,) are scaled so that the mean diagonal entry of P is 1: residuals are increments.
    A bound is the joint's interval where `at_lower` or `at_upper` says so, else its speed; `names` name the
    joints, then the rows.
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
        scale: What counts as much as 1 rad of a hinge, shape (j,).
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    step: Array
    torque: Array
    scale: Array = field(default_factory=lambda: _ONE)

    @classmethod
    def of(cls, scene: SceneDescription, settings: InverseSettings, period: float) -> Limits:
        """The joints' own limits, narrowed by the settings, for a step of `period` [s]."""
        own = [joint.limits for joint in scene.joints]
        lower = np.array([max(each.lower, _or(settings.lower, -np.inf)) for each in own])
        upper = np.array([min(each.upper, _or(settings.upper, np.inf)) for each in own])
        speed = np.array([min(each.speed, _or(settings.speed, np.inf)) for each in own])
        torque = np.full(len(own), _or(settings.torque_limit, np.inf))
        interval = lower, np.maximum(lower, upper)
        return cls(scene.joint_names, *interval, speed * period, torque, scales(scene))

    def clamp(self, joints: Array) -> Array:
        """Joint positions inside the interval, shape (j,)."""
        return np.clip(joints, self.lower, self.upper)


def scales(scene: SceneDescription) -> Array:
    """What of each joint's command counts as much as 1 rad of a hinge, shape (j,).

    1 m of a slide or a cable, which then wants as careful steps; of what has other units what a slider spans.
    """
    units = [joint.units.command for joint in scene.joints]
    return np.array([1.0 if unit.si in ("rad", "m") else unit.reach for unit in units], dtype=float)


def build(
    tasks: Sequence[Task],
    robot: Linearisation,
    limits: Limits,
    settings: InverseSettings,
    *,
    aim: Aim = WHOLE,
    posture: Array | None = None,
    damping: float = 0.0,
    constraints: Sequence[Constraint] = (),
) -> QP:
    """The program of one step; see the module.

    Args:
        tasks: What the effector should do.
        robot: Where it is, and how it answers.
        limits: Of the joints.
        settings: Weights and limits of the target.
        aim: How much of the error to take away.
        posture: q_posture in [rad] or [m], shape (j,); needed with a posture weight.
        damping: c in [m^2/rad^2] or [-], >= 0.
        constraints: Further rows.
    """
    sensitivity, current, joints, efforts = robot
    size, unit = len(joints), limits.scale
    P, q = np.zeros((size, size)), np.zeros(size)
    for task in tasks:
        J = task.weights[:, None] * task.jacobian(sensitivity.effector, current) * unit
        P += J.T @ J
        q -= (task.weights * wanted(task, current, settings, aim)) @ J
    scale, least = max(float(P.trace()) / size, 1e-300), _least_curvature(P)
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
    """The least eigenvalue of a positive semidefinite matrix that is not rounding, > 0."""
    values = np.linalg.eigvalsh(P)
    return max(float(values[values >= NOTHING * values[-1]][0]), 1e-300)


def wanted(task: Task, current: Pose, settings: InverseSettings, aim: Aim = WHOLE) -> Array:
    """What of a task's error one step shall take away in [m] and [rad], shape (k,)."""
    most = aim.full / aim.share
    near = aim.share * limited(
        task.error(current), task.angular, most * settings.max_shift, most * settings.max_turn
    )
    return near if aim.ahead is None else near + task.jacobian(aim.ahead[:, None], current)[:, 0]


def torque_rows(T: Array, efforts: Array, limits: Limits, gain: float = 1.0) -> Constraint:
    """|tau + T dq| <= torque; approached by `gain` of the distance a step, and left at what a step can do."""
    limited_joints = np.flatnonzero(limits.torque < np.inf)
    if not len(limited_joints):
        return Constraint(np.zeros((0, len(efforts))), np.zeros(0), ())
    excess = np.sign(efforts) * np.maximum(np.abs(efforts) - limits.torque, 0.0)
    share = gain
    if excess.any():  # dq = -share T^-1 excess must fit into the step
        back = np.abs(np.linalg.lstsq(T, excess, rcond=None)[0])
        share *= min(1.0, 0.5 * float(np.min(limits.step / np.maximum(back, 1e-300))))
    room = np.concatenate([limits.torque - efforts, limits.torque + efforts])
    kept = np.concatenate([limited_joints, len(efforts) + limited_joints])
    names = [f"{limits.names[j]} torque" for j in limited_joints]
    return Constraint(
        np.concatenate([T, -T])[kept],
        np.where(room > 0.0, gain * room, share * room)[kept],
        tuple(names + names),
    )


def _or(value: float | None, default: float) -> float:
    return default if value is None else value
