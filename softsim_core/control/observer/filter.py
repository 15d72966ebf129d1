"""Kalman filter over the unknowns of a model, and detection of contact onset.

predict:  P <- P + Q
    update:   K = P H^T (H P H^T + R)^-1,   z <- z + K v,   P <- (I - K H) P (I - K H)^T + K R K^T

Source: Kalman 1960; the covariance in Joseph's form (Bucy and Joseph 1968), which stays positive under
rounding.

After a jump c of the unknowns, the innovations of the last n steps are v_k = G_k c + e_k with e_k of
covariance S_k, so

    J = sum G^T S^-1 G,    b = sum G^T S^-1 v,    c = (J + L)^-1 b,    T = b^T (J + L)^-1 b

with L the inverse of the jumps' covariance. Without a jump, T is at most chi-square distributed. The longest
of several windows with T beyond the threshold is chosen. The response of the filter to the jump is neglected,
because slow unknowns hardly change within such a short time.

Source: Willsky and Jones 1976, generalised likelihood ratio for jumps in linear systems.

The unknowns are, in this order: an offset of each joint, the share by which loads are heavier than assumed (a
softer body), a steady push on the effector, and a touch there, each with force and moment in world axes. Push
and touch have the same effect; a push changes as the robot travels, a touch begins suddenly. A robot without
end effector has neither. The last unknowns are the misplacements of the sensors, which do not move the model.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainccinv

from softsim_core.base import Array
from softsim_core.control.inverse import scales
from softsim_core.control.observer.sensors import Sensor, effector_frame, field_rows
from softsim_core.control.observer.settings import ObserverSettings
from softsim_core.physics.mechanics import Rows, cross_matrix, join_rows
from softsim_core.simulation import Simulation


@dataclass(frozen=True, slots=True, eq=False)
class StateEstimate:
    """Estimate of the unknowns: mean z (p,) and covariance P (p, p). It is never changed in place."""

    mean: Array
    covariance: Array

    @property
    def deviation(self) -> Array:
        """Standard deviations of the unknowns, shape (p,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def spread(self, variance: Array) -> StateEstimate:
        """Return the estimate after independent changes with the given variances (p,)."""
        return StateEstimate(self.mean, self.covariance + np.diag(variance))

    def with_measurement(self, innovation: Array, rows: Array, noise: Array) -> StateEstimate:
        """Return the estimate after a measurement.

        `innovation` v (m,) is measurement minus expectation, `rows` H (m, p) its derivatives by the unknowns,
        and `noise` R (m, m) the covariance of the measurement.
        """
        across = self.covariance @ rows.T
        gain = np.linalg.solve(rows @ across + noise, across.T).T
        left = np.eye(len(self.mean)) - gain @ rows
        covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        return StateEstimate(self.mean + gain @ innovation, 0.5 * (covariance + covariance.T))

    def with_fixed_unknowns(self, which: slice) -> StateEstimate:
        """Return the estimate with some unknowns fixed at 0 with zero covariance."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[which] = 0.0
        covariance[which] = 0.0
        covariance[:, which] = 0.0
        return StateEstimate(mean, covariance)

    def with_unknowns(self, which: slice, mean: Array, covariance: Array) -> StateEstimate:
        """Return the estimate with new mean and covariance of some unknowns, independent of the others."""
        opened = self.with_fixed_unknowns(which)
        opened.mean[which], opened.covariance[which, which] = mean, covariance
        return opened


def squared_distance(innovation: Array, covariance: Array) -> float:
    """Return v^T S^-1 v, which is chi-square distributed if v (m,) is normal with covariance S (m, m)."""
    return float(innovation @ np.linalg.solve(covariance, innovation))


WINDOWS = (1, 2, 3, 5, 8, 12, 18)
"""Lengths of the windows in steps; all of them are tested at every step."""


@dataclass(frozen=True, slots=True, eq=False)
class Jump:
    """A detected jump.

    Attributes:
        steps: Number of steps since it began, including this one.
        mean, covariance: Estimate from the innovations since then, shapes (c,) and (c, c).
        statistic: T.
    """

    steps: int
    mean: Array
    covariance: Array
    statistic: float


class JumpDetector:
    """Detector of a jump of c unknowns.

    Args:
        prior: Standard deviation of jumps, shape (c,).
        false_alarms: Expected number per step without any jump, as if all windows were independent.
    """

    def __init__(self, prior: Array, false_alarms: float) -> None:
        self._limit = np.diag(1.0 / prior**2)
        self.threshold = chi_square_limit(max(len(prior), 1), false_alarms / len(WINDOWS))
        self._steps: deque[tuple[Array, Array]] = deque(maxlen=WINDOWS[-1])

    def forget(self) -> None:
        """Clear the windows."""
        self._steps.clear()

    def look(self, innovation: Array, rows: Array, covariance: Array) -> Jump | None:
        """Add a step's innovation v (m,), G (m, c) and S (m, m); return the likeliest jump, if any."""
        weighted = np.linalg.solve(covariance, np.column_stack([rows, innovation]))
        self._steps.append((rows.T @ weighted[:, :-1], rows.T @ weighted[:, -1]))
        best: Jump | None = None
        information, score, done = self._limit.copy(), np.zeros(len(self._limit)), 0
        for window in WINDOWS:
            if window > len(self._steps):
                break
            for back in range(done, window):
                each = self._steps[-1 - back]
                information += each[0]
                score += each[1]
            done = window
            mean = np.linalg.solve(information, score)
            statistic = float(score @ mean)
            if statistic > self.threshold and (best is None or statistic > best.statistic):
                best = Jump(window, mean, np.linalg.inv(information), statistic)
        return best


def chi_square_limit(freedom: int, chance: float) -> float:
    """Return the value that a chi-square variable with `freedom` degrees exceeds with a given probability."""
    return 2.0 * float(gammainccinv(0.5 * freedom, chance))


LENGTH = 0.1
"""Length in [m] of a slide or cable equivalent to 1 rad of a hinge; others: see inverse.problem.scales."""

WRENCH = 6
"""Count of numbers of a push: force, then moment."""


class Unknowns:
    """The unknowns of one simulation and its sensors.

    Attributes:
        size: Number of unknowns.
        acting: Number of leading unknowns that move the model.
        offsets, share, push, touch: Their slices.
        misplaced: Slice of each sensor's misplacement by its name.
    """

    def __init__(self, simulation: Simulation, sensors: Sequence[Sensor]) -> None:
        self._joints = simulation.joint_names
        joints = len(self._joints)
        wrench = WRENCH if simulation.scene.effector is not None else 0
        self.acting = joints + 1 + 2 * wrench
        ends = self.acting + np.cumsum([0] + [len(sensor.noise) for sensor in sensors])
        self.size = int(ends[-1])
        self.misplaced = {
            sensor.name: slice(int(first), int(last))
            for sensor, first, last in zip(sensors, ends[:-1], ends[1:], strict=True)
        }
        self._angular = np.array([each for sensor in sensors for each in sensor.angular], dtype=bool)
        self.offsets, self.share = slice(0, joints), slice(joints, joints + 1)
        self.push = slice(joints + 1, joints + 1 + wrench)
        self.touch = slice(joints + 1 + wrench, self.acting)
        lengths = np.array([joint.units.command.si == "m" for joint in simulation.scene.joints], dtype=bool)
        self._scale = np.where(lengths, LENGTH, scales(simulation.scene))
        model = simulation.model
        self._all = np.arange(len(model.rest))
        self._frame = effector_frame(simulation) if wrench else -1
        own = [region.nodes for region in model.regions if wrench and region.frame == self._frame]
        self._region = np.concatenate([np.zeros(0, np.int64), *own])

    def prior(self, settings: ObserverSettings) -> StateEstimate:
        """Return the estimate before the first measurement, without contact."""
        s = settings
        slow = self._slow(s.joint_offset, s.load_share, s.push, s.push_moment)
        deviation = self._all_unknowns(slow, s.sensor_offset, s.sensor_turn)
        return StateEstimate(np.zeros(self.size), np.diag(deviation**2))

    def change(self, settings: ObserverSettings, dt: float, travel: Array) -> Array:
        """Return the variances (p,) of changes in a step of `dt` [s] while joints travel by `travel` (j,)."""
        s = settings
        slow = self._slow(s.joint_offset, s.load_share, s.push, s.push_moment)
        moving = self._slow(s.offset_per_travel, s.share_per_travel, s.push_per_travel, s.moment_per_travel)
        still = self._all_unknowns(slow, s.sensor_offset, s.sensor_turn)
        moved = self._all_unknowns(moving, s.sensor_offset_per_travel, s.sensor_turn_per_travel)
        gone = np.abs(travel) / self._scale
        far = np.append(gone, np.full(self.size - len(gone), gone.sum()))
        return np.asarray(dt * (s.drift * still) ** 2 + far * moved**2)

    def joint_variance(self, settings: ObserverSettings) -> Array:
        """Return the variance of the joints' read-back, shape (j,)."""
        return np.asarray((settings.joint_noise * self._scale) ** 2)

    def _all_unknowns(self, slow: Array, length: float, angle: float) -> Array:
        """Combine the deviations of `_slow` with those of a sensor's lengths and angles."""
        none = np.zeros(self.acting - len(slow))
        return np.concatenate([slow, none, np.where(self._angular, angle, length)])

    def _slow(self, offset: float, share: float, force: float, moment: float) -> Array:
        """Return the standard deviations of offsets, share and push."""
        pushes = np.array([*[force] * 3, *[moment] * 3])[: self.push.stop - self.push.start]
        return np.concatenate([offset * self._scale, [share], pushes])

    def name(self, index: int) -> str:
        """Return the name of an unknown for messages."""
        if index < self.offsets.stop:
            return f"the zero of {self._joints[index]}"
        if index < self.push.start:
            return "the weight, or the softness,"
        if index >= self.acting:
            return "the place of " + next(n for n, where in self.misplaced.items() if index < where.stop)
        return "the force on the effector" if (index - self.push.start) % WRENCH < 3 else "the moment on it"

    def fields(self, simulation: Simulation) -> tuple[Array, Array]:
        """Return nodal forces in [N] per unit of the share (n, 3) and of the push (w, a, 3).

        A moment is distributed over the nodes of the effector as the smallest possible forces.
        """
        weight = simulation.model.weight
        if not len(self._region):
            return weight, np.zeros((0, 0, 3))
        pose, nodes = simulation.effector_pose, simulation.positions[self._region]
        assert pose is not None
        # force and moment of forces on the nodes, (6, 3 a)
        parts = [np.concatenate([np.eye(3), cross_matrix(arm)]) for arm in nodes - pose.position]
        total = np.concatenate(parts, axis=1)
        return weight, np.linalg.solve(total @ total.T, total).reshape(WRENCH, len(nodes), 3)

    def rows(self, fields: tuple[Array, Array]) -> Rows:
        """Return rows on which the loads of `fields` do work: the row of the share, then those of a push."""
        weight, spread = fields
        return join_rows([field_rows(self._all, weight[None]), field_rows(self._region, spread)])

    def forces(self, fields: tuple[Array, Array], mean: Array) -> Array:
        """Return the nodal forces in [N] of unknowns (p,), shape (n, 3)."""
        weight, spread = fields
        forces = mean[self.share] * weight
        if len(self._region):
            wrench = mean[self.push] + mean[self.touch]
            np.add.at(forces, self._region, np.einsum("w,wai->ai", wrench, spread))
        return np.asarray(forces)

    def columns(self, by_command: Array, by_load: Array) -> Array:
        """Return derivatives (r, acting) by acting unknowns from those by commands and loads.

        The derivatives by commands are (r, j), those by loads (r, 1 + w).
        """
        return np.hstack([by_command, by_load, by_load[:, 1:]])
