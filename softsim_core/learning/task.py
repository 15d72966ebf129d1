"""What an environment is about: a scene, what is commanded, what is sensed, and what is wanted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.batch import Batch
from softsim_core.learning.devices import Devices, rounded
from softsim_core.scene import find_config, load_scene
from softsim_core.scene.overrides import laid_over
from softsim_core.scene.robot import RobotDescription
from softsim_core.sensing.imu import inertial

Numbers: TypeAlias = NDArray[Any]
"""Numbers of other types than float64, such as float32 and bool."""


class Sensed(NamedTuple):
    """A part of an observation.

    Attributes:
        name: What it is.
        unit: Its unit.
        low, high: Its interval, of each number.
        size: How many numbers.
        noise, step: Fields of Devices, or "".
    """

    name: str
    unit: str
    low: float
    high: float
    size: int = 1
    noise: str = ""
    step: str = ""


class Judged(NamedTuple):
    """Of k copies: rewards (k,), whether each has failed (k,), and what `info` tells, (k, ...) by name."""

    reward: Array
    failed: BoolArray
    info: dict[str, Numbers]


class Senses(Protocol):
    """What sensors tell of k robots: of simulated ones a Moment, of a real one what its topics said."""

    @property
    def joint_positions(self) -> Array:
        """In [rad] or [m], shape (k, j)."""

    @property
    def joint_efforts(self) -> Array:
        """In [N m] or [N], shape (k, j)."""

    @property
    def effector_position(self) -> Array:
        """In [m], shape (k, 3)."""

    @property
    def effector_rotation(self) -> Array:
        """Rotation matrices, shape (k, 3, 3)."""

    @property
    def effector_rate(self) -> Array:
        """Angular rate in the effector's axes in [rad/s], as of an IMU in its frame, shape (k, 3)."""

    @property
    def effector_force(self) -> Array:
        """Specific force in the effector's axes in [m/s^2], as of an IMU in its frame, shape (k, 3)."""

    @property
    def thing_position(self) -> Array:
        """Of the task's rigid body in [m], shape (k, 3)."""

    @property
    def commands(self) -> Array:
        """What the servos were told last in [rad] or [m], shape (k, j)."""

    @property
    def goals(self) -> Array:
        """What is wanted, shape (k, g)."""


@dataclass(frozen=True)
class Moment:
    """Simulated robots as a task looks at them.

    Attributes:
        batch: All copies.
        numbers: Which ones, shape (k,).
        goals: Their goals, shape (k, g).
        commands: What their servos were told last, shape (k, j).
        earlier: Velocity of the effector before the last step in [m/s], shape (k, 3).
        gravity: Gravity of each copy in [m/s^2], shape (k, 3).
        frame: Place of the effector among the free frames.
        thing: Place of the task's rigid body among those with mass; -1: the task is about none.
    """

    batch: Batch
    numbers: IndexArray
    goals: Array
    commands: Array
    earlier: Array
    gravity: Array
    frame: int
    thing: int

    def array(self, name: str) -> Array:
        """Part of the states; see Batch.array."""
        return self.batch.array(name)[self.numbers]

    @property
    def joint_positions(self) -> Array:
        """See Senses."""
        return self.array("joint_positions")

    @property
    def joint_efforts(self) -> Array:
        """See Senses."""
        return self.array("joint_efforts")

    @cached_property
    def effector_position(self) -> Array:
        """See Senses."""
        return self.array("frame_positions")[:, self.frame]

    @cached_property
    def effector_rotation(self) -> Array:
        """See Senses."""
        return self.array("frame_rotations")[:, self.frame]

    @property
    def effector_rate(self) -> Array:
        """See Senses."""
        return self._inertial[1]

    @property
    def effector_force(self) -> Array:
        """See Senses; as an IMU measures it, the mean over the last step."""
        return self._inertial[0]

    @cached_property
    def _inertial(self) -> tuple[Array, Array]:
        velocity, spin = np.split(self.array("reduced_velocities")[:, 6 * self.frame :][:, :6], 2, axis=1)
        rotation, dt = self.effector_rotation, self.batch.dt
        return inertial(self.earlier, velocity, spin, rotation, self.gravity, dt)

    @cached_property
    def thing_position(self) -> Array:
        """See Senses."""
        return self.array("rigid_positions")[:, self.thing]


@dataclass(frozen=True, kw_only=True)
class Task:
    """See the module; kinds of tasks derive from it.

    Attributes:
        robot: The robot's name.
        overlay: Laid over it.
        steps: Physics steps of an action.
        horizon: Actions of an episode at most.
        low, high: Commands that actions -1 and 1 stand for, in [rad] or [m], in joint order.
        devices: Servos and sensors.
        sensed: The parts of an observation, in order.
        goal_size: Numbers of a goal.
        thing: Name of the rigid body that the task is about; empty: none.
        asks: What of Senses its observations are made of, besides commands and goals.
        camera: From where it is drawn: azimuth and elevation in [deg], middle in [m], width in [m].
    """

    robot: str
    overlay: Mapping[str, Any]
    steps: int
    horizon: int
    low: tuple[float, ...]
    high: tuple[float, ...]
    devices: Devices
    sensed: tuple[Sensed, ...]
    goal_size: int
    thing: str = ""
    asks: tuple[str, ...]
    camera: tuple[float, float, tuple[float, float, float], float]

    def description(self, overlay: Mapping[str, Any] | None = None) -> RobotDescription:
        """The robot, with an overlay on top of the task's own."""
        return load_scene(self._file, laid_over(self.overlay, overlay or {}))

    @cached_property
    def _file(self) -> Path:
        return find_config(self.robot)

    def lead_in(self) -> list[tuple[tuple[float, ...], int]]:
        """Commands before an episode, each with its steps; they begin where the robot's start move ends."""
        return []

    def goal(self, random: np.random.Generator) -> Array:
        """What is wanted in an episode, shape (g,)."""
        raise NotImplementedError

    def begin(self, batch: Batch, number: int, random: np.random.Generator) -> None:
        """Place what an episode begins with, after the lead-in."""

    def sense(self, senses: Senses) -> Array:
        """What perfect sensors tell, in the order of `sensed`, shape (k, m)."""
        raise NotImplementedError

    def observation(self, sensed: Array) -> Numbers:
        """What was sensed, (k, m), as a policy gets it: within the bounds, float32."""
        return np.clip(sensed, *self.bounds()).astype(np.float32)

    def command(self, actions: Numbers, steps: Array | float) -> Array:
        """Where the servos go in [rad] or [m] for actions (k, j) in [-1, 1], in whole `steps` where > 0."""
        low, high = np.array(self.low), np.array(self.high)
        clipped = np.clip(np.asarray(actions, dtype=float), -1.0, 1.0)
        return rounded(0.5 * (high + low) + 0.5 * (high - low) * clipped, np.asarray(steps))

    def judge(self, moment: Moment) -> Judged:
        """How good the state is."""
        raise NotImplementedError

    def bounds(self) -> tuple[Numbers, Numbers]:
        """Interval of each number of an observation, shapes (m,), float32."""
        sizes = [each.size for each in self.sensed]
        low = np.repeat([each.low for each in self.sensed], sizes)
        return low.astype(np.float32), np.repeat([each.high for each in self.sensed], sizes).astype(
            np.float32
        )

    def of_devices(self, devices: Devices, kind: str) -> Array:
        """Noise or step of each number of an observation, shape (m,)."""
        values = [getattr(devices, name) if (name := getattr(each, kind)) else 0.0 for each in self.sensed]
        return np.repeat(np.array(values, dtype=float), [each.size for each in self.sensed])


def tilts(rotations: Array) -> Array:
    """Rotations (k, 3, 3) as tilts about x and y in [rad], shape (k, 2)."""
    axis = rotations[:, :, 2]
    return np.stack([np.arctan2(-axis[:, 1], axis[:, 2]), np.arctan2(axis[:, 0], axis[:, 2])], axis=1)
