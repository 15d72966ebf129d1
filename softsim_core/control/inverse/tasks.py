"""Effector tasks: the error between goal and effector, and how it shrinks with the joints.

A task gives e (k,) and J (k, j) with de = -J dq. The rotation error is the rotation vector of
R_goal R_current^T in world axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.mechanics import Pose, cross_matrix, rotation_log, rotation_of
from softsim_core.scene import InverseSettings

UP = np.array([0.0, 0.0, 1.0])
SMALL = 1e-4
"""Angle in [rad] below which series replace quotients."""


class Task(Protocol):
    """What the effector should do."""

    @property
    def weights(self) -> Array:
        """Weight W of each coordinate in [-] or [m/rad], shape (k,)."""
        ...

    @property
    def angular(self) -> tuple[bool, ...]:
        """Which coordinates are angles in [rad]; the others are lengths in [m]."""
        ...

    def error(self, current: Pose) -> Array:
        """e: goal minus effector in [m] and [rad], shape (k,)."""
        ...

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """J = -de/dq, shape (k, j), from the effector's derivatives (6, j) (shift, spin)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PositionTask:
    """e = p_goal - p: goal (3,) in [m], weights (3,) along world axes."""

    goal: Array
    weights: Array

    @property
    def angular(self) -> tuple[bool, ...]:
        """No angles."""
        return (False, False, False)

    def error(self, current: Pose) -> Array:
        """See Task."""
        return np.asarray(self.goal - current.position)

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """See Task."""
        return effector[:3]


@dataclass(frozen=True, slots=True, eq=False)
class OrientationTask:
    """e = log(R_goal R^T): goal quaternion (x, y, z, w), weights (3,) about world axes in [m/rad]."""

    goal: Array
    weights: Array

    @property
    def angular(self) -> tuple[bool, ...]:
        """All angles."""
        return (True, True, True)

    def error(self, current: Pose) -> Array:
        """See Task."""
        return rotation_log(rotation_of(self.goal) @ rotation_of(current.quaternion_xyzw).T)

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """See Task; the exact derivative of the logarithm, Jr^-1(e) times the spin."""
        return inverse_right_jacobian(self.error(current)) @ effector[3:]


@dataclass(frozen=True, slots=True, eq=False)
class HeightTiltTask:
    """e = (height - z, the shortest rotation of the effector's z axis to the goal's, about x and about y).

    A turn of the effector about its own z axis has no part in it.

    Attributes:
        height: Goal of z in [m].
        tilt_x, tilt_y: Rotation vector (tilt_x, tilt_y, 0) in [rad] that tilts the upright axis to the goal.
        weights: Of height in [-], tilt about x and about y in [m/rad], shape (3,).
    """

    height: float
    tilt_x: float
    tilt_y: float
    weights: Array

    @property
    def angular(self) -> tuple[bool, ...]:
        """Two angles behind a length."""
        return (False, True, True)

    @property
    def normal(self) -> Array:
        """Where the effector's z axis should point, (3,)."""
        angle = float(np.hypot(self.tilt_x, self.tilt_y))
        ratio = np.sinc(angle / np.pi)
        return np.array([ratio * self.tilt_y, -ratio * self.tilt_x, np.cos(angle)])

    def error(self, current: Pose) -> Array:
        """See Task."""
        turn, _ = self._turn(current)
        return np.array([self.height - current.position[2], turn[0], turn[1]])

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """See Task."""
        _, by_spin = self._turn(current)
        return np.concatenate([effector[2:3], -by_spin[:2] @ effector[3:]])

    def _turn(self, current: Pose) -> tuple[Array, Array]:
        """The shortest rotation vector (3,) from n to the goal g, and its derivative by the spin (3, 3).

        With a = n x g and c = n . g it is f(c) a, f = angle / sine, and dn = spin x n. Upside down every
        direction is the shortest: one about a horizontal axis is taken, and turning back shortens it.
        """
        normal, goal = rotation_of(current.quaternion_xyzw)[:, 2], self.normal
        axis = np.cross(normal, goal)
        sine, cosine = float(np.linalg.norm(axis)), float(normal @ goal)
        angle = float(np.arctan2(sine, cosine))
        if angle > np.pi - SMALL:
            return angle * _horizontal_across(goal), -np.eye(3)
        if angle < SMALL:
            quotient, slope = 1.0 + angle**2 / 6.0, -1.0 / 3.0
        else:
            quotient, slope = angle / sine, (angle * cosine - sine) / sine**3
        moved = -cross_matrix(normal)  # dn by the spin
        by_spin = -quotient * cross_matrix(goal) @ moved + slope * np.outer(axis, goal @ moved)
        return quotient * axis, by_spin


@dataclass(frozen=True, slots=True, eq=False)
class PoseTask:
    """e = (p_goal - p, log(R_goal R^T)): goal pose, weights (6,) in [-] and [m/rad]."""

    goal: Pose
    weights: Array

    @property
    def angular(self) -> tuple[bool, ...]:
        """Three lengths, three angles."""
        return (False, False, False, True, True, True)

    def error(self, current: Pose) -> Array:
        """See Task."""
        turn = OrientationTask(self.goal.quaternion_xyzw, self.weights[3:]).error(current)
        return np.concatenate([self.goal.position - current.position, turn])

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """See Task."""
        turn = OrientationTask(self.goal.quaternion_xyzw, self.weights[3:]).jacobian(effector, current)
        return np.concatenate([effector[:3], turn])


def task_for(goal: Pose, settings: InverseSettings) -> Task:
    """The task that the settings name, towards a goal pose; angles weigh as displacements at `lever`."""
    along = np.array(settings.position_weights)
    about = settings.lever * np.array(settings.orientation_weights)
    if settings.task == "position":
        return PositionTask(goal.position, along)
    if settings.task == "orientation":
        return OrientationTask(goal.quaternion_xyzw, about)
    if settings.task == "height_tilt":
        tilt_x, tilt_y = tilt_of(goal.quaternion_xyzw)
        weights = np.array([along[2], about[0], about[1]])
        return HeightTiltTask(float(goal.position[2]), tilt_x, tilt_y, weights)
    return PoseTask(goal, np.concatenate([along, about]))


def tilt_of(quaternion_xyzw: Array) -> tuple[float, float]:
    """Rotation vector (x, y) in [rad] of the shortest rotation of the upright axis to a frame's z axis."""
    normal = rotation_of(quaternion_xyzw)[:, 2]
    sine = float(np.hypot(normal[0], normal[1]))
    if sine == 0.0:  # upright, or upside down about any axis: about x
        return (0.0 if normal[2] > 0.0 else float(np.pi)), 0.0
    ratio = float(np.arctan2(sine, normal[2])) / sine
    return -ratio * float(normal[1]), ratio * float(normal[0])


def _horizontal_across(normal: Array) -> Array:
    """A horizontal unit vector across a normal (3,), shape (3,)."""
    across = np.cross(UP, normal)
    length = float(np.linalg.norm(across))
    return np.asarray(across / length) if length > SMALL else np.array([1.0, 0.0, 0.0])


def limited(error: Array, angular: Sequence[bool], max_shift: float, max_turn: float) -> Array:
    """Scaled error s e, s <= 1 such that no coordinate is above max_shift in [m] or max_turn in [rad].

    The direction stays, so an effector that cannot reach a far goal rests where it is nearest to it.
    """
    most = (max_turn if each else max_shift for each in angular)
    worst = max(abs(part) / limit for part, limit in zip(error.tolist(), most, strict=True))
    return error if worst <= 1.0 else error / worst


def inverse_right_jacobian(turn: Array) -> Array:
    """Jr^-1(t) = I + [t]x / 2 + (1/a^2 - (1 + cos a) / (2 a sin a)) [t]x^2, a = |t|, shape (3, 3).

    log(exp(t) exp(-w)) = t - Jr^-1(t) w to first order. Source: Chirikjian 2012.
    """
    angle, k = float(np.linalg.norm(turn)), cross_matrix(turn)
    if angle < SMALL:
        factor = 1.0 / 12.0
    else:
        sine = max(float(np.sin(angle)), SMALL)
        factor = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * sine)
    return np.asarray(np.eye(3) + 0.5 * k + factor * k @ k)
