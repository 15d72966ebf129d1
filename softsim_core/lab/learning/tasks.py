"""Tasks of environments: scene, actions, observations and rewards; and the shipped tasks with their ids."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from softsim_core.base import Array, BoolArray, IndexArray
from softsim_core.lab.learning.randomisation import Devices, round_to_steps
from softsim_core.physics.mechanics import rotation_of
from softsim_core.physics.sensing import inertial
from softsim_core.scene import RobotDescription, find_config, load_scene
from softsim_core.scene.io import laid_over
from softsim_core.simulation.batch import Batch

Numbers: TypeAlias = NDArray[Any]
"""Numbers of types other than float64, such as float32 and bool."""


class ObservationGroup(NamedTuple):
    """One group of numbers in an observation.

    Attributes:
        name: Name of the quantity.
        unit: Unit of the quantity.
        low, high: Interval of each number.
        size: Count of numbers.
        noise, step: Names of the fields of Devices with its noise and its resolution, or "".
    """

    name: str
    unit: str
    low: float
    high: float
    size: int = 1
    noise: str = ""
    step: str = ""


class Rating(NamedTuple):
    """Rewards (k,), failure flags (k,) and entries of `info` (k, ...) by name, of k copies."""

    reward: Array
    failed: BoolArray
    info: dict[str, Numbers]


class Senses(Protocol):
    """Sensor readings of k robots: a Moment of simulated robots, or the last messages of a real one."""

    @property
    def joint_positions(self) -> Array:
        """Joint positions in [rad] or [m], shape (k, j)."""

    @property
    def joint_efforts(self) -> Array:
        """Joint efforts in [N m] or [N], shape (k, j)."""

    @property
    def effector_position(self) -> Array:
        """Effector positions in [m], shape (k, 3)."""

    @property
    def effector_rotation(self) -> Array:
        """Rotation matrices of the effectors, shape (k, 3, 3)."""

    @property
    def effector_rate(self) -> Array:
        """Angular rate in the effector's axes in [rad/s], as of an IMU in its frame, shape (k, 3)."""

    @property
    def effector_force(self) -> Array:
        """Specific force in the effector's axes in [m/s^2], as of an IMU in its frame, shape (k, 3)."""

    @property
    def thing_position(self) -> Array:
        """Positions of the task's rigid body in [m], shape (k, 3)."""

    @property
    def commands(self) -> Array:
        """Last commands of the servos in [rad] or [m], shape (k, j)."""

    @property
    def goals(self) -> Array:
        """Goals of the episodes, shape (k, g)."""


@dataclass(frozen=True)
class Moment:
    """State of simulated robots as a task evaluates it.

    Attributes:
        batch: The batch of all copies.
        numbers: Indices of the evaluated copies, shape (k,).
        goals: Their goals, shape (k, g).
        commands: Last commands of their servos, shape (k, j).
        earlier: Velocity of the effector before the last step in [m/s], shape (k, 3).
        gravity: Gravity of each copy in [m/s^2], shape (k, 3).
        frame: Index of the effector among the free frames.
        thing: Index of the task's rigid body among those with mass; -1: the task has none.
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
        """Return part of the states of the evaluated copies; see Batch.array for the names."""
        return self.batch.array(name)[self.numbers]

    @property
    def joint_positions(self) -> Array:
        """Joint positions in [rad] or [m], shape (k, j)."""
        return self.array("joint_positions")

    @property
    def joint_efforts(self) -> Array:
        """Joint efforts in [N m] or [N], shape (k, j)."""
        return self.array("joint_efforts")

    @cached_property
    def effector_position(self) -> Array:
        """Effector positions in [m], shape (k, 3)."""
        return self.array("frame_positions")[:, self.frame]

    @cached_property
    def effector_rotation(self) -> Array:
        """Rotation matrices of the effectors, shape (k, 3, 3)."""
        return self.array("frame_rotations")[:, self.frame]

    @property
    def effector_rate(self) -> Array:
        """Angular rate in the effector's axes in [rad/s], as of an IMU in its frame, shape (k, 3)."""
        return self._inertial[1]

    @property
    def effector_force(self) -> Array:
        """Specific force in the effector's axes in [m/s^2] as of an IMU: mean over the last step, (k, 3)."""
        return self._inertial[0]

    @cached_property
    def _inertial(self) -> tuple[Array, Array]:
        velocity, spin = np.split(self.array("reduced_velocities")[:, 6 * self.frame :][:, :6], 2, axis=1)
        rotation, dt = self.effector_rotation, self.batch.dt
        return inertial(self.earlier, velocity, spin, rotation, self.gravity, dt)

    @cached_property
    def thing_position(self) -> Array:
        """Positions of the task's rigid body in [m], shape (k, 3)."""
        return self.array("rigid_positions")[:, self.thing]


@dataclass(frozen=True, kw_only=True)
class Task:
    """Scene, actions, observations and rewards of an environment; base class of all tasks.

    Attributes:
        robot: Name of the robot.
        overlay: Overrides of the robot's file.
        steps: Physics steps per action.
        horizon: Largest number of actions per episode.
        low, high: Commands that actions -1 and 1 stand for, in [rad] or [m], in joint order.
        devices: Noise, resolution and latency of servos and sensors.
        groups: Parts of an observation, in order.
        goal_size: Count of numbers in a goal.
        thing: Name of the rigid body of the task; empty: none.
        asks: Properties of Senses that its observations use, besides commands and goals.
        camera: Viewpoint of pictures: azimuth and elevation in [deg], middle in [m], width in [m].
    """

    robot: str
    overlay: Mapping[str, Any]
    steps: int
    horizon: int
    low: tuple[float, ...]
    high: tuple[float, ...]
    devices: Devices
    groups: tuple[ObservationGroup, ...]
    goal_size: int
    thing: str = ""
    asks: tuple[str, ...]
    camera: tuple[float, float, tuple[float, float, float], float]

    def description(self, overlay: Mapping[str, Any] | None = None) -> RobotDescription:
        """Return the robot with the task's overlay, then the given overlay applied."""
        return load_scene(self._file, laid_over(self.overlay, overlay or {}))

    @cached_property
    def _file(self) -> Path:
        return find_config(self.robot)

    def lead_in(self) -> list[tuple[tuple[float, ...], int]]:
        """Return the commands before an episode with their steps; they follow the robot's start move."""
        return []

    def goal(self, random: np.random.Generator) -> Array:
        """Draw the goal of an episode, shape (g,); empty where all episodes have the same."""
        return np.zeros(0)

    def begin(self, batch: Batch, number: int, random: np.random.Generator) -> None:
        """Place the objects of an episode after the lead-in."""

    def sense(self, senses: Senses) -> Array:
        """Return the noise-free readings in the order of `groups`, shape (k, m)."""
        raise NotImplementedError

    def observation(self, readings: Array) -> Numbers:
        """Clip readings (k, m) to the bounds and return them as float32: the policy's observation."""
        return np.clip(readings, *self.bounds()).astype(np.float32)

    def command(self, actions: Numbers, steps: Array | float) -> Array:
        """Return commands in [rad] or [m] for actions (k, j) in [-1, 1], rounded to `steps` if > 0."""
        low, high = np.array(self.low), np.array(self.high)
        clipped = np.clip(np.asarray(actions, dtype=float), -1.0, 1.0)
        return round_to_steps(0.5 * (high + low) + 0.5 * (high - low) * clipped, np.asarray(steps))

    def rate(self, moment: Moment) -> Rating:
        """Return rewards, failures and info of the copies in their present state."""
        raise NotImplementedError

    def bounds(self) -> tuple[Numbers, Numbers]:
        """Return lower and upper bounds of an observation's numbers, float32 arrays of shape (m,)."""
        sizes = [each.size for each in self.groups]
        low, high = (np.array([getattr(each, end) for each in self.groups]) for end in ("low", "high"))
        return np.repeat(low, sizes).astype(np.float32), np.repeat(high, sizes).astype(np.float32)

    def of_devices(self, devices: Devices, kind: str) -> Array:
        """Return noise or resolution (`kind`) of each number of an observation, shape (m,)."""
        values = [getattr(devices, name) if (name := getattr(each, kind)) else 0.0 for each in self.groups]
        return np.repeat(np.array(values, dtype=float), [each.size for each in self.groups])


def tilts(rotations: Array) -> Array:
    """Return the tilts about x and y in [rad] of rotations (k, 3, 3), shape (k, 2)."""
    axis = rotations[:, :, 2]
    return np.stack([np.arctan2(-axis[:, 1], axis[:, 2]), np.arctan2(axis[:, 0], axis[:, 2])], axis=1)


_DEGREE = math.radians(1.0)
_JOINTS = ObservationGroup("joint positions", "rad", -math.pi, math.pi, 3, "joint_noise", "joint_step")
_COMMANDS = ObservationGroup("commands of the action before", "rad", -math.pi, math.pi, 3)
_EFFECTOR = ObservationGroup("effector position", "m", -0.2, 0.2, 3, "position_noise")
_TILTS = ObservationGroup("effector tilts about x and y", "rad", -math.pi, math.pi, 2, "tilt_noise")

REACHED_M: Final = 0.002
"""Distance in [m] within which a goal counts as reached."""


@dataclass(frozen=True, kw_only=True)
class Reach(Task):
    """Move the Tripod's effector to a point and stay there.

    The reward of an action is minus the distance in [cm], plus 1 within REACHED_M.
    """

    def lead_in(self) -> list[tuple[tuple[float, ...], int]]:
        """Move to the pose `mid` and come to rest there."""
        return [((-1.0467,) * 3, 60)]

    def goal(self, random: np.random.Generator) -> Array:
        """Draw a point in [m] in a cylinder of 10 mm radius between heights of 34 and 52 mm."""
        radius, angle = 0.010 * math.sqrt(random.random()), random.uniform(0.0, 2.0 * math.pi)
        return np.array([radius * math.cos(angle), radius * math.sin(angle), random.uniform(0.034, 0.052)])

    def sense(self, senses: Senses) -> Array:
        """Return joint positions, effector position, tilts, last commands and goals, shape (k, 14)."""
        joints, effector = senses.joint_positions, senses.effector_position
        tilt = tilts(senses.effector_rotation)
        return np.concatenate([joints, effector, tilt, senses.commands, senses.goals], axis=1)

    def rate(self, moment: Moment) -> Rating:
        """Reward minus the distance to the goal in [cm], plus 1 within REACHED_M; no copy fails."""
        position = moment.effector_position
        distance = np.linalg.norm(position - moment.goals, axis=1)
        reached = distance < REACHED_M
        info = {
            "effector_position_m": position,
            "goal_m": moment.goals,
            "distance_m": distance,
            "is_success": reached,
        }
        return Rating(reached - 100.0 * distance, np.zeros(len(distance), dtype=np.bool_), info)


PLATE_M, BALL_M = 0.045, 0.008
"""Half the width of the plate, and the radius of the ball in [m]."""
_PLATE_TOP = 0.008  # height of the plate's upper side above the effector's frame in [m]


@dataclass(frozen=True, kw_only=True)
class Balance(Task):
    """Balance a ball in the middle of a plate on the Tripod's effector.

    The reward of an action is 1 minus the ball's distance from the middle over half the plate's width. An
    episode ends when the ball has left the plate.
    """

    def lead_in(self) -> list[tuple[tuple[float, ...], int]]:
        """Move to the pose `mid` while the ball comes to rest on the plate."""
        return [((-1.0467,) * 3, 80)]

    def begin(self, batch: Batch, number: int, random: np.random.Generator) -> None:
        """Place the ball at rest at a random point on the plate."""
        radius, angle = 0.5 * PLATE_M * math.sqrt(random.random()), random.uniform(0.0, 2.0 * math.pi)
        moved = np.array([radius * math.cos(angle), radius * math.sin(angle), 0.0])
        turn = rotation_of(batch.call(number, "effector_pose").quaternion_xyzw)
        position = batch.array("rigid_positions")[number, 0] + turn @ moved
        batch.call(number, "place_rigid_body", "ball", position, (0.0, 0.0, 0.0, 1.0))

    def _ball(self, senses: Senses) -> Array:
        """Return the ball's position in the plate's axes in [m], shape (k, 3)."""
        apart = senses.thing_position - senses.effector_position
        return np.asarray(np.einsum("kji,kj->ki", senses.effector_rotation, apart))

    def sense(self, senses: Senses) -> Array:
        """Return joints, tilts, angular rate, specific force, ball x and y, and commands, shape (k, 16)."""
        return np.concatenate(
            [
                senses.joint_positions,
                tilts(senses.effector_rotation),
                senses.effector_rate,
                senses.effector_force,
                self._ball(senses)[:, :2],
                senses.commands,
            ],
            axis=1,
        )

    def rate(self, moment: Moment) -> Rating:
        """Reward 1 minus the ball's distance over half the plate's width; fail once it left the plate."""
        ball = self._ball(moment)
        off = np.linalg.norm(ball[:, :2], axis=1)
        lost = (np.abs(ball[:, :2]) > PLATE_M).any(axis=1) | (ball[:, 2] < 0.0)
        info = {"ball_position_m": ball, "ball_distance_m": off, "is_success": off < 0.005}
        return Rating(np.where(lost, 0.0, 1.0 - off / PLATE_M), lost, info)


LIFTED_M = 0.020
"""Height in [m] above the floor at which the cube counts as lifted."""
_FLOOR = -0.16133


@dataclass(frozen=True, kw_only=True)
class Lift(Task):
    """Grasp the cube with the cable gripper and lift it.

    The reward of an action is the cube's height above the floor over LIFTED_M, at most 1, plus 0.1 times the
    nearness of the fingertips' middle to the cube, between 0 and 1.
    """

    def begin(self, batch: Batch, number: int, random: np.random.Generator) -> None:
        """Place the cube within 4 mm of its position in the scene, along x and along y."""
        x, y, z = batch.array("rigid_positions")[number, 0]
        dx, dy = random.uniform(-0.004, 0.004, 2)
        batch.call(number, "place_rigid_body", "cube", (x + dx, y + dy, z), (0.0, 0.0, 0.0, 1.0))

    def sense(self, senses: Senses) -> Array:
        """Return joint positions, cable tensions, cube position and last commands, shape (k, 16)."""
        joints, tensions = senses.joint_positions, senses.joint_efforts[:, :3]
        return np.concatenate([joints, tensions, senses.thing_position, senses.commands], axis=1)

    def rate(self, moment: Moment) -> Rating:
        """Reward the cube's height over LIFTED_M, at most 1, plus 0.1 times the nearness of the fingers.

        A copy fails when the cube is more than 10 mm below the floor.
        """
        cube, joints = moment.thing_position, moment.joint_positions
        height = cube[:, 2] - 0.020 - _FLOOR
        lowered = np.clip(joints[:, 3] / -0.050, 0.0, 1.0)
        info = {
            "cube_position_m": cube,
            "cube_height_m": height,
            "tensions_n": moment.joint_efforts[:, :3],
            "is_success": height > LIFTED_M,
        }
        near = np.where(height > 0.002, 1.0, lowered)
        lost = height < -0.010
        return Rating(np.clip(height / LIFTED_M, 0.0, 1.0) + 0.1 * near, lost, info)


_SERVOS = Devices(
    command_step=_DEGREE,
    command_noise=0.2 * _DEGREE,
    command_latency=0.04,
    joint_step=0.3 * _DEGREE,
    position_noise=0.0003,
    tilt_noise=0.3 * _DEGREE,
    rate_noise=0.01,
    force_noise=0.05,
)
"""Hobby servos on a byte protocol, a marker camera, an IMU."""

TASKS: Mapping[str, Task] = {
    "TripodReach-v0": Reach(
        robot="tripod",
        overlay={},
        steps=4,
        horizon=50,
        low=(-1.6,) * 3,
        high=(-0.4,) * 3,
        devices=_SERVOS,
        groups=(
            _JOINTS,
            _EFFECTOR,
            _TILTS,
            _COMMANDS,
            ObservationGroup("goal of the effector", "m", -0.2, 0.2, 3),
        ),
        goal_size=3,
        asks=("joint_positions", "effector_position", "effector_rotation"),
        camera=(-60.0, 25.0, (0.0, 0.0, 0.025), 0.15),
    ),
    "TripodBalance-v0": Balance(
        robot="tripod",
        overlay={
            "rigid_bodies": [
                {
                    "name": "plate",
                    "shape": {"box": [2.0 * PLATE_M, 2.0 * PLATE_M, 0.003]},
                    "on": "centre",
                    "pose": {"translation": [0.0, 0.0, _PLATE_TOP - 0.0015]},
                    "colour": [0.3, 0.5, 0.9, 1.0],
                },
                {
                    "name": "ball",
                    "shape": {"sphere": BALL_M},
                    "mass": 0.005,
                    "pose": {"translation": [0.0, 0.0, 0.030 + _PLATE_TOP + BALL_M + 0.0006]},
                    "colour": [0.9, 0.2, 0.1, 1.0],
                },
            ],
            "collisions": [{"name": "plate", "body": "plate"}, {"name": "ball", "body": "ball"}],
            "contact": {"alarm_distance": 0.004, "contact_distance": 0.0005, "friction": 0.3},
        },
        steps=2,
        horizon=200,
        low=(-1.4,) * 3,
        high=(-0.7,) * 3,
        devices=_SERVOS,
        groups=(
            _JOINTS,
            _TILTS,
            ObservationGroup("angular rate of the effector", "rad/s", -100.0, 100.0, 3, "rate_noise"),
            ObservationGroup("specific force of the effector", "m/s^2", -1000.0, 1000.0, 3, "force_noise"),
            ObservationGroup("ball on the plate, x and y", "m", -1.0, 1.0, 2, "position_noise"),
            _COMMANDS,
        ),
        goal_size=0,
        thing="ball",
        asks=(
            "joint_positions",
            "effector_position",
            "effector_rotation",
            "effector_rate",
            "effector_force",
            "thing_position",
        ),
        camera=(-60.0, 25.0, (0.0, 0.0, 0.035), 0.15),
    ),
    "CableGripperLift-v0": Lift(
        robot="cable_gripper",
        overlay={},
        steps=5,
        horizon=100,
        low=(0.0, 0.0, 0.0, -0.052, -0.010),
        high=(0.020, 0.020, 0.020, 0.0, 0.010),
        devices=Devices(
            command_step=1e-4,
            command_latency=0.05,
            joint_noise=1e-4,
            position_noise=0.0005,
            effort_noise=0.1,
        ),
        groups=(
            ObservationGroup("joint positions", "m", -0.2, 0.2, 5, "joint_noise"),
            ObservationGroup("cable tensions", "N", -100.0, 100.0, 3, "effort_noise"),
            ObservationGroup("cube position", "m", -5.0, 5.0, 3, "position_noise"),
            ObservationGroup("commands of the action before", "m", -0.2, 0.2, 5),
        ),
        goal_size=0,
        thing="cube",
        asks=("joint_positions", "joint_efforts", "thing_position"),
        camera=(-70.0, 10.0, (0.01, 0.0, -0.09), 0.22),
    ),
}
"""Tasks by name; docs/learning.md lists their spaces."""


_HOME: Final = "softsim_core.lab.learning.environments"


def register_environments() -> None:
    """Register the environments of the shipped tasks with Gymnasium, which must be installed."""
    import gymnasium

    for name, task in TASKS.items():
        if f"softsim/{name}" not in gymnasium.registry:
            gymnasium.register(
                id=f"softsim/{name}",
                entry_point=f"{_HOME}:RobotEnv",
                vector_entry_point=f"{_HOME}:RobotVectorEnv",
                kwargs={"name": name},
                max_episode_steps=task.horizon,
            )
