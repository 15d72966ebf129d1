"""An observer: a model that steps with the robot and is corrected by measurements.

The unknowns z (see filter) act on the model: its joints go where the read-back and their offsets say, under
its loads. A step is a step of the whole nonlinear model; then, with H and Phi the derivatives of sensors and
nodes by z in static equilibrium,

    v = y - h(x),   S = H P H^T + R,   z <- z + K v,   x <- x + Phi K v

So z and x always belong together, and what is left of a wrong linearisation the next step mends: an extended
Kalman filter whose state lies on the manifold of equilibria around the model's motion. Sixteen numbers are
filtered in place of a thousand; an ensemble would step a model for each of its members.

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
    Belief,
    Jump,
    JumpDetector,
    Unknowns,
    chi_square_limit,
    squared_distance,
)
from softsim_core.control.observer.sensors import Sensor, effector_frame, frame_rows
from softsim_core.control.observer.settings import Estimate, ObserverSettings, Touch, Verdict
from softsim_core.physics.mechanics import Model, Rows, check_command, joined
from softsim_core.scene import RobotDescription, SceneDescription, as_robot
from softsim_core.simulation import Simulation

NODES = 16
"""Free nodes whose motion is computed anew in one step."""


class NodeMotion:
    """Derivatives of the free nodes by p unknowns, at most as old as it takes to go through all of them.

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
        """Steps that it takes to go through all nodes."""
        return -(-len(self._free) // NODES)

    def rows(self) -> Rows:
        """The rows whose derivatives `take` wants next."""
        nodes = self._free[self._next : self._next + NODES]
        place = np.repeat(nodes, 3)
        return Rows(np.arange(len(place) + 1), place, np.tile(np.eye(3), (len(nodes), 1)))

    def take(self, derivatives: Array) -> None:
        """The derivatives (r, p) of the rows; the next `rows` are those of the next nodes."""
        count = len(derivatives) // 3
        self.by_unknowns[self._next : self._next + count] = derivatives.reshape(count, 3, -1)
        self._next = 0 if self._next + count >= len(self._free) else self._next + count

    def of_all(self, simulation: Simulation, reduced: Array) -> Array:
        """Derivatives of all nodes (n, 3, p), from those of frames and joints (b, p)."""
        result = np.zeros((len(self._model.rest), 3, reduced.shape[1]))
        result[self._free] = self.by_unknowns
        for nodes, moved in simulation.region_motion():
            result[nodes] = moved @ reduced
        return result


SURE = 1e-9
"""Chance with which a right model is called wrong, per look at the innovations of a window."""

IMPLAUSIBLE = 5.0
"""What was learned of an unknown may be so many standard deviations of its prior."""


class Judge:
    """Keeps the normalised innovations v^T S^-1 v of a window; their sum is chi-square distributed.

    Args:
        steps: So many steps are looked at.
        unknowns, prior: What is learned, and what was believed of it before.

    Source: Bar-Shalom, Li and Kirubarajan 2001, consistency of filters (normalised innovation squared).
    """

    def __init__(self, steps: int, unknowns: Unknowns, prior: Belief) -> None:
        self._seen: deque[tuple[float, int]] = deque(maxlen=max(1, steps))
        self._unknowns, self._prior = unknowns, prior.deviation

    def take(self, distance: float, freedom: int) -> None:
        """Take v^T S^-1 v of a step that measured `freedom` coordinates."""
        self._seen.append((distance, freedom))

    @property
    def consistency(self) -> float:
        """Mean of v^T S^-1 v per coordinate: 1 where all is as believed, or where nothing was seen."""
        freedom = sum(m for _, m in self._seen)
        return sum(each for each, _ in self._seen) / freedom if freedom else 1.0

    def sentence(self, belief: Belief) -> str:
        """What speaks against the model; empty: nothing."""
        freedom, ratio = sum(m for _, m in self._seen), self.consistency
        if freedom and ratio * freedom > chi_square_limit(freedom, SURE):
            return (
                f"measurements are {math.sqrt(ratio):.1f} times as far from the model as its and their "
                "uncertainty allow: the model, or the noise that the sensors are said to have, is wrong"
            )
        known = np.flatnonzero(self._prior)
        far = np.abs(belief.mean[known]) / self._prior[known]
        if far.max(initial=0.0) <= IMPLAUSIBLE:
            return ""
        name = self._unknowns.name(int(known[np.argmax(far)]))
        return f"{name} had to be taken {far.max():.1f} times as far off as the model may be"


NONLINEAR = 0.1
"""Part of a correction by which linearisation may have missed it."""

NOTHING = 9.0
"""A touch whose squared distance from none is below this is no longer believed."""


class Observer:
    """The model of a robot beside it.

    Args:
        robot: The robot; its own controllers and start move are left out of the model.
        sensors: Gives what is measured, see the module sensors, from the model, which it leaves as it is.
        settings: How far the model may be off.
        backend: Of the model's step, as in Simulation.

    Attributes:
        model: The estimate: nodes, frames and joints are where they are believed to be. Look, do not touch.
        unknowns: Where each unknown stands in `belief`.
        belief: What is believed of the unknowns.
        settings: What was given.

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
        self.sensors = _by_name(sensors(self.model))
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
        """Stand at rest at given joints, knowing nothing yet.

        Args:
            joints: As read back, in [rad] or [m], shape (j,).
            base_shift: Shift in [m] of the joint bases.

        Raises:
            CommandError: wrong length or not finite.
            SolverDivergedError: the model cannot get there.
        """
        place(self.model, np.asarray(joints, dtype=float), base_shift)
        self.belief = self.unknowns.prior(self.settings)
        self._joints = self.model.joint_targets
        self._bad = dict.fromkeys(self.sensors, 0)
        self._learned = self._silent = 0.0
        self._touching, self._doubtful = False, 0.0
        self._before: deque[Belief] = deque(maxlen=WINDOWS[-1])
        self._judge = Judge(round(self.settings.window / self.dt), self.unknowns, self.belief)
        self._detector.forget()
        for _ in range(self._motion.parts):
            self._linearised = self._linearise()

    def step(
        self,
        joints: Sequence[float] | Array,
        measured: Mapping[str, object],
        base_shift: float | None = None,
    ) -> Estimate:
        """One dt.

        Args:
            joints: As read back now, in [rad] or [m], shape (j,).
            measured: What sensors measured since the last step, by their names; see their classes.
            base_shift: Shift in [m] of the joint bases; None: it stays.

        Raises:
            CommandError: wrong length or not finite; nothing is changed.
            SolverDivergedError: the model went astray; it stays where it was, and `start` begins anew.
            SceneError: no sensor of such a name; nothing is changed.
        """
        if unknown := [name for name in measured if name not in self.sensors]:
            raise SceneError(
                f"no sensor {unknown[0]!r}; {known_names(unknown[0], self.sensors, 'there are:')}"
            )
        travel = self._advance(joints, base_shift)
        with suppress(FactorisationError, np.linalg.LinAlgError):  # else the last one is near enough
            self._linearised = self._linearise()
        self._before.append(self.belief)
        self.belief = self.belief.spread(self._change(travel))
        seen, left_out = self._compared(measured, travel / self.dt)
        self._learn(seen)
        self._end_touch()
        return self._estimate(len(seen.innovation), left_out)

    # --- parts of a step ---

    def _advance(self, joints: Sequence[float] | Array, base_shift: float | None) -> Array:
        """Step the model to the joints; returns by how much they went, shape (j,)."""
        model, mean = self.model, self.belief.mean
        read = np.array(check_command(list(joints), model.joint_names))
        fields = self.unknowns.fields(model)
        model.forces = self.unknowns.forces(fields, mean)
        told = model.joint_targets
        model.command(read + mean[self.unknowns.offsets])
        if base_shift is not None:
            model.base_shift = base_shift
        try:
            model.step()
        except SolverDivergedError:
            model.command(told)
            raise
        travel, self._joints = read - self._joints, read
        return np.asarray(travel)

    def _linearise(self) -> _Linearised:
        """Derivatives of everything by the unknowns where the model is now."""
        model, unknowns = self.model, self.unknowns
        fields = unknowns.fields(model)
        parts = [unknowns.rows(fields)]
        loads = parts[0].height
        if self._effector:
            parts.append(frame_rows(model.model, effector_frame(model)))
        parts += [sensor.rows(model.model) for sensor in self.sensors.values()]
        parts.append(self._motion.rows())
        response = model.static_response(joined(parts))
        ends = np.cumsum([part.height for part in parts])
        by_command, by_load = response.rows_by_command, response.rows_by_row[:, :loads]
        derivatives = np.split(unknowns.columns(by_command, by_load), ends[:-1])[1:]
        self._motion.take(derivatives.pop())
        effector = derivatives.pop(0) if self._effector else np.zeros((0, unknowns.acting))
        reduced = unknowns.columns(response.reduced_by_command, response.reduced_by_row[:, :loads])
        return _Linearised(effector, dict(zip(self.sensors, derivatives, strict=True)), reduced)

    def _change(self, travel: Array) -> Array:
        """Variances (p,) by which the unknowns may have changed in this step."""
        variance = self.unknowns.change(self.settings, self.dt, travel)
        if self._touching:
            variance[self.unknowns.touch] = self.dt * (self.settings.touch_rate * self._touch) ** 2
        return variance

    def _compared(self, measured: Mapping[str, object], speed: Array) -> tuple[_Seen, tuple[str, ...]]:
        """What was measured less what is expected, without outliers, and the names of these."""
        offsets, settings = self.unknowns.offsets, self.settings
        jitter = self.unknowns.joint_variance(settings)
        parts: list[tuple[Array, Array, Array]] = []
        left_out: list[str] = []
        for name, value in measured.items():
            sensor, rows = self.sensors[name], self._rows(name)
            innovation = (
                sensor.innovation(self.model, value) - self.belief.mean[self.unknowns.misplaced[name]]
            )
            known = np.isfinite(innovation)
            if not known.any():
                continue
            innovation, rows = innovation[known], rows[known]
            noise = np.diag(sensor.noise[known] ** 2)
            if self._is_outlier(name, innovation, rows, noise):
                left_out.append(name)
            else:
                parts.append((innovation, rows, sensor.noise[known] ** 2))
        if not parts:
            return _Seen(np.zeros(0), np.zeros((0, self.unknowns.size)), np.zeros((0, 0))), tuple(left_out)
        innovation, rows, variance = (np.concatenate(each) for each in zip(*parts, strict=True))
        by_joints = rows[:, offsets]
        late = settings.latency * by_joints @ speed
        noise = np.diag(variance) + np.outer(late, late) + (by_joints * jitter) @ by_joints.T
        return _Seen(innovation, rows, noise), tuple(left_out)

    def _rows(self, name: str) -> Array:
        """Derivatives of a sensor by all unknowns, shape (m, p)."""
        acting = self._linearised.sensors[name]
        rows = np.zeros((len(acting), self.unknowns.size))
        rows[:, : self.unknowns.acting] = acting
        rows[:, self.unknowns.misplaced[name]] = np.eye(len(acting))
        return rows

    def _is_outlier(self, name: str, innovation: Array, rows: Array, noise: Array) -> bool:
        """Whether a sensor's measurement is too far off to be one; not where it stays so."""
        expected = rows @ self.belief.covariance @ rows.T + noise
        far = squared_distance(innovation, expected) > self.settings.outlier * len(innovation)
        self._bad[name] = self._bad[name] + 1 if far else 0
        return 0 < self._bad[name] <= self.settings.patience

    def _learn(self, seen: _Seen) -> None:
        """Move the belief, and the model with it."""
        self._silent = 0.0 if len(seen.innovation) else self._silent + self.dt
        if not len(seen.innovation):
            return
        learning, self._learned = self._learned < self.settings.learning, self._learned + self.dt
        expected = seen.rows @ self.belief.covariance @ seen.rows.T + seen.noise
        jump: Jump | None = None
        if not learning:
            jump = self._detector.look(seen.innovation, seen.rows[:, self.unknowns.touch], expected)
        if jump is not None:
            began = self._before[-min(jump.steps, len(self._before))]
            touch = self.unknowns.touch
            self._believe(began.opened(touch, began.mean[touch] + jump.mean, jump.covariance))
            self._detector.forget()
            self._touching, self._doubtful = True, 0.0
            return
        if not learning:
            self._judge.take(squared_distance(seen.innovation, expected), len(seen.innovation))
        before = self.belief.mean
        belief = self.belief.updated(*seen)
        missed = NONLINEAR * (belief.mean - before)
        self._believe(belief.spread(missed**2))

    def _believe(self, belief: Belief) -> None:
        """Take over a belief, and put the model where it belongs to it."""
        change = (belief.mean - self.belief.mean)[: self.unknowns.acting]
        self.belief = belief
        if change.any():
            self.model.displace(self._motion.by_unknowns @ change, self._linearised.reduced @ change)

    def _end_touch(self) -> None:
        """Believe no longer in a touch for which nothing speaks, or of which nothing is measured any more."""
        if not self._touching:
            return
        touch = self.unknowns.touch
        nothing = squared_distance(self.belief.mean[touch], self.belief.covariance[touch, touch]) < NOTHING
        self._doubtful = self._doubtful + self.dt if nothing else 0.0
        if self._doubtful >= self.settings.release or self._silent > self.settings.silence:
            self._believe(self.belief.pinned(touch))
            self._detector.forget()
            self._touching = False

    # --- what is told ---

    def deviation(self) -> Array:
        """Standard deviation of each node's place in [m]: root of the sum over three axes, shape (n,)."""
        derivatives = self._motion.of_all(self.model, self._linearised.reduced)
        covariance = self._acting_covariance
        variance = np.einsum("nap,pq,naq->n", derivatives, covariance, derivatives, optimize=True)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    @property
    def _acting_covariance(self) -> Array:
        return self.belief.covariance[: self.unknowns.acting, : self.unknowns.acting]

    def _estimate(self, used: int, left_out: tuple[str, ...]) -> Estimate:
        sentence = self._judge.sentence(self.belief)
        verdict: Verdict = "wrong" if sentence else "good"
        if self._silent > self.settings.silence or self._learned == 0.0:
            verdict, sentence = "alone", ""
        elif self._learned < self.settings.learning:
            verdict, sentence = "learning", ""
        rows = self._linearised.effector
        touch, part = None, self.unknowns.touch
        if self._touching:
            wrench = self.belief.mean[part]
            touch = Touch(wrench[:3].copy(), wrench[3:].copy(), self.belief.deviation[part])
        return Estimate(
            self.model.effector_pose, rows @ self._acting_covariance @ rows.T, touch, verdict, sentence,
            self._judge.consistency, used, left_out,
        )  # fmt: skip


class _Linearised(NamedTuple):
    """Derivatives by the unknowns: of the effector (6, p), of the sensors, of frames and joints (b, p)."""

    effector: Array
    sensors: dict[str, Array]
    reduced: Array


class _Seen(NamedTuple):
    """What was measured: innovation (m,), its derivatives (m, p), covariance of its noise (m, m)."""

    innovation: Array
    rows: Array
    noise: Array


def _by_name(sensors: Sequence[Sensor]) -> dict[str, Sensor]:
    """Sensors by their names.

    Raises:
        SceneError: two have one name.
    """
    named = {sensor.name: sensor for sensor in sensors}
    if len(named) < len(sensors):
        raise SceneError(f"two sensors have one name: {listing([sensor.name for sensor in sensors])}")
    return named
