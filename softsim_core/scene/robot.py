"""Description of a robot besides physics: poses, commands, keys, board, inverse control, view; SI."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from softsim_core.base import Array, FieldError, SceneError, known_names, need_finite, one_of
from softsim_core.physics.mechanics import Pose
from softsim_core.scene.board import BoardDescription
from softsim_core.scene.control import (
    KEY_NAMES,
    CommandSettings,
    InverseSettings,
    KeyBinding,
    StartAnimation,
)
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.file_keys import ABSENT, BESIDE
from softsim_core.scene.joint import JointDescription
from softsim_core.scene.view import ViewSettings


class RunningSimulation(Protocol):
    """The part of a simulation that controllers and animations of a scene use.

    Attributes:
        forces: External forces on the nodes in [N], shape (n, 3); writable by the scene's code.
        base_shift: Shift in [m] of all joint bases along their slide axes.
    """

    forces: Array
    base_shift: float

    @property
    def time(self) -> float:
        """Simulated time in [s]."""
        ...

    @property
    def dt(self) -> float:
        """Time step in [s]."""
        ...

    @property
    def step_count(self) -> int:
        """Steps since the start."""
        ...

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in command order."""
        ...

    @property
    def joint_positions(self) -> Array:
        """Measured joint positions in [rad] or [m], shape (j,)."""
        ...

    @property
    def joint_targets(self) -> Array:
        """The last accepted command in [rad] or [m], shape (j,)."""
        ...

    @property
    def effector_pose(self) -> Pose | None:
        """Pose of the end effector, or None in a scene without one."""
        ...

    def command(self, values: Sequence[float] | Array) -> Array:
        """Set the joint targets; return the accepted command in [rad] or [m], shape (j,)."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller:
    """A user's own code in the loop; each hook is optional and gets the running simulation.

    Attributes:
        on_begin: Called before every step.
        on_end: Called after every step.
        on_key: Called with the name of a pressed key ("up", "a"), after the scene's own bindings.
    """

    on_begin: Callable[[RunningSimulation], None] | None = None
    on_end: Callable[[RunningSimulation], None] | None = None
    on_key: Callable[[RunningSimulation, str], None] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotDescription:
    """A scene with control, wiring and view of its robot; in a file, all keys are on the same level.

    Attributes:
        scene: The physics.
        poses: Named joint positions in [rad] or [m], one number per joint.
        commands: Handling of commands.
        start: The start move; None: there is none.
        keys: Actions of keyboard keys, by key name.
        board: The serial board of the servos; None: there is none.
        inverse: Inverse control.
        view: Initial view of a page.
        controllers: Users' own code in the loop; from Python files only.
        source: The file it came from; None: none.
    """

    scene: SceneDescription = field(metadata=BESIDE)
    poses: dict[str, tuple[float, ...]] = field(default_factory=dict)
    commands: CommandSettings = CommandSettings()
    start: StartAnimation | None = None
    keys: dict[str, KeyBinding] = field(default_factory=dict)
    board: BoardDescription | None = None
    inverse: InverseSettings = InverseSettings()
    view: ViewSettings = ViewSettings()
    controllers: tuple[Controller, ...] = field(default=(), metadata=ABSENT)
    source: Path | None = field(default=None, metadata=ABSENT)

    def __post_init__(self) -> None:
        joints, poses = self.joint_names, tuple(self.poses)

        def check_known(what: str, name: str | None, names: tuple[str, ...]) -> None:
            if name is not None and name not in names:
                raise SceneError(f"scene {self.name}: unknown {what} {name!r}; {known_names(name, names)}")

        for pose, values in self.poses.items():
            if len(values) != len(joints):
                raise SceneError(
                    f"scene {self.name}: pose {pose} has {len(values)} values for {len(joints)} joints"
                )
            need_finite(f"scene {self.name}", f"poses.{pose}", values)
        if self.start is not None:
            check_known("pose", self.start.pose, poses)
        check_known("pose", self.inverse.posture, poses)
        for part in self.view.hidden:
            check_known("part to hide", part, self.shown_parts)
        for key, binding in self.keys.items():
            if key not in KEY_NAMES:
                words = sorted(each for each in KEY_NAMES if len(each) > 1)
                allowed = f"the name of a key: a letter, digit or sign, or {one_of(key, words)}"
                raise FieldError(f"scene {self.name}", f"keys.{key}", repr(key), allowed)
            check_known("pose", binding.pose, poses)
            for joint in binding.joints:
                check_known("joint", joint, joints)
        if self.board is not None:
            for servo in self.board.servos:
                check_known("joint", servo.joint, joints)

    @property
    def name(self) -> str:
        """Name of the scene and of the robot in it."""
        return self.scene.name

    @property
    def namespace(self) -> str:
        """The robot's ROS namespace: its name.

        Raises:
            FieldError: ROS does not allow the name; a file or a `Scene` with such a name is refused.
        """
        need_namespace(self.name)
        return self.name

    @property
    def joints(self) -> tuple[JointDescription, ...]:
        """The joints that commands, poses and boards drive, in command order."""
        return self.scene.joints

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in command order."""
        return self.scene.joint_names

    @property
    def start_joints(self) -> tuple[float, ...]:
        """Joint positions in [rad] or [m] at the end of the start move; without one, those at rest."""
        if self.start is None:
            return tuple(joint.rest for joint in self.joints)
        return self.poses[self.start.pose]

    @property
    def start_shift(self) -> float:
        """Shift in [m] of the joint bases at the end of the start move; without one, 0."""
        return 0.0 if self.start is None else self.start.base_shift

    @property
    def shown_parts(self) -> tuple[str, ...]:
        """All parts that can be hidden individually, as KIND/NAME, such as "bodies/silicone"."""
        kinds = ("bodies", "joints", "attachments", "rigid_bodies", "collisions")
        return tuple(f"{kind}/{part.name}" for kind in kinds for part in getattr(self.scene, kind))

    def with_scene(self, **changes: Any) -> RobotDescription:
        """Return the same robot with some fields of its scene changed, such as `dt=0.005`.

        Raises:
            SceneError: the changed fields are inconsistent.
        """
        return replace(self, scene=replace(self.scene, **changes))

    def robot_alone(self) -> RobotDescription:
        """Return the robot without contacts, sensors, user code and start move: a model for planning."""
        contact = replace(self.scene.contact, friction_pairs=())
        scene = replace(self.scene, rigid_bodies=(), collisions=(), sensors=(), contact=contact)
        return replace(self, scene=scene, controllers=(), start=None, view=ViewSettings())


def need_namespace(name: object) -> None:
    """Reject a robot's name that cannot be its ROS namespace."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", str(name)):
        allowed = "letters, digits and underscores, beginning with a letter (it is the ROS namespace)"
        raise FieldError("scene", "name", repr(name), allowed)


def as_robot(description: SceneDescription | RobotDescription) -> RobotDescription:
    """Return a robot as it is, or a scene as a robot with only its physics."""
    if isinstance(description, RobotDescription):
        return description
    return RobotDescription(scene=description)
