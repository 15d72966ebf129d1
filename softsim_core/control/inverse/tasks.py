"""Effector tasks: the error between goal and effector, and its derivative with respect to the joints.

A task provides the error e (k,) and the Jacobian J (k, j) with de = -J dq. The rotation error is the rotation
vector of R_goal R_current^T in world axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.mechanics import Pose, cross_matrix, rotation_log, rotation_of
from softsim_core.scene import InverseSettings

UP = np.array([0.0, 0.0, 1.0])
SMALL = 1e-4
"""Angle in [rad] below which series replace quotients."""


class Task(Protocol):
    """Interface of a goal for the effector: an error, its Jacobian and its weights."""

    @property
    def weights(self) -> Array:
        """Weight W of each coordinate in [-] or [m/rad], shape (k,)."""
        ...

    @property
    def angular(self) -> tuple[bool, ...]:
        """Which coordinates are angles in [rad]; the others are lengths in [m]."""
        ...

    def error(self, current: Pose) -> Array:
        """Return the error e in [m] and [rad]: the goal minus the pose of the effector, shape (k,)."""
        ...

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """Return J = -de/dq, shape (k, j).

        Args:
            effector: Derivatives of the effector's shift and spin by the joints, shape (6, j).
            current: Pose of the effector at which J is evaluated.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PositionTask:
    """Position goal with error e = p_goal - p: goal (3,) in [m], weights (3,) along world axes."""

    angular: ClassVar[tuple[bool, ...]] = (False, False, False)
    goal: Array
    weights: Array

    def error(self, current: Pose) -> Array:
        """Return the goal minus the position of the effector in [m], shape (3,)."""
        return np.asarray(self.goal - current.position)

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """Return the derivatives of the effector's position by the joints, shape (3, j)."""
        return effector[:3]


@dataclass(frozen=True, slots=True, eq=False)
class OrientationTask:
    """Orientation goal with error e = log(R_goal R^T): quaternion (x, y, z, w), weights (3,) in [m/rad].

    The weights act about world axes.
    """

    angular: ClassVar[tuple[bool, ...]] = (True, True, True)
    goal: Array
    weights: Array

    def error(self, current: Pose) -> Array:
        """Return the rotation vector in [rad] from current to goal orientation, world axes, shape (3,)."""
        return rotation_log(rotation_of(self.goal) @ rotation_of(current.quaternion_xyzw).T)

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """Return Jr^-1(e) times the spin derivatives, shape (3, j): the logarithm's exact Jacobian."""
        return inverse_right_jacobian(self.error(current)) @ effector[3:]


@dataclass(frozen=True, slots=True, eq=False)
class HeightTiltTask:
    """Goal of height and tilt: e = (height - z, tilt error about x, tilt error about y).

    The tilt error is the shortest rotation of the effector's z axis to the z axis of the goal. A rotation of
    the effector about its own z axis does not change the error.

    Attributes:
        height: Goal of z in [m].
        tilt_x, tilt_y: Rotation vector (tilt_x, tilt_y, 0) in [rad] that tilts the upright axis to the goal.
        weights: Weights of the height in [-] and of the tilts about x and y in [m/rad], shape (3,).
    """

    angular: ClassVar[tuple[bool, ...]] = (False, True, True)
    height: float
    tilt_x: float
    tilt_y: float
    weights: Array

    @property
    def normal(self) -> Array:
        """Goal direction of the effector's z axis, a unit vector of shape (3,)."""
        angle = float(np.hypot(self.tilt_x, self.tilt_y))
        ratio = np.sinc(angle / np.pi)
        return np.array([ratio * self.tilt_y, -ratio * self.tilt_x, np.cos(angle)])

    def error(self, current: Pose) -> Array:
        """Return the height error in [m] and the tilt errors about x and y in [rad], shape (3,)."""
        turn, _ = self._turn(current)
        return np.array([self.height - current.position[2], turn[0], turn[1]])

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """Return the negative derivatives of height and tilt errors by the joints, shape (3, j)."""
        _, by_spin = self._turn(current)
        return np.concatenate([effector[2:3], -by_spin[:2] @ effector[3:]])

    def _turn(self, current: Pose) -> tuple[Array, Array]:
        """Return the shortest rotation vector (3,) from n to the goal g, and its spin derivative (3, 3).

        With a = n x g and c = n . g the vector is f(c) a, f = angle / sine, and dn = spin x n. At an angle of
        pi every direction is equally short: a horizontal axis is chosen, and rotating back along it reduces
        the angle.
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
    """Pose goal with error e = (p_goal - p, log(R_goal R^T)): goal pose, weights (6,) in [-] and [m/rad]."""

    angular: ClassVar[tuple[bool, ...]] = (False, False, False, True, True, True)
    goal: Pose
    weights: Array

    def error(self, current: Pose) -> Array:
        """Return position errors in [m], then the rotation error in [rad], shape (6,)."""
        turn = OrientationTask(self.goal.quaternion_xyzw, self.weights[3:]).error(current)
        return np.concatenate([self.goal.position - current.position, turn])

    def jacobian(self, effector: Array, current: Pose) -> Array:
        """Return the negative derivatives of position and rotation errors by the joints, shape (6, j)."""
        turn = OrientationTask(self.goal.quaternion_xyzw, self.weights[3:]).jacobian(effector, current)
        return np.concatenate([effector[:3], turn])


def task_for(goal: Pose, settings: InverseSettings) -> Task:
    """Return the selected task towards a goal pose; the settings' `lever` converts angles to lengths."""
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
    """Return the shortest rotation (x, y) in [rad] of the upright axis to a frame's z axis."""
    normal = rotation_of(quaternion_xyzw)[:, 2]
    sine = float(np.hypot(normal[0], normal[1]))
    if sine == 0.0:  # upright, or upside down about any axis: about x
        return (0.0 if normal[2] > 0.0 else float(np.pi)), 0.0
    ratio = float(np.arctan2(sine, normal[2])) / sine
    return -ratio * float(normal[1]), ratio * float(normal[0])


def _horizontal_across(normal: Array) -> Array:
    """Return a horizontal unit vector perpendicular to a normal (3,), shape (3,)."""
    across = np.cross(UP, normal)
    length = float(np.linalg.norm(across))
    return np.asarray(across / length) if length > SMALL else np.array([1.0, 0.0, 0.0])


def scale_to_limits(error: Array, angular: Sequence[bool], max_shift: float, max_turn: float) -> Array:
    """Scale an error so that no coordinate exceeds max_shift in [m] or max_turn in [rad].

    The result is s e with the largest such s <= 1, so the direction is preserved. An effector that cannot
    reach a distant goal therefore comes to rest at the point nearest to it.
    """
    most = (max_turn if each else max_shift for each in angular)
    worst = max(abs(part) / limit for part, limit in zip(error.tolist(), most, strict=True))
    return error if worst <= 1.0 else error / worst


def inverse_right_jacobian(turn: Array) -> Array:
    """Return Jr^-1(t) = I + [t]x / 2 + (1/a^2 - (1 + cos a) / (2 a sin a)) [t]x^2, a = |t|, shape (3, 3).

    log(exp(t) exp(-w)) = t - Jr^-1(t) w to first order. Source: Chirikjian 2012.
    """
    angle, k = float(np.linalg.norm(turn)), cross_matrix(turn)
    if angle < SMALL:
        factor = 1.0 / 12.0
    else:
        sine = max(float(np.sin(angle)), SMALL)
        factor = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * sine)
    return np.asarray(np.eye(3) + 0.5 * k + factor * k @ k)
