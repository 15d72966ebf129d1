"""Inverse control in real time: one joint increment per tick, on a model that moves with the robot.

A tick computes the effector's sensitivity at the model's present state, and the pose at which the effector
would come to rest. It solves one quadratic program for the increment dq towards the goal, at a rate that the
slowest mode allows (see pace), and steps the model by dt under q + dq. With a measured pose y, the error of
the model is learned as a correction d and subtracted from the goal:

    d <- clip(d + (1 - exp(-k dt)) (y - (x + d))),    the model's goal is goal - d

At rest y = x + d = goal for any plant. This is an integral law; the clipping limits its windup.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal, TypeAlias

import numpy as np

from softsim_core.base import (
    MILLIMETRE,
    Array,
    CommandError,
    FactorisationError,
    FormerAttribute,
    NotConvergedError,
    SolverDivergedError,
    degrees,
)
from softsim_core.control.inverse.pacing import AdaptiveDamping, Pace, pace, slowest_period
from softsim_core.control.inverse.problem import QP, Limits, Solution, Status, StepTarget, build, need_daqp
from softsim_core.control.inverse.sensitivity import Sensitivity, analytic_sensitivity
from softsim_core.control.inverse.static import (
    effector,
    far_limits,
    is_optimal,
    lengths,
    linearise_robot,
    place,
    residuals,
    sensitivity_of,
    solve_taut,
)
from softsim_core.control.inverse.tasks import Task, task_for
from softsim_core.physics.mechanics import (
    Pose,
    check_command,
    quaternion_of,
    rotation_exp,
    rotation_log,
    rotation_of,
)
from softsim_core.scene import InverseSettings, RobotDescription, SceneDescription, as_robot
from softsim_core.simulation import Simulation

__all__ = ["InverseController", "InverseReport", "InverseSettings", "InverseStatus"]

InverseStatus: TypeAlias = (
    Literal["idle", "moving", "limited", "reached", "unreachable", "stalled", "diverged"] | Status
)

PATIENCE = 10
"""Consecutive ticks at rest, at the full rate, after which a goal counts as unreachable."""

PATIENCE_STALLED = 100
"""Consecutive ticks without progress, at the full rate, after which the robot counts as stalled."""

OVERLOAD = 0.02
"""Part of a torque limit by which an effort may exceed it at the goal."""

AT_REST = 0.1
"""Remaining motion that counts as rest, as a part of the tolerance."""

RETURNED = 0.02
"""Largest step of a joint that counts as none on the way back to the posture, as a part of its limit."""

RESAMPLE = 0.02
"""Joint travel in units of Limits.scale after which a sampled sensitivity is computed again."""


@dataclass(frozen=True, slots=True, eq=False)
class InverseReport:
    """Result of one tick.

    Attributes:
        command: Joint command in [rad] or [m], shape (j,): inside limits, at most speed * dt from the last.
        model_pose: Pose of the model's effector after the tick.
        residual_m, residual_rad: Distance from the goal in [m] and [rad] over the task's coordinates: of the
            measured pose if one was given, else of the model. 0 without goal.
        mismatch_m, mismatch_rad: Distance of the measured pose from the model's in [m] and [rad]; 0 without
            measurement.
        active: Names of the limits that constrain the increment ("servo_0 upper", "servo_1 speed").
        reachable: False once the goal counts as unreachable.
        status: "idle" (no goal); "moving"; "limited" (moving, constrained by the limits of `active`);
            "reached" (within the tolerance, at rest there, and within torque limits); "unreachable" (at rest,
            and no step within the limits leads nearer); "stalled" (no nearer for long, though a step is
            predicted to lead there); or the reason why nothing moves: "infeasible", "not_converged" (the
            program), "diverged" (the model).
        kkt_residual: Largest violation of the program's optimality conditions, in [rad] or [m].
        sensitivity_age: Consecutive ticks, including this one, in which the sensitivity could not be computed
            and the previous one was used (there is none near a branch of equilibria); 0: it is up to date.
        qp_ms, tick_ms: Time of the program (build, solve, check) and of the whole tick in [ms].
        message: Status message for a person.
    """

    command: Array
    model_pose: Pose
    residual_m: float
    residual_rad: float
    mismatch_m: float
    mismatch_rad: float
    active: tuple[str, ...]
    reachable: bool
    status: InverseStatus
    kkt_residual: float
    sensitivity_age: int
    qp_ms: float
    tick_ms: float
    message: str
    sentence = FormerAttribute("message")


class InverseController:
    """Controller from effector goals to joint commands, with its own model of the robot.

    Args:
        scene: The robot; its own controllers and start move are not part of the model.
        settings: None: the robot file's key `inverse`.
        backend: Backend of the model's step, as in Simulation.

    Attributes:
        robot: The robot.
        model: The model; read-only.
        settings: The settings in use.
        limits: Joint limits of one tick.

    Raises:
        SceneError: no end effector or no joints, or the package daqp is missing.
    """

    def __init__(
        self,
        scene: SceneDescription | RobotDescription,
        settings: InverseSettings | None = None,
        backend: Literal["auto", "numba", "scipy"] | None = None,
    ) -> None:
        need_daqp()
        self.robot = as_robot(scene)
        self.settings = self.robot.inverse if settings is None else settings
        alone = self.robot.robot_alone()
        bodies = tuple(replace(body, surface=None) for body in alone.scene.bodies)
        self.model = Simulation(alone.with_scene(bodies=bodies), backend)
        self.model.enforce_limits = False  # the program enforces the limits
        self.limits = Limits.of(self.robot.scene, self.settings, self.model.dt)
        self._sensitivity = sensitivity_of(self.model, replace(self.settings, backend="analytic"))
        self._period = 0.0
        self._begin(self.model.joint_targets)

    @property
    def period(self) -> float:
        """Duration of a tick in [s]: the scene's dt."""
        return self.model.dt

    @property
    def goal(self) -> Pose | None:
        """The present goal, or None."""
        return self._goal

    @property
    def command(self) -> Array:
        """The last command in [rad] or [m], shape (j,)."""
        return self.model.joint_targets

    @property
    def slowest_period(self) -> float:
        """Slowest period of the model in [s] where control was started; it limits the rate."""
        return self._period

    @property
    def correction(self) -> Array:
        """Learned correction of the model: shift in [m] and rotation vector in [rad], shape (6,)."""
        return self._correction.copy()

    def start(self, joints: Sequence[float] | Array | None = None, base_shift: float | None = None) -> None:
        """Place the model at the robot's present joints, at rest and without goal; commands start from there.

        Args:
            joints: In [rad] or [m], shape (j,), inside the limits or not; None: the last command.
            base_shift: Shift in [m] of the joint bases; None: where the robot's start move ends, else 0.

        Raises:
            CommandError: wrong length or not finite; nothing is changed.
            SolverDivergedError: the model cannot reach the joints.
        """
        # `place` checks the joints again, but resets the model before.
        asked = self.command if joints is None else joints
        positions = np.array(check_command(list(asked), self.model.joint_names))
        shift = self.robot.start_shift if base_shift is None else float(base_shift)
        if not math.isfinite(shift):
            raise CommandError(f"base_shift {shift} refused: expected finite metres; nothing was moved")
        place(self.model, positions, shift)
        self._begin(positions)

    def _begin(self, joints: Array) -> None:
        """Reset to rest at given joints, without goal; measure the slowest period at a stable equilibrium."""
        posture = self.settings.posture
        self._posture = joints.copy() if posture is None else np.array(self.robot.poses[posture])
        self._sampled_at: Array | None = None
        with suppress(np.linalg.LinAlgError, FactorisationError):
            self._period = slowest_period(self.model)
        self._goal: Pose | None = None
        self._pose: Pose | None = None
        self._velocities = self.model.velocities
        self._moved, self._dq = np.zeros(6), np.zeros_like(self.command)
        self._lag, self._correction = np.zeros(6), np.zeros(6)
        self._sensitivity_age = 0
        self._damping = AdaptiveDamping(len(self.command), self.settings.lever)
        self._set_out()

    def _set_out(self) -> None:
        """Forget what happened on the way to the last goal."""
        self._rested, self._retried, self._returning = 0.0, False, False
        self._damping.rest()

    def set_goal(self, goal: Pose | None) -> None:
        """Set the goal of the effector in the world; None: stay.

        Raises:
            CommandError: not finite, or no rotation; the goal is not changed.
        """
        if goal is not None:
            try:
                position = np.array(goal.position, dtype=float)
                quaternion = np.array(goal.quaternion_xyzw, dtype=float)
            except (TypeError, ValueError):
                raise CommandError(
                    "goal refused: position and quaternion must be arrays of numbers; the goal stays"
                ) from None
            norm = float(np.linalg.norm(quaternion))
            if position.shape != (3,) or quaternion.shape != (4,) or not np.isfinite(position).all():
                raise CommandError(
                    f"goal at {position.tolist()} refused: expected three finite numbers; the goal stays"
                )
            if not 1e-6 < norm < math.inf:  # also rejects NaN
                raise CommandError(
                    f"goal orientation {quaternion.tolist()} refused: expected a unit quaternion "
                    "(x, y, z, w); the goal stays"
                )
            goal = Pose(position, quaternion / norm)
        last, self._goal = self._goal, goal
        if (
            goal is None
            or last is None
            or not (
                np.array_equal(goal.position, last.position)
                and np.array_equal(goal.quaternion_xyzw, last.quaternion_xyzw)
            )
        ):
            self._set_out()

    def tick(self, measured: Pose | None = None) -> InverseReport:
        """Advance by one dt: compute an increment towards the goal within all limits, and step the model.

        Without goal, the command does not change.

        Args:
            measured: Measured pose of the real effector; a part (position or quaternion) that is not finite
                counts as not measured.
        """
        started = perf_counter()
        before = effector(self.model) if self._pose is None else self._pose
        mismatch = self._learn(measured, before)
        solution, qp_ms = Solution(np.zeros_like(self.command), "solved", 0.0, ()), 0.0
        task: Task | None = None
        taken_up = np.zeros_like(self.command)
        if self._goal is None:
            self._sensitivity_age = 0
        else:
            corrected = self._correction.any()  # the model's goal for which the plant is at the given one
            goal = _shift_pose(self._goal, -self._correction) if corrected else self._goal
            task = task_for(goal, self.settings)
            self._sensitivity = self._renew_sensitivity()
            qp_started = perf_counter()
            qp, taken_up = self._program(task, before)
            solution = solve_taut(qp, self._pace.approach)
            qp_ms = 1e3 * (perf_counter() - qp_started)
        diverged = not self._advance(solution.dq + taken_up * (solution.status == "solved"))
        overloaded = () if self._goal is None else self._find_overloads()
        active = tuple(dict.fromkeys((*solution.active, *overloaded)))
        pose, residual = effector(self.model), (0.0, 0.0)
        self._pose, self._moved, self._dq = pose, pose_difference(pose, before), solution.dq
        status: InverseStatus = "idle"
        if self._goal is not None and task is not None:
            residual = self._residual(self._fill_unmeasured(pose, measured))
            if self._returning:
                status = self._return(solution)
            else:
                reached = self._fill_unmeasured(before, measured)
                status = self._retry(self._progress(task, before, reached, residual, solution))
            status = "limited" if overloaded and status == "reached" else status
        if diverged:
            status = "diverged"
        return InverseReport(
            self.command, pose, *residual, *mismatch, active, status != "unreachable", status,
            solution.kkt_residual, self._sensitivity_age, qp_ms, 1e3 * (perf_counter() - started),
            self._message(status, residual, mismatch, active),
        )  # fmt: skip

    # --- parts of a tick ---

    @property
    def _pace(self) -> Pace:
        """Shares of a tick at the present settings."""
        solver, parameters = self.model.scene.solver, self.model.parameters
        numerical = self.period if solver.time_integration == "implicit_euler" else 0.0
        damping = parameters.rayleigh_mass, parameters.rayleigh_stiffness + numerical
        return pace(self.settings.rate_at(self.period), self._period, damping, self.period)

    def _program(self, task: Task, pose: Pose) -> tuple[QP, Array]:
        """Build the program of this tick.

        Returns:
            The program, and the joint increments that take up slack before others have an effect, shape (j,).
        """
        shares, limits = self._pace, self.limits
        robot, rows = linearise_robot(self.model, self._sensitivity, limits)
        most = np.minimum(limits.step, np.maximum(limits.upper - self.command, 0.0))
        taken_up = np.clip(robot.joints - self.command, 0.0, most) if rows else np.zeros_like(most)
        tasks, settings = [task], self.settings
        if self._returning:
            tasks, settings = [], replace(settings, posture_weight=1.0, effort_weight=0.0)
        qp = build(
            tasks, robot._replace(pose=pose, joints=self.command + taken_up), limits, settings,
            aim=StepTarget(shares.approach, shares.full, -shares.catch_up * self._lag),
            posture=self._posture, constraints=rows,
            damping=self._damping.at(self._sensitivity.effector * limits.scale),
        )  # fmt: skip
        fastest = (limits.step - taken_up) / qp.scale
        upper, lower = np.minimum(qp.upper, fastest), np.minimum(qp.lower, fastest)
        return qp._replace(upper=upper, lower=lower, at_upper=qp.at_upper & (qp.upper <= fastest)), taken_up

    def _renew_sensitivity(self) -> Sensitivity:
        """Return the present sensitivity; near a branch of equilibria return the previous one, a tick older.

        Also determine the remaining motion of the effector until it rests under the present commands. Inertia
        and damping delay this motion; they are treated as loads on an equilibrium.
        """
        velocities, parameters = self.model.velocities, self.model.parameters
        acceleration = (velocities - self._velocities) / self.period + parameters.rayleigh_mass * velocities
        self._velocities = velocities
        loads = self.model.model.momentum(acceleration) if acceleration.any() else None
        try:
            fresh = self._sampled_or_analytic(loads)
        except (np.linalg.LinAlgError, FactorisationError, NotConvergedError):
            fresh = None
        if fresh is None or not all(
            np.isfinite(part).all() for part in (fresh.effector, fresh.effort, fresh.loaded)
        ):
            self._sensitivity_age += 1
            self._lag = np.zeros(6)
            return self._sensitivity
        self._sensitivity_age = 0
        speed = (self._moved - fresh.effector @ self._dq) / self.period
        self._lag = fresh.loaded + parameters.rayleigh_stiffness * np.nan_to_num(speed)
        return fresh

    def _sampled_or_analytic(self, loads: Array | None) -> Sensitivity:
        """Return the configured back end's sensitivity; a sampled one is reused while joints are near."""
        if self.settings.backend == "analytic":
            return sensitivity_of(self.model, self.settings, loads)
        last, here = self._sampled_at, self.command
        if last is None or (np.abs(here - last) / self.limits.scale).max() > RESAMPLE:
            self._sensitivity = sensitivity_of(self.model, self.settings)
            self._sampled_at = here
        loaded = analytic_sensitivity(self.model, loads=loads).loaded
        return replace(self._sensitivity, loaded=loaded)

    def _advance(self, dq: Array) -> bool:
        """Step the model under the next command; return False if it diverged, and keep the command."""
        last = self.command
        inside = np.maximum(last + dq, np.minimum(self.limits.lower, last))
        self.model.command(np.minimum(inside, np.maximum(self.limits.upper, last)))
        try:
            self.model.step()
        except SolverDivergedError:
            self.model.command(last)
            return False
        return True

    def _progress(
        self, task: Task, before: Pose, reached: Pose, residual: tuple[float, float], solution: Solution
    ) -> InverseStatus:
        """Record a tick towards the goal, and return its status."""
        settings, shares = self.settings, self._pace
        left = lengths(task, task.jacobian(self._lag[:, None], before)[:, 0])  # remaining motion until rest
        there = self._is_there(residual) and self._is_there(left)
        ends = self._residual(_shift_pose(reached, self._lag))
        weight = shares.approach / shares.full
        distance = ends[0] + settings.lever * ends[1]
        dq = solution.dq / self.limits.scale
        self._damping.learn(dq, distance, there=there, approach=shares.approach, weight=weight)
        if solution.status != "solved":
            self._rested = 0.0
            return solution.status
        steps = self._moved, self._sensitivity.effector @ solution.dq  # of the body, and of its rest pose
        to_come = [task.jacobian((each / shares.approach)[:, None], before)[:, 0] for each in steps]
        rests = all(self._is_there(each, AT_REST) for each in (left, *(lengths(task, e) for e in to_come)))
        self._rested = self._rested + weight if rests else 0.0
        if there:
            return "reached"
        if self._rested >= PATIENCE and self._is_nearest(task, before):
            return "unreachable"
        if max(self._rested, self._damping.stalled) >= PATIENCE_STALLED:
            return "stalled"
        return "moving" if all(name.endswith(" speed") for name in solution.active) else "limited"

    def _retry(self, status: InverseStatus) -> InverseStatus:
        """Set out for the posture where the status says that this way leads no nearer, once for each goal.

        The straight way between goals on two sides of an arm may end where the arm has curled up.
        """
        if not self.settings.retry or self._retried or status not in ("stalled", "unreachable"):
            return status
        self._set_out()
        self._retried = self._returning = True
        return "moving"

    def _return(self, solution: Solution) -> InverseStatus:
        """Record a tick on the way back to the posture, and return its status."""
        if solution.status != "solved":
            return solution.status
        slow = float(np.abs(solution.dq / self.limits.step).max()) <= RETURNED
        self._rested = self._rested + 1.0 if slow else 0.0
        if self._rested >= PATIENCE:  # there, or limits are in the way
            self._set_out()
            self._retried = True
        return "moving" if all(name.endswith(" speed") for name in solution.active) else "limited"

    def _find_overloads(self) -> tuple[str, ...]:
        """Return the names of the torque limits that the efforts exceed, whatever the program predicted.

        The program predicts tensions from commands only while cable routes are independent. How several
        tendons of one route share a tension is not determined by their commands.
        """
        over = np.abs(self.model.joint_efforts) > (1.0 + OVERLOAD) * self.limits.torque
        return tuple(f"{self.limits.names[joint]} torque" for joint in np.flatnonzero(over))

    def _is_nearest(self, task: Task, pose: Pose) -> bool:
        """Return whether no step within the limits, at any number of ticks, leads nearer."""
        if self._sensitivity_age:
            return False
        far = far_limits(self.limits)
        robot, rows = linearise_robot(self.model, self._sensitivity, far)
        return is_optimal([task], robot._replace(pose=pose), rows, far, self.settings)

    def _is_there(self, residual: tuple[float, float], part: float = 1.0) -> bool:
        settings = self.settings
        return residual[0] <= part * settings.tolerance and residual[1] <= part * settings.tolerance_turn

    # --- feedback ---

    def _learn(self, measured: Pose | None, pose: Pose) -> tuple[float, float]:
        """Move the correction towards the measurement; return the model's distance in [m] and [rad]."""
        if measured is None:
            return 0.0, 0.0
        settings, distance = self.settings, [0.0, 0.0]
        share = 1.0 - math.exp(-min(settings.feedback_gain, self._pace.rate) * self.period)
        limits = settings.max_correction, settings.max_correction_turn
        for k, each in enumerate(np.split(pose_difference(measured, pose), 2)):
            if np.isfinite(each).all():
                part = self._correction[3 * k : 3 * k + 3]  # a view
                part += share * (each - part)
                length = float(np.linalg.norm(part))
                if length > limits[k]:
                    part *= limits[k] / length
                distance[k] = float(np.linalg.norm(each))
        return distance[0], distance[1]

    def _fill_unmeasured(self, pose: Pose, measured: Pose | None) -> Pose:
        """Return the measured pose of the effector, with the model's pose where it was not measured."""
        if measured is None:
            return pose
        position, quaternion = measured.position, measured.quaternion_xyzw
        return Pose(
            position if np.isfinite(position).all() else pose.position,
            quaternion if np.isfinite(quaternion).all() else pose.quaternion_xyzw,
        )

    def _residual(self, pose: Pose) -> tuple[float, float]:
        """Return the distance in [m] and [rad] of a pose from the goal."""
        assert self._goal is not None
        return residuals([task_for(self._goal, self.settings)], pose)

    # --- messages ---

    def _message(
        self,
        status: InverseStatus,
        residual: tuple[float, float],
        mismatch: tuple[float, float],
        active: tuple[str, ...],
    ) -> str:
        away = _distance(*residual, self.settings.task)
        limits = f" (limits: {', '.join(active)})" if active else ""
        message = {
            "idle": "no goal, holding",
            "moving": f"on the way, {away} away",
            "reached": f"at the goal, {away} away",
            "limited": f"on the way, {away} away{limits}",
            "unreachable": f"unreachable, {away} away{limits}",
            "stalled": f"no nearer for a while, {away} away{limits}; give another goal, or start elsewhere",
            "infeasible": "no joint step keeps all limits, holding; widen them or start elsewhere",
            "not_converged": "the joint step could not be solved for, holding",
            "diverged": "the model diverged, holding; start again from the robot's joints",
        }[status]
        if self._returning and status in ("moving", "limited"):
            message = f"going back to try once more from the posture, {away} away{limits}"
        if self._sensitivity_age and status != "idle":
            ticks = f"{self._sensitivity_age} tick{'s' if self._sensitivity_age > 1 else ''}"
            message += f"; the sensitivity is {ticks} old, as none exists at this pose"
        if self.settings.feedback_gain == 0.0 and any(mismatch):
            return f"{message}; the model is {_distance(*mismatch, 'pose')} off the measured pose"
        return message


def _shift_pose(pose: Pose, displacement: Array) -> Pose:
    """Return a pose moved by a shift in [m] and a rotation vector in [rad], shape (6,)."""
    turned = rotation_exp(displacement[3:]) @ rotation_of(pose.quaternion_xyzw)
    return Pose(pose.position + displacement[:3], quaternion_of(turned))


def pose_difference(measured: Pose, pose: Pose) -> Array:
    """Return shift in [m] and rotation vector in [rad] from a pose to a measured one, shape (6,).

    A number is not finite where the position was not measured, the rotation is NaN where it was not.
    """
    norm = float(np.linalg.norm(measured.quaternion_xyzw))
    turn = np.full(3, np.nan)
    if 1e-6 < norm < math.inf:
        rotation = rotation_of(measured.quaternion_xyzw / norm)
        turn = rotation_log(rotation @ rotation_of(pose.quaternion_xyzw).T)
    return np.concatenate([measured.position - pose.position, turn])


def _distance(shift: float, turn: float, task: str) -> str:
    """Format a distance as the task measures it: "3.21 mm", "1.5 deg", or both."""
    values = [(shift / MILLIMETRE, "mm")] if task != "orientation" else []
    values += [(degrees(turn), "deg")] if task != "position" else []
    digits = (f"{each:.0f} {unit}" if each >= 1000.0 else f"{each:.3g} {unit}" for each, unit in values)
    return " and ".join(digits)  # without exponent
