"""A scene under construction, as a Python scene file sees it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeAlias

from softsim_core.base import SceneError, Vector
from softsim_core.physics.actuation import Mode, check_animation, factor_at, is_over
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.sensing import SimulatedSensorDescription
from softsim_core.scene.board import BoardDescription
from softsim_core.scene.control import CommandSettings, InverseSettings, KeyBinding, StartAnimation
from softsim_core.scene.deformable import AttachmentDescription, BodyDescription
from softsim_core.scene.description import (
    CollisionDescription,
    RigidBodyDescription,
    SceneDescription,
    SolverSettings,
)
from softsim_core.scene.joint import JointDescription
from softsim_core.scene.robot import Controller, RobotDescription, RunningSimulation, need_namespace
from softsim_core.scene.view import ViewSettings

StepCallback: TypeAlias = "Callable[[RunningSimulation], None]"
KeyCallback: TypeAlias = "Callable[[RunningSimulation, str], None]"
Item: TypeAlias = (
    "BodyDescription | JointDescription | AttachmentDescription | RigidBodyDescription"
    " | CollisionDescription | SimulatedSensorDescription | Controller | Part"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """Contribution of a part to a scene: bodies, joints, surfaces that touch, possibly the end effector."""

    bodies: tuple[BodyDescription, ...] = ()
    joints: tuple[JointDescription, ...] = ()
    attachments: tuple[AttachmentDescription, ...] = ()
    rigid_bodies: tuple[RigidBodyDescription, ...] = ()
    collisions: tuple[CollisionDescription, ...] = ()
    sensors: tuple[SimulatedSensorDescription, ...] = ()
    controllers: tuple[Controller, ...] = ()
    effector: str | None = None

    def with_bodies(self, **changes: Any) -> Part:
        """Return the same part with other fields of its bodies, such as colour=(1.0, 0.0, 0.0, 1.0)."""
        return replace(self, bodies=tuple(replace(body, **changes) for body in self.bodies))


_LISTS = {
    "bodies": BodyDescription,
    "joints": JointDescription,
    "attachments": AttachmentDescription,
    "rigid_bodies": RigidBodyDescription,
    "collisions": CollisionDescription,
    "sensors": SimulatedSensorDescription,
    "controllers": Controller,
}
"""Lists of a scene and of a part, with the type of their items."""


@dataclass(slots=True, kw_only=True)
class Scene:
    """A mutable scene: set its fields, `add` parts, register controllers, `describe` it.

    Attributes: as in SceneDescription and RobotDescription, on one level; lists instead of tuples.
    """

    name: str = "scene"
    dt: float = 0.01
    gravity: Vector = (0.0, 0.0, -9.81)
    solver: SolverSettings = field(default_factory=SolverSettings)
    bodies: list[BodyDescription] = field(default_factory=list)
    joints: list[JointDescription] = field(default_factory=list)
    attachments: list[AttachmentDescription] = field(default_factory=list)
    rigid_bodies: list[RigidBodyDescription] = field(default_factory=list)
    collisions: list[CollisionDescription] = field(default_factory=list)
    contact: ContactSettings = field(default_factory=ContactSettings)
    effector: str | None = None
    sensors: list[SimulatedSensorDescription] = field(default_factory=list)
    poses: dict[str, tuple[float, ...]] = field(default_factory=dict)
    commands: CommandSettings = field(default_factory=CommandSettings)
    start: StartAnimation | None = None
    keys: dict[str, KeyBinding] = field(default_factory=dict)
    board: BoardDescription | None = None
    inverse: InverseSettings = field(default_factory=InverseSettings)
    view: ViewSettings = field(default_factory=ViewSettings)
    controllers: list[Controller] = field(default_factory=list)

    def add(self, item: Item | Iterable[Item]) -> None:
        """Add a part, a body, a joint, an attachment, a surface, a sensor, a controller, or several of them.

        Raises:
            SceneError: another type is given, or a second part defines an end effector.
        """
        if isinstance(item, Part):
            if item.effector is not None and self.effector not in (None, item.effector):
                raise SceneError(
                    f"scene {self.name}: already has the effector {self.effector}, cannot add {item.effector}"
                )
            for name in _LISTS:
                getattr(self, name).extend(getattr(item, name))
            self.effector = item.effector or self.effector
        elif name := next((name for name, cls in _LISTS.items() if isinstance(item, cls)), ""):
            getattr(self, name).append(item)
        elif isinstance(item, Iterable) and not isinstance(item, str | bytes):
            for each in item:
                self.add(each)
        else:
            raise SceneError(
                f"scene {self.name}: cannot add {item!r}; parts, bodies, joints, attachments, controllers fit"
            )

    def on_step_begin(self, callback: StepCallback) -> StepCallback:
        """Call `callback(simulation)` before every step; usable as a decorator."""
        self.controllers.append(Controller(on_begin=callback))
        return callback

    def on_step_end(self, callback: StepCallback) -> StepCallback:
        """Call `callback(simulation)` after every step; usable as a decorator."""
        self.controllers.append(Controller(on_end=callback))
        return callback

    def on_key(self, callback: KeyCallback) -> KeyCallback:
        """Call `callback(simulation, key)` for every pressed key; usable as a decorator."""
        self.controllers.append(Controller(on_key=callback))
        return callback

    def animate(
        self,
        callback: Callable[[RunningSimulation, float], None],
        duration: float,
        mode: Mode = "once",
        delay: float = 0.0,
    ) -> None:
        """Call `callback(simulation, factor)` before steps, from time `delay` in [s] on; see `animated`."""
        self.controllers.append(animated(callback, duration, mode, delay))

    def describe(self) -> RobotDescription:
        """Return the scene and its robot as an immutable, validated description.

        Raises:
            SceneError: the added parts are inconsistent.
        """
        need_namespace(self.name)
        values: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(self)}
        values |= {name: tuple(values[name]) for name in _LISTS}
        values["poses"] = {name: tuple(positions) for name, positions in self.poses.items()}
        values["keys"] = dict(self.keys)
        scene = SceneDescription(**{each.name: values.pop(each.name) for each in fields(SceneDescription)})
        return RobotDescription(scene=scene, **values)


def animated(
    callback: Callable[[RunningSimulation, float], None],
    duration: float,
    mode: Mode = "once",
    delay: float = 0.0,
) -> Controller:
    """Return a controller that plays an animation in simulated time.

    The factor depends on the simulated time alone: a reset or restored simulation plays it exactly again.

    Args:
        callback: Called with the simulation and the factor in 0..1 before each step while the animation runs.
        duration: Seconds from factor 0 to 1, > 0.
        mode: "once", "loop" or "pingpong", see actuation.animation.factor_at.
        delay: Simulated time of factor 0 in [s], >= 0.
    """
    check_animation(duration, mode, delay)

    def begin(simulation: RunningSimulation) -> None:
        elapsed = simulation.time - delay
        if elapsed > -1e-6 * simulation.dt and not is_over(elapsed - simulation.dt, duration, mode):
            callback(simulation, factor_at(elapsed, duration, mode))

    return Controller(on_begin=begin)
