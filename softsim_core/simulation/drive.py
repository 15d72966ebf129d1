"""Drive of the joints, movable bases, and setters of velocities and positions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from softsim_core.base import Array, CommandError, SceneError, known_names
from softsim_core.physics.actuation import factor_at, is_over
from softsim_core.physics.mechanics import Model, State, check_command, cross, rotation_of
from softsim_core.scene import RobotDescription
from softsim_core.scene.building import Body

ROUNDED: Final = 1e-3
"""Allowed deviation of a quaternion's length from 1: quaternions in messages often have few digits."""


def check_values(what: str, values: ArrayLike, shape: tuple[int, ...], unit: str) -> Array:
    """Return the values as a new float64 array of a shape.

    Raises:
        CommandError: not numbers, another shape, or not finite.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise CommandError(f"{what} must be numbers in {unit}, shape {shape}; nothing was changed") from None
    if array.shape != shape:
        raise CommandError(
            f"{what} of shape {array.shape} refused: expected shape {shape} in {unit}; nothing was changed"
        )
    if not np.isfinite(array).all():
        worst = np.argwhere(~np.isfinite(array))[0].tolist()
        raise CommandError(
            f"{what} refused: the value at {worst} is not finite; expected numbers in {unit}; "
            "nothing was changed"
        )
    return array


def rotation_from(quaternion_xyzw: ArrayLike) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion whose length is 1 within ROUNDED.

    Raises:
        CommandError: it is none.
    """
    quaternion = check_values("quaternion", quaternion_xyzw, (4,), "x, y, z, w")
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > ROUNDED:
        raise CommandError(f"quaternion of length {length:g} refused: expected 1; nothing was changed")
    return rotation_of(quaternion / length)


def set_node_velocities(model: Model, state: State, velocities: Array) -> None:
    """Set velocities (n, 3) in [m/s] of the free nodes; those of fixed or driven nodes are not changed."""
    free = model.free_nodes
    state.velocities[free] = velocities[free]


def set_body_motion(model: Model, state: State, body: Body, velocity: Array, angular_velocity: Array) -> None:
    """Set the velocities of a rigid motion on a body and its frames; see Simulation.set_body_velocity."""
    nodes = np.arange(body.nodes.start, body.nodes.stop)
    mass, points = model.mass[nodes], state.positions[nodes]
    centre = mass @ points / mass.sum()
    moved = np.zeros_like(state.velocities)
    moved[nodes] = velocity + cross(angular_velocity, points - centre)
    own = model.free_nodes[np.isin(model.free_nodes, nodes)]
    state.velocities[own] = moved[own]
    for region in model.regions:
        if region.frame < 0 or not len(region.nodes) or region.nodes[0] not in nodes:
            continue
        arm = state.frame_positions[region.frame] - centre
        state.reduced_velocities[6 * region.frame :][:3] = velocity + cross(angular_velocity, arm)
        state.reduced_velocities[6 * region.frame + 3 :][:3] = angular_velocity
    model.place_regions(state)


def number_of(kind: str, name: str, names: Sequence[str]) -> int:
    """Return the index of a name.

    Raises:
        CommandError: it is not among the names.
    """
    if name not in names:
        raise CommandError(f"unknown {kind} {name!r}; {known_names(name, names)}")
    return list(names).index(name)


SPEED: Final = 0.05
"""Speed of moving bases in [m/s], low enough for the body to follow without impact."""


class MovableBases:
    """Targets of the joint bases; their present positions are in State.base_positions.

    Attributes:
        targets: Target of each base in [m], shape (j, 3): with parents at rest, without the start move's
            shift.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._start = model.rest_state().base_positions.copy()
        self.targets = self._start.copy()
        self._arrived = True

    def move(self, name: str, position: Sequence[float] | Array, base_shift: float) -> None:
        """Set the target (3,) in [m] of a joint's base, which the start move has shifted by `base_shift` [m].

        Raises:
            CommandError: no such joint, one without a frame, or a position that is not three finite numbers;
            nothing is changed.
        """
        joints = self._model.joints
        indices = {joint.name: j for j, joint in enumerate(joints) if joint.moves_frame}
        if name not in indices:
            raise CommandError(f"no joint {name!r} has a base; {known_names(name, indices)}")
        target = np.array(position, dtype=float)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise CommandError(f"base of {name} refused: expected three finite numbers in metres")
        j = indices[name]
        base = self._start[j]
        self.targets[j] = target + base - joints[j].base_origin(base, base_shift)
        self._arrived = False

    def advance(self, state: State, dt: float) -> bool:
        """Move the bases of a state and the parts they carry for `dt` [s]; return whether any moved."""
        if self._arrived:
            return False
        way = self.targets - state.base_positions
        length = np.linalg.norm(way, axis=1)
        moving = np.flatnonzero(length > 0.0).tolist()
        for j in moving:
            if length[j] <= SPEED * dt:
                state.base_positions[j] = self.targets[j]
            else:
                state.base_positions[j] += SPEED * dt / length[j] * way[j]
        self._arrived = not moving
        if moving:
            self._model.place_regions(state)
        return bool(moving)

    def reset(self) -> None:
        """Set the targets to the bases' positions in the scene."""
        self.restore(self._start)

    def restore(self, targets: Array) -> None:
        """Set other targets (j, 3)."""
        self.targets, self._arrived = targets.copy(), False


_IDLE = -1.0


class JointDrive:
    """Commands, limits and the start animation of a robot's joints.

    Attributes:
        targets: The last accepted command in [rad] or [m], shape (j,).
        positions: Present setpoints on the way to the targets, shape (j,).
        base_shift: Shift in [m] of the joint bases along their slide axes.
        enforce_limits: Whether position and speed limits are enforced.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._rest = np.array([joint.rest for joint in robot.joints], dtype=float)
        self._speed = np.array([joint.limits.speed for joint in robot.joints], dtype=float)
        self.enforce_limits = robot.commands.enforce_limits
        self.reset()

    def reset(self) -> None:
        """Return to the rest positions; the start animation restarts if the scene says so."""
        self.targets: Array = self._rest.copy()
        self.positions: Array = self._rest.copy()
        self.base_shift = 0.0
        self._started, self._animates_joints = _IDLE, True
        if self._robot.start is not None and self._robot.start.at_start:
            self._started = 0.0

    def command(self, values: Sequence[float]) -> None:
        """Set the joint targets; a running start animation then moves only the bases, to their end.

        Raises:
            CommandError: wrong length, not finite, or out of range in a scene that refuses; nothing changes.
        """
        accepted = check_command(values, self._robot.joint_names)
        if self.enforce_limits:
            for index, joint in enumerate(self._robot.joints):
                refuses = self._robot.commands.out_of_range == "refuse"
                if refuses and not joint.limits.allows(accepted[index]):
                    raise CommandError(
                        f"command {accepted[index]} for joint {joint.name} refused: allowed is "
                        f"[{joint.limits.lower}, {joint.limits.upper}]; nothing was moved"
                    )
                accepted[index] = joint.limits.clamp(accepted[index])
        self.targets = np.array(accepted, dtype=float)
        self._animates_joints = False

    def start(self, time: float) -> None:
        """Start the robot's start animation at `time` [s], from the rest pose, whatever the present pose is.

        Raises:
            SceneError: the scene has none.
        """
        if self._robot.start is None:
            raise SceneError(f"scene {self._robot.name} has no start animation (key `start` of its file)")
        self._started, self._animates_joints = time, True

    def advance(self, time: float, dt: float) -> None:
        """Advance `positions` by the step of `dt` that begins at `time`, both in [s].

        The start animation is absolute and is not slowed by the speed limits.
        """
        start = self._robot.start
        if start is not None and self._started != _IDLE:
            elapsed = time - self._started
            factor = factor_at(elapsed, start.duration)
            self.base_shift = factor * start.base_shift
            if is_over(elapsed, start.duration):
                self._started = _IDLE
            if self._animates_joints:
                pose = np.array(self._robot.poses[start.pose])
                self.targets = self._rest + factor * (pose - self._rest)
                self.positions = self.targets.copy()
                return
        if self.enforce_limits:
            reach = self._speed * dt
            nearest = np.minimum(self.targets, self.positions + reach)
            self.positions = np.maximum(nearest, self.positions - reach)
        else:
            self.positions = self.targets.copy()

    def shift_bases(self, shift: float) -> None:
        """Place the joint bases `shift` [m] along their slide axes.

        Raises:
            CommandError: not a finite number.
        """
        if not math.isfinite(shift):
            raise CommandError(f"base_shift {shift} refused: expected a finite number of metres")
        self.base_shift = float(shift)

    def place(self, positions: Array, base_shift: float) -> None:
        """Set joint positions (j,) and base shift in [m] at once; a running start animation ends."""
        self.targets, self.positions = positions.copy(), positions.copy()
        self.base_shift = base_shift
        self._started = _IDLE

    def arrays(self) -> dict[str, Array]:
        """Return everything that a snapshot needs, by name."""
        return {
            "targets": self.targets,
            "positions": self.positions,
            "started": np.array([self._started]),
            "base_shift": np.array([self.base_shift]),
            "enforce_limits": np.array([float(self.enforce_limits)]),
            "animates_joints": np.array([float(self._animates_joints)]),
        }

    def take(self, arrays: Mapping[str, Array]) -> None:
        """Restore the result of `arrays`."""
        self.targets, self.positions = arrays["targets"].copy(), arrays["positions"].copy()
        self._started, self.base_shift = float(arrays["started"][0]), float(arrays["base_shift"][0])
        self.enforce_limits = bool(arrays["enforce_limits"][0])
        self._animates_joints = bool(arrays["animates_joints"][0])
