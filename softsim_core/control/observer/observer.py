"""Observer: a model that steps with the robot and is corrected by measurements.

The unknowns z (see filter) act on the model: its joints follow the read-back plus their offsets, under its
loads. A step advances the whole nonlinear model. Then, with H and Phi the derivatives of sensors and nodes by
z in static equilibrium,

    v = y - h(x),   S = H P H^T + R,   z <- z + K v,   x <- x + Phi K v

So z and x are always consistent, and the next step corrects the remaining linearisation error. This is an
extended Kalman filter with its state on the manifold of equilibria around the model's motion. It filters
sixteen numbers instead of a thousand. An ensemble filter would step one model per member.

Source: Jazwinski 1970 (extended filter); Willsky and Jones 1976 (jumps of the touch, see filter).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from softsim_core.base import (
    Array,
    Backend,
    FactorisationError,
    SceneError,
    SolverDivergedError,
    known_names,
    listing,
)
from softsim_core.control.inverse import place
from softsim_core.control.observer.filter import (
    WINDOWS,
    JumpDetector,
    StateEstimate,
    Unknowns,
    chi_square_limit,
    squared_distance,
)
from softsim_core.control.observer.sensors import Sensor, effector_frame, frame_rows
from softsim_core.control.observer.settings import Estimate, ObserverSettings, Touch, Verdict
from softsim_core.physics.mechanics import Model, Rows, check_command, join_rows
from softsim_core.scene import RobotDescription, SceneDescription, as_robot
from softsim_core.simulation import Simulation

NODES = 16
"""Number of free nodes whose motion is updated in one step."""


class NodeMotion:
    """Derivatives of the free nodes by p unknowns, updated in turn, a part of the nodes per step.

    Args:
        model: The model.
        unknowns: p.
    """

    def __init__(self, model: Model, unknowns: int) -> None:
        self._model = model
        self._free = model.free_nodes
        self._next = 0
        self.by_unknowns = np.zeros((len(self._free), 3, unknowns))
        """Derivatives in [m] a unit of each unknown, in the order of Model.free_nodes, shape (k, 3, p)."""

    @property
    def parts(self) -> int:
        """Number of steps that update all nodes."""
        return -(-len(self._free) // NODES)

    def rows(self) -> Rows:
        """Return the rows for which `take` expects derivatives next."""
        nodes = self._free[self._next : self._next + NODES]
        place = np.repeat(nodes, 3)
        return Rows(np.arange(len(place) + 1), place, np.tile(np.eye(3), (len(nodes), 1)))

    def take(self, derivatives: Array) -> None:
        """Store the derivatives (r, p) of the rows and advance to the next nodes."""
        count = len(derivatives) // 3
        self.by_unknowns[self._next : self._next + count] = derivatives.reshape(count, 3, -1)
        self._next = 0 if self._next + count >= len(self._free) else self._next + count

    def of_all(self, simulation: Simulation, reduced: Array) -> Array:
        """Return derivatives of all nodes (n, 3, p), from those of frames and joints (b, p)."""
        result = np.zeros((len(self._model.rest), 3, reduced.shape[1]))
        result[self._free] = self.by_unknowns
        for nodes, moved in simulation.region_motion():
            result[nodes] = moved @ reduced
        return result


SURE = 1e-9
"""Probability that a right model is rejected, per test of the innovations of a window."""

IMPLAUSIBLE = 5.0
"""Largest deviation of an unknown from its prior, in standard deviations, that counts as plausible."""


class ConsistencyTest:
    """Consistency test (NIS) on a window of v^T S^-1 v; their sum is chi-square distributed.

    Args:
        steps: Length of the window in steps.
        unknowns, prior: The unknowns and their estimate before any measurement.

    Source: Bar-Shalom, Li and Kirubarajan 2001, consistency of filters (normalised innovation squared).
    """

    def __init__(self, steps: int, unknowns: Unknowns, prior: StateEstimate) -> None:
        self._distances: deque[tuple[float, int]] = deque(maxlen=max(1, steps))
        self._unknowns, self._prior = unknowns, prior.deviation

    def take(self, distance: float, freedom: int) -> None:
        """Add v^T S^-1 v of a step that measured `freedom` coordinates."""
        self._distances.append((distance, freedom))

    @property
    def consistency(self) -> float:
        """Mean of v^T S^-1 v per coordinate: 1 if the model is consistent, or if nothing was measured."""
        freedom = sum(m for _, m in self._distances)
        return sum(each for each, _ in self._distances) / freedom if freedom else 1.0

    def message(self, estimate: StateEstimate) -> str:
        """Return a message with the evidence against the model; empty: there is none."""
        freedom, ratio = sum(m for _, m in self._distances), self.consistency
        if freedom and ratio * freedom > chi_square_limit(freedom, SURE):
            return (
                f"measurements are {math.sqrt(ratio):.1f} times as far from the model as its and their "
                "uncertainty allow: the model, or the noise that the sensors are said to have, is wrong"
            )
        uncertain = np.flatnonzero(self._prior)
        far = np.abs(estimate.mean[uncertain]) / self._prior[uncertain]
        if far.max(initial=0.0) <= IMPLAUSIBLE:
            return ""
        name = self._unknowns.name(int(uncertain[np.argmax(far)]))
        return f"{name} had to be taken {far.max():.1f} times as far off as the model may be"


NONLINEAR = 0.1
"""Part of a correction that is attributed to linearisation error."""

NOTHING = 9.0
"""A touch with a smaller squared distance from zero is discarded."""


class Observer:
    """Observer of a robot: a model that follows it, with estimated unknowns.

    Args:
        robot: The robot; its own controllers and start move are not part of the model.
        sensors: Function that returns the sensors (see the module sensors) of the model without changing it.
        settings: Uncertainty of the model.
        backend: Backend of the model's step, as in Simulation.

    Attributes:
        model: The estimate of nodes, frames and joints; read-only.
        unknowns: Positions of the unknowns in `state_estimate`.
        state_estimate: Estimate of the unknowns.
        settings: The settings in use.

    Raises:
        SceneError: two sensors have one name.
    """

    def __init__(
        self,
        robot: SceneDescription | RobotDescription,
        sensors: Callable[[Simulation], Sequence[Sensor]],
        settings: ObserverSettings | None = None,
        backend: Backend | None = None,
    ) -> None:
        self.settings = settings or ObserverSettings()
        self.model = Simulation(as_robot(robot).robot_alone(), backend)
        self.model.enforce_limits = False
        found = sensors(self.model)
        self.sensors = {sensor.name: sensor for sensor in found}
        if len(self.sensors) < len(found):
            raise SceneError(f"two sensors have one name: {listing([sensor.name for sensor in found])}")
        self.unknowns = Unknowns(self.model, list(self.sensors.values()))
        pushes = self.unknowns.acting - self.unknowns.touch.start
        self._effector = pushes > 0
        self._motion = NodeMotion(self.model.model, self.unknowns.acting)
        s, dt = self.settings, self.model.dt
        self._touch = np.array([*[s.touch] * 3, *[s.touch_moment] * 3])[:pushes]
        self._detector = JumpDetector(self._touch, min(s.false_contacts * dt / 3600.0, 0.5))
        self.start(self.model.joint_targets, 0.0)

    @property
    def dt(self) -> float:
        """Time of a step in [s]: the robot's."""
        return self.model.dt

    def start(self, joints: Sequence[float] | Array, base_shift: float = 0.0) -> None:
        """Place the model at rest at given joints and reset the estimate.

        Args:
            joints: As read back, in [rad] or [m], shape (j,).
            base_shift: Shift in [m] of the joint bases.

        Raises:
            CommandError: wrong length or not finite.
            SolverDivergedError: the model cannot reach the joints.
        """
        place(self.model, np.asarray(joints, dtype=float), base_shift)
        self.state_estimate = self.unknowns.prior(self.settings)
        self._joints = self.model.joint_targets
        self._bad = dict.fromkeys(self.sensors, 0)
        self._learned = self._silent = 0.0
        self._touching, self._doubtful = False, 0.0
        self._before: deque[StateEstimate] = deque(maxlen=WINDOWS[-1])
        self._consistency = ConsistencyTest(
            round(self.settings.window / self.dt), self.unknowns, self.state_estimate
        )
        self._detector.forget()
        for _ in range(self._motion.parts):
            self._linearised = self._linearise()

    def step(
        self,
        joints: Sequence[float] | Array,
        measured: Mapping[str, object],
        base_shift: float | None = None,
    ) -> Estimate:
        """Advance by one dt and return the estimate.

        Args:
            joints: As read back now, in [rad] or [m], shape (j,).
            measured: Measurements since the last step by sensor name; see the classes of the sensors.
            base_shift: Shift in [m] of the joint bases; None: unchanged.

        Raises:
            CommandError: wrong length or not finite; nothing is changed.
            SolverDivergedError: the model diverged; it stays in its last state, and `start` begins again.
            SceneError: no sensor of such a name; nothing is changed.
        """
        if unknown := [name for name in measured if name not in self.sensors]:
            raise SceneError(
                f"no sensor {unknown[0]!r}; {known_names(unknown[0], self.sensors, 'there are:')}"
            )
        travel = self._advance(joints, base_shift)
        with suppress(FactorisationError, np.linalg.LinAlgError):  # else keep the last linearisation
            self._linearised = self._linearise()
        self._before.append(self.state_estimate)
        self.state_estimate = self.state_estimate.spread(self._change(travel))
        measurement, left_out = self._compare_measurements(measured, travel / self.dt)
        self._learn(measurement)
        self._end_touch()
        return self._estimate(len(measurement.innovation), left_out)

    # --- parts of a step ---

    def _advance(self, joints: Sequence[float] | Array, base_shift: float | None) -> Array:
        """Step the model to the joints; return their travel, shape (j,)."""
        model, mean = self.model, self.state_estimate.mean
        # `command` checks again, but after the forces are set, and with the offsets added.
        read = np.array(check_command(list(joints), model.joint_names))
        fields = self.unknowns.fields(model)
        model.forces = self.unknowns.forces(fields, mean)
        targets = model.joint_targets
        model.command(read + mean[self.unknowns.offsets])
        if base_shift is not None:
            model.base_shift = base_shift
        try:
            model.step()
        except SolverDivergedError:
            model.command(targets)
            raise
        travel, self._joints = read - self._joints, read
        return np.asarray(travel)

    def _linearise(self) -> _Linearised:
        """Return derivatives by the unknowns in the model's present state."""
        model, unknowns = self.model, self.unknowns
        fields = unknowns.fields(model)
        parts = [unknowns.rows(fields)]
        loads = parts[0].height
        if self._effector:
            parts.append(frame_rows(model.model, effector_frame(model)))
        parts += [sensor.rows(model.model) for sensor in self.sensors.values()]
        parts.append(self._motion.rows())
        response = model.static_response(join_rows(parts))
        ends = np.cumsum([part.height for part in parts])
        by_command, by_load = response.rows_by_command, response.rows_by_row[:, :loads]
        derivatives = np.split(unknowns.columns(by_command, by_load), ends[:-1])[1:]
        self._motion.take(derivatives.pop())
        effector = derivatives.pop(0) if self._effector else np.zeros((0, unknowns.acting))
        reduced = unknowns.columns(response.reduced_by_command, response.reduced_by_row[:, :loads])
        return _Linearised(effector, dict(zip(self.sensors, derivatives, strict=True)), reduced)

    def _change(self, travel: Array) -> Array:
        """Return the variances (p,) of the unknowns' changes in this step."""
        variance = self.unknowns.change(self.settings, self.dt, travel)
        if self._touching:
            variance[self.unknowns.touch] = self.dt * (self.settings.touch_rate * self._touch) ** 2
        return variance

    def _compare_measurements(
        self, measured: Mapping[str, object], speed: Array
    ) -> tuple[_Measurement, tuple[str, ...]]:
        """Return measurements minus expected values without outliers, and the names of the outliers."""
        offsets, settings = self.unknowns.offsets, self.settings
        jitter = self.unknowns.joint_variance(settings)
        parts: list[tuple[Array, Array, Array]] = []
        left_out: list[str] = []
        for name, value in measured.items():
            sensor, rows = self.sensors[name], self._rows(name)
            innovation = (
                sensor.innovation(self.model, value) - self.state_estimate.mean[self.unknowns.misplaced[name]]
            )
            finite = np.isfinite(innovation)
            if not finite.any():
                continue
            innovation, rows = innovation[finite], rows[finite]
            noise = np.diag(sensor.noise[finite] ** 2)
            if self._is_outlier(name, innovation, rows, noise):
                left_out.append(name)
            else:
                parts.append((innovation, rows, sensor.noise[finite] ** 2))
        if not parts:
            nothing = _Measurement(np.zeros(0), np.zeros((0, self.unknowns.size)), np.zeros((0, 0)))
            return nothing, tuple(left_out)
        innovation, rows, variance = (np.concatenate(each) for each in zip(*parts, strict=True))
        by_joints = rows[:, offsets]
        late = settings.latency * by_joints @ speed
        noise = np.diag(variance) + np.outer(late, late) + (by_joints * jitter) @ by_joints.T
        return _Measurement(innovation, rows, noise), tuple(left_out)

    def _rows(self, name: str) -> Array:
        """Return the derivatives of a sensor by all unknowns, shape (m, p)."""
        acting = self._linearised.sensors[name]
        rows = np.zeros((len(acting), self.unknowns.size))
        rows[:, : self.unknowns.acting] = acting
        rows[:, self.unknowns.misplaced[name]] = np.eye(len(acting))
        return rows

    def _is_outlier(self, name: str, innovation: Array, rows: Array, noise: Array) -> bool:
        """Return whether a measurement is too far off to be used; a persistent deviation is no outlier."""
        expected = rows @ self.state_estimate.covariance @ rows.T + noise
        far = squared_distance(innovation, expected) > self.settings.outlier * len(innovation)
        self._bad[name] = self._bad[name] + 1 if far else 0
        return 0 < self._bad[name] <= self.settings.patience

    def _learn(self, measurement: _Measurement) -> None:
        """Update the estimate, and move the model with it."""
        self._silent = 0.0 if len(measurement.innovation) else self._silent + self.dt
        if not len(measurement.innovation):
            return
        learning, self._learned = self._learned < self.settings.learning, self._learned + self.dt
        innovation, rows, touch = measurement.innovation, measurement.rows, self.unknowns.touch
        expected = rows @ self.state_estimate.covariance @ rows.T + measurement.noise
        if not learning:
            jump = self._detector.look(innovation, rows[:, touch], expected)
            if jump is not None:
                began = self._before[-min(jump.steps, len(self._before))]
                self._set_estimate(began.with_unknowns(touch, began.mean[touch] + jump.mean, jump.covariance))
                self._detector.forget()
                self._touching, self._doubtful = True, 0.0
                return
            self._consistency.take(squared_distance(innovation, expected), len(innovation))
        before = self.state_estimate.mean
        estimate = self.state_estimate.with_measurement(*measurement)
        missed = NONLINEAR * (estimate.mean - before)
        self._set_estimate(estimate.spread(missed**2))

    def _set_estimate(self, estimate: StateEstimate) -> None:
        """Set the estimate, and move the model to the state that belongs to it."""
        change = (estimate.mean - self.state_estimate.mean)[: self.unknowns.acting]
        self.state_estimate = estimate
        if change.any():
            self.model.displace(self._motion.by_unknowns @ change, self._linearised.reduced @ change)

    def _end_touch(self) -> None:
        """End a touch that measurements no longer support, or that is no longer measured."""
        if not self._touching:
            return
        touch, estimate = self.unknowns.touch, self.state_estimate
        distance = squared_distance(estimate.mean[touch], estimate.covariance[touch, touch])
        self._doubtful = self._doubtful + self.dt if distance < NOTHING else 0.0
        if self._doubtful >= self.settings.release or self._silent > self.settings.silence:
            self._set_estimate(self.state_estimate.with_fixed_unknowns(touch))
            self._detector.forget()
            self._touching = False

    # --- results ---

    def deviation(self) -> Array:
        """Return each node's standard deviation in [m], shape (n,): root of the sum over three axes."""
        derivatives = self._motion.of_all(self.model, self._linearised.reduced)
        covariance = self._acting_covariance
        variance = np.einsum("nap,pq,naq->n", derivatives, covariance, derivatives, optimize=True)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    @property
    def _acting_covariance(self) -> Array:
        return self.state_estimate.covariance[: self.unknowns.acting, : self.unknowns.acting]

    def _estimate(self, used: int, left_out: tuple[str, ...]) -> Estimate:
        message = self._consistency.message(self.state_estimate)
        verdict: Verdict = "wrong" if message else "good"
        if self._silent > self.settings.silence or self._learned == 0.0:
            verdict, message = "alone", ""
        elif self._learned < self.settings.learning:
            verdict, message = "learning", ""
        rows = self._linearised.effector
        touch, part = None, self.unknowns.touch
        if self._touching:
            wrench = self.state_estimate.mean[part]
            touch = Touch(wrench[:3].copy(), wrench[3:].copy(), self.state_estimate.deviation[part])
        return Estimate(
            self.model.effector_pose, rows @ self._acting_covariance @ rows.T, touch, verdict, message,
            self._consistency.consistency, used, left_out,
        )  # fmt: skip


class _Linearised(NamedTuple):
    """Derivatives by the unknowns: of the effector (6, p), of the sensors, of frames and joints (b, p)."""

    effector: Array
    sensors: dict[str, Array]
    reduced: Array


class _Measurement(NamedTuple):
    """Measurements of a step: innovation (m,), its derivatives (m, p), covariance of its noise (m, m)."""

    innovation: Array
    rows: Array
    noise: Array
