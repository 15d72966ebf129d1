"""Episodes of a task in all copies of a batch: actions to commands, states to observations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from softsim_core.base import Array, BoolArray, CommandError, IndexArray, SceneError, float_array, listing
from softsim_core.lab.learning.randomisation import Delay, Devices, Randomisation, round_to_steps
from softsim_core.lab.learning.tasks import Moment, Numbers, Task
from softsim_core.scene import SceneDescription
from softsim_core.simulation.batch import Batch


class Outcome(NamedTuple):
    """Result of an action in k copies: rewards (k,), ends (k,), and entries of `info`, (k, ...) by name."""

    reward: Array
    terminated: BoolArray
    truncated: BoolArray
    info: dict[str, Numbers]


_SAVED = (
    "generators", "_noise", "_steps", "_command_noise", "_command_step", "_commanding", "_sensing", "_goals",
    "_commands", "_wanted", "_earlier", "_gravity", "_actions", "_late", "_parameters", "_overlays",
)  # fmt: skip
"""Attributes in a saved state besides those of the copies."""


class Episodes:
    """Episodes of a task in all copies of a batch.

    Each copy draws from its own random generator, so its episodes do not depend on the others.

    Args:
        task: The task.
        copies, workers: See Batch.
        devices: Servos and sensors; None: the task's.
        randomisation: Variations between episodes; None: none.
        full_state: Whether observations are the whole state, without noise, instead of sensor readings.

    Attributes:
        batch: The copies.
        span: Time of an action in [s].
        horizon: Number of actions after which episodes are truncated; at first the task's.
        generators: Random generator of each copy; replace them to set new seeds.
    """

    def __init__(
        self,
        task: Task,
        copies: int,
        workers: int = 1,
        devices: Devices | None = None,
        randomisation: Randomisation | None = None,
        full_state: bool = False,
    ) -> None:
        self.task, self._randomisation, self._full = task, randomisation, full_state
        self.horizon = task.horizon
        robot = task.description()
        start = robot.start
        self._start_steps = 0 if start is None else math.ceil(start.duration / robot.scene.dt) + 1
        free = [each.name for each in robot.scene.rigid_bodies if each.mass is not None]
        self._thing = free.index(task.thing) if task.thing else -1
        self._frame = _effector_frame(robot.scene, task)
        self.batch = Batch(robot, copies, workers)
        self.generators = [np.random.default_rng(number) for number in range(copies)]
        self._devices = devices or task.devices
        self.span = task.steps * self.batch.dt
        joints = len(task.low)
        sizes = sum(each.size for each in task.groups)
        self._noise, self._steps = np.zeros((copies, sizes)), np.zeros((copies, sizes))
        self._command_noise, self._command_step = np.zeros((copies, 1)), np.zeros((copies, 1))
        self._commanding, self._sensing = Delay(copies, joints), Delay(copies, sizes)
        self._goals, self._commands = np.zeros((copies, task.goal_size)), np.zeros((copies, joints))
        self._wanted, self._earlier = self._commands.copy(), np.zeros((copies, 3))
        self._gravity = np.tile(np.array(robot.scene.gravity, dtype=float), (copies, 1))
        self._actions = np.zeros(copies, dtype=np.int64)
        self._late = np.zeros((copies, 2), dtype=np.int64)
        self._parameters: list[dict[str, float]] = [{} for _ in range(copies)]
        self._overlays: list[dict[str, Any]] = [{} for _ in range(copies)]
        self._home: bytes | None = None
        for number in range(copies):
            self._equip(number, self._devices)

    def bounds(self) -> tuple[Numbers, Numbers]:
        """Return lower and upper bounds of an observation's numbers, float32 arrays of shape (m,)."""
        if not self._full:
            return self.task.bounds()
        limit = np.full(self.batch.states.shape[1], np.inf, dtype=np.float32)
        return -limit, limit

    def begin(self, numbers: IndexArray) -> Numbers:
        """Start an episode in chosen copies; return their observations, shape (k, m)."""
        for number in numbers.tolist():
            random = self.generators[number]
            if self._randomisation is None:
                self._go_home(number)
            else:
                overlay, devices, self._parameters[number] = self._randomisation.draw(random)
                self._overlays[number] = overlay
                if overlay:
                    changed = self.task.description(overlay)
                    self.batch.rebuild(number, changed)
                    self._gravity[number] = changed.scene.gravity
                    self._lead_in(number)
                else:
                    self._go_home(number)
                self._equip(number, self._devices.with_values(devices))
            self._goals[number] = self.task.goal(random)
            self.task.begin(self.batch, number, random)
        targets = np.array([self.batch.call(number, "joint_targets") for number in numbers.tolist()])
        self._actions[numbers] = 0
        self._wanted[numbers] = self._commands[numbers] = targets.reshape(len(numbers), -1)
        self._earlier[numbers] = self._velocities(numbers)
        readings = self.task.sense(self._moment(numbers))
        for number, row in zip(numbers.tolist(), readings, strict=True):
            self._commanding.begin(number, self._late[number][0], self._commands[number])
            self._sensing.begin(number, self._late[number][1], row)
        return self._observe_copies(numbers)

    def act(self, numbers: IndexArray, actions: Numbers) -> tuple[Numbers, Outcome]:
        """Perform actions (k, j) in [-1, 1]; return the observations (k, m) and the results.

        Raises:
            ArrayError, CommandError: see `check_actions`; nothing was moved.
        """
        self.check_actions(numbers, actions)
        task, joints = self.task, len(self.task.low)
        self._wanted[numbers] = task.command(actions, self._command_step[numbers])
        commands = self._commanding.through(numbers, self._wanted[numbers])
        if self._command_noise[numbers].any():
            commands = commands + self._command_noise[numbers] * self._draw_noise(numbers, joints)
        self.batch.command(commands, numbers)
        last = int("effector_force" in task.asks)  # an accelerometer measures over the last step
        self.batch.step(task.steps - last, numbers)
        self._earlier[numbers] = self._velocities(numbers)
        self.batch.step(last, numbers)
        self._commands[numbers] = self._wanted[numbers]
        self._actions[numbers] += 1
        rated = task.rate(self._moment(numbers))
        diverged = np.array([number in self.batch.failed for number in numbers.tolist()], dtype=np.bool_)
        info = {**rated.info, "time_s": self.span * self._actions[numbers], "diverged": diverged}
        ended = rated.failed | diverged
        truncated = (self._actions[numbers] >= self.horizon) & ~ended
        return self._observe_copies(numbers), Outcome(rated.reward, ended, truncated, info)

    def check_actions(self, numbers: IndexArray, actions: Numbers) -> None:
        """Reject invalid actions of chosen copies at once, even if latency would delay them.

        Raises:
            ArrayError: they are not (k, j) numbers.
            CommandError: one is not finite.
        """
        finite = np.isfinite(float_array(actions, (len(numbers), len(self.task.low)), "actions"))
        if not finite.all():
            bad = numbers[~finite.all(axis=1)].tolist()
            raise CommandError(f"actions of robots {bad} refused: one is not finite; nothing was moved")

    def describe_start(self, numbers: IndexArray) -> dict[str, Numbers]:
        """Return the entries of `info` at the start of an episode."""
        return {**self.task.rate(self._moment(numbers)).info, "time_s": np.zeros(len(numbers))}

    def parameters(self, number: int) -> Mapping[str, float]:
        """Return the parameters drawn for the episode of a copy, by name."""
        return self._parameters[number]

    def save_state(self) -> dict[str, Any]:
        """Return the state of all episodes, for `restore` of episodes with the same constructor arguments."""
        copies = range(len(self.generators))
        states = [self.batch.call(number, "snapshot") for number in copies]
        return {"states": states, **{name: getattr(self, name) for name in _SAVED}}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Restore a result of `save_state`."""
        for name in _SAVED:
            setattr(self, name, saved[name])
        for number, state in enumerate(saved["states"]):
            if self._overlays[number]:
                self.batch.rebuild(number, self.task.description(self._overlays[number]))
            self.batch.restore(state, [number])

    def close(self) -> None:
        """End the worker processes."""
        self.batch.close()

    def _go_home(self, number: int) -> None:
        """Move a copy to the state at which episodes begin: simulated once, then restored from a snapshot."""
        if self._home is None:
            self.batch.reset([number])
            self._lead_in(number)
            self._home = self.batch.call(number, "snapshot")
        else:
            self.batch.restore(self._home, [number])

    def _lead_in(self, number: int) -> None:
        """Run the start move, after which the robot is as mounted, and the task's lead-in commands."""
        if self._start_steps:
            self.batch.call(number, "start_animation")
            self.batch.step(self._start_steps, [number])
        for command, steps in self.task.lead_in():
            self.batch.command([command], [number])
            self.batch.step(steps, [number])

    def _equip(self, number: int, devices: Devices) -> None:
        """Set the devices of a copy."""
        task = self.task
        self._noise[number] = task.of_devices(devices, "noise")
        self._steps[number] = task.of_devices(devices, "step")
        self._command_noise[number], self._command_step[number] = devices.command_noise, devices.command_step
        late = devices.command_latency, devices.sensor_latency
        self._late[number] = [round(each / self.span) for each in late]

    def _velocities(self, numbers: IndexArray) -> Array:
        """Return the velocity of the effector in [m/s], zeros without one, shape (k, 3)."""
        if self._frame < 0:
            return np.zeros((len(numbers), 3))
        return self.batch.array("reduced_velocities")[numbers, 6 * self._frame :][:, :3]

    def _moment(self, numbers: IndexArray) -> Moment:
        return Moment(
            self.batch,
            numbers,
            self._goals[numbers],
            self._commands[numbers],
            self._earlier[numbers],
            self._gravity[numbers],
            self._frame,
            self._thing,
        )

    def _draw_noise(self, numbers: IndexArray, count: int) -> Array:
        """Draw standard normal numbers from each copy's own generator, shape (k, count)."""
        return np.array([self.generators[number].standard_normal(count) for number in numbers.tolist()])

    def _observe_copies(self, numbers: IndexArray) -> Numbers:
        if self._full:
            return self.batch.states[numbers].astype(np.float32)
        readings, noise = self.task.sense(self._moment(numbers)), self._noise[numbers]
        if noise.any():
            readings = readings + noise * self._draw_noise(numbers, readings.shape[1])
        readings = self._sensing.through(numbers, round_to_steps(readings, self._steps[numbers]))
        return self.task.observation(readings)


def _effector_frame(scene: SceneDescription, task: Task) -> int:
    """Return the index of the effector among the free frames; -1: there is none, and the task uses none."""
    if scene.effector is None:
        if requested := [name for name in task.asks if name.startswith("effector")]:
            raise SceneError(
                f"the task asks for {listing(requested)}, and {scene.name} has no effector: "
                "add `effector: NAME` of a free attachment to its file"
            )
        return -1
    return [each.name for each in scene.attachments if each.to == "free"].index(scene.effector)
