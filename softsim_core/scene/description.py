"""What a scene is: typed, immutable, SI. YAML files and Python scenes both end here; the builder starts here.

Angles of placements are in degrees in fields named `*_deg` (people write them); the rest is SI and radians.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

from softsim_core.actuation.limits import JointLimits
from softsim_core.errors import SceneError, listing
from softsim_core.mesh.types import TetMesh
from softsim_core.scene.board import BoardDescription, ServoCalibration
from softsim_core.scene.control import (
    Action,
    CommandSettings,
    EffectorTask,
    InverseSettings,
    KeyBinding,
    StartAnimation,
)
from softsim_core.scene.objects import (
    CableDescription,
    CollisionDescription,
    ContactSettings,
    RigidBodyDescription,
)
from softsim_core.scene.values import (
    Box,
    FieldError,
    MeshFile,
    Placement,
    Sphere,
    Vector,
    need_finite,
    need_positive,
    need_unit,
)
from softsim_core.scene.view import ViewSettings

if TYPE_CHECKING:
    from softsim_core.dynamics.simulation import Simulation

__all__ = [
    "Action",
    "AttachmentDescription",
    "Backend",
    "BoardDescription",
    "BodyDescription",
    "CommandSettings",
    "Controller",
    "EffectorTask",
    "InverseSettings",
    "JointDescription",
    "KeyBinding",
    "MaterialDescription",
    "RotationLaw",
    "SceneDescription",
    "ServoCalibration",
    "SolverSettings",
    "StartAnimation",
]

Backend: TypeAlias = Literal["auto", "numba", "scipy"]
RotationLaw: TypeAlias = Literal["polar", "qr"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MaterialDescription:
    """Isotropic linear elasticity: Young modulus in [Pa], > 0; Poisson ratio in [-], in (-1, 0.5)."""

    young_modulus: float
    poisson_ratio: float

    def __post_init__(self) -> None:
        need_positive("material", "young_modulus", self.young_modulus, "Pa")
        if not -1.0 < self.poisson_ratio < 0.5:
            raise FieldError(
                "material", "poisson_ratio", self.poisson_ratio, "between -1 and 0.5 (both excluded)"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyDescription:
    """A deformable body.

    Attributes:
        name: Unique name.
        mesh: Tetrahedra: a file, or arrays in [m].
        material: Elastic law.
        total_mass: Mass in [kg], > 0, spread equally over the nodes.
        surface: Finer visual surface that follows the body; None shows the boundary of the tetrahedra.
        colour: Red, green, blue, alpha in 0..1.
    """

    name: str
    mesh: MeshFile | TetMesh
    material: MaterialDescription
    total_mass: float
    surface: MeshFile | None = None
    colour: tuple[float, float, float, float] = (0.9, 0.9, 0.9, 1.0)

    def __post_init__(self) -> None:
        need_positive(f"body {self.name}", "total_mass", self.total_mass, "kg")
        if not all(0.0 <= channel <= 1.0 for channel in self.colour):
            raise FieldError(f"body {self.name}", "colour", list(self.colour), "four numbers in 0..1")


@dataclass(frozen=True, slots=True, kw_only=True)
class JointDescription:
    """One scalar degree of freedom between a base frame and the frame it moves.

    Attributes:
        name: Unique name; the order of joints in the scene is the order of commands.
        kind: revolute ([rad] about `axis`), prismatic ([m] along `axis`) or cable ([m] of travel).
        cable: What a joint of kind cable pulls; it has no frame and no axis.
        parent: Name of a joint before it in the list that carries this joint's base. On a revolute one a
            joint can carry rigid bodies only.
        base: Base frame in the world, the parent at rest (its scale is not used).
        axis: Unit axis in the base frame, through its origin.
        limits: Position interval and top speed.
        rest: Position at which the scene is built, in [rad] or [m].
        stiffness: None: the joint is exactly where it is commanded (a prescribed unknown; its reaction is the
            holding torque). A number: a spring of that stiffness in [N m/rad] or [N/m] pulls it there.
        inertia: Generalised inertia in [kg m^2] or [kg] of a joint with stiffness.
        slide_axis: Direction in the base frame in which the start move shifts the base, in simulation only.
        horn_length: Length in [m] of the servo arm, for pictures only.
    """

    name: str
    kind: Literal["revolute", "prismatic", "cable"] = "revolute"
    cable: CableDescription | None = None
    parent: str | None = None
    base: Placement = Placement()
    axis: Vector = (0.0, 1.0, 0.0)
    limits: JointLimits = JointLimits()
    rest: float = 0.0
    stiffness: float | None = None
    inertia: float = 0.0
    slide_axis: Vector = (1.0, 0.0, 0.0)
    horn_length: float = 0.0

    def __post_init__(self) -> None:
        owner = f"joint {self.name}"
        need_unit(owner, "axis", self.axis)
        need_unit(owner, "slide_axis", self.slide_axis)
        need_finite(owner, "rest", (self.rest,))
        if self.stiffness is not None:
            need_positive(owner, "stiffness", self.stiffness, "(or absent)")
        for field_name, value in (("inertia", self.inertia), ("horn_length", self.horn_length)):
            if not 0.0 <= value < math.inf:
                raise FieldError(owner, field_name, value, ">= 0")
        if (self.kind == "cable") != (self.cable is not None):
            raise SceneError(f"{owner}: `cable` and kind = cable belong together; give both or neither")
        if self.kind == "cable" and (self.stiffness is not None or self.parent is not None):
            raise SceneError(f"{owner}: a cable takes no stiffness and no parent; remove them")


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachmentDescription:
    """A region of a body that moves rigidly: with the world, with a joint, or as a free rigid frame.

    Attributes:
        name: Unique name; a free frame carries this name.
        body: Name of the body.
        to: "world" (held still), "free" (a rigid frame with six unknowns), or the name of a joint.
        box, sphere: The region, exactly one; nodes are chosen once, on the rest shape.
        relative_to: None: the region is given in world coordinates. A joint name: in that joint's base frame.
        frame: Origin in [m] and orientation of a free frame, in world coordinates.
        stiffness: Only with to = "world": spring in [N/m] a node instead of an exact hold.
    """

    name: str
    body: str
    to: str
    box: Box | None = None
    sphere: Sphere | None = None
    relative_to: str | None = None
    frame: Placement = Placement()
    stiffness: float | None = None

    def __post_init__(self) -> None:
        if (self.box is None) == (self.sphere is None):
            raise SceneError(f"attachment {self.name}: give exactly one of box and sphere")
        if self.stiffness is not None and (self.to != "world" or not 0.0 < self.stiffness < math.inf):
            raise SceneError(f"attachment {self.name}: stiffness needs to = world and a value > 0 N/m")


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverSettings:
    """Numerics: rotation law of the elements, implementation of the step, Rayleigh damping.

    Attributes:
        rotation: "polar" (symmetric, survives inversion) or "qr" (parity with the reference simulator).
        backend: "numba" (fast), "scipy" (readable reference) or "auto" (numba where it imports).
        rayleigh_stiffness: Damping per stiffness in [s], >= 0.
        rayleigh_mass: Damping per mass in [1/s], >= 0.
    """

    rotation: RotationLaw = "polar"
    backend: Backend = "auto"
    rayleigh_stiffness: float = 0.0
    rayleigh_mass: float = 0.0

    def __post_init__(self) -> None:
        for name, value, unit in (
            ("rayleigh_stiffness", self.rayleigh_stiffness, "s"),
            ("rayleigh_mass", self.rayleigh_mass, "1/s"),
        ):
            if not 0.0 <= value < math.inf:
                raise FieldError("solver", name, value, f">= 0 {unit}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller:
    """A user's own code in the loop; each hook is optional and gets the running Simulation.

    Attributes:
        on_begin: Called before every step.
        on_end: Called after every step.
        on_key: Called with the name of a pressed key ("up", "a") that the scene's own bindings have seen too.
    """

    on_begin: Callable[[Simulation], None] | None = None
    on_end: Callable[[Simulation], None] | None = None
    on_key: Callable[[Simulation, str], None] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneDescription:
    """A whole scene or robot; see the fields' types.

    `controllers` come from Python scenes only; `source` is the file it came from, for messages.
    """

    name: str
    dt: float = 0.01
    gravity: Vector = (0.0, 0.0, -9.81)
    solver: SolverSettings = SolverSettings()
    bodies: tuple[BodyDescription, ...] = ()
    joints: tuple[JointDescription, ...] = ()
    attachments: tuple[AttachmentDescription, ...] = ()
    rigid_bodies: tuple[RigidBodyDescription, ...] = ()
    collisions: tuple[CollisionDescription, ...] = ()
    contact: ContactSettings = ContactSettings()
    effector: str | None = None
    poses: dict[str, tuple[float, ...]] = field(default_factory=dict)
    commands: CommandSettings = CommandSettings()
    start: StartAnimation | None = None
    keys: dict[str, KeyBinding] = field(default_factory=dict)
    board: BoardDescription | None = None
    inverse: InverseSettings = InverseSettings()
    view: ViewSettings = ViewSettings()
    controllers: tuple[Controller, ...] = ()
    source: Path | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", str(self.name)):
            allowed = "letters, digits and underscores, beginning with a letter (it is the ROS namespace)"
            raise FieldError("scene", "name", repr(self.name), allowed)
        need_positive(f"scene {self.name}", "dt", self.dt, "s")
        need_finite(f"scene {self.name}", "gravity", self.gravity)
        for kind, names in (
            ("body", self.body_names),
            ("joint", self.joint_names),
            ("attachment", [attachment.name for attachment in self.attachments]),
            ("collision", [collision.name for collision in self.collisions]),
        ):
            for name in names:
                if list(names).count(name) > 1:
                    raise SceneError(f"scene {self.name}: two of kind {kind} are called {name}")
        self._check_references()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in command order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the deformable bodies, then of the rigid ones."""
        return (*(body.name for body in self.bodies), *(body.name for body in self.rigid_bodies))

    @property
    def shown_parts(self) -> tuple[str, ...]:
        """Everything that can be hidden by itself, as KIND/NAME, such as "bodies/silicone"."""
        kinds = ("bodies", "joints", "attachments", "rigid_bodies", "collisions")
        return tuple(f"{kind}/{part.name}" for kind in kinds for part in getattr(self, kind))

    def robot_alone(self) -> SceneDescription:
        """The scene without what it touches, without user code and start move: a model to plan with."""
        return replace(self, rigid_bodies=(), collisions=(), controllers=(), start=None, view=ViewSettings())

    def _check_references(self) -> None:
        bodies, joints = [body.name for body in self.bodies], self.joint_names
        frames = [joint.name for joint in self.joints if joint.kind != "cable"]
        free = [attachment.name for attachment in self.attachments if attachment.to == "free"]

        def known(what: str, name: str | None, names: list[str] | tuple[str, ...]) -> None:
            if name is not None and name not in names:
                raise SceneError(f"scene {self.name}: unknown {what} {name!r}; known: {listing(names)}")

        hinges = {joint.name for joint in self.joints if joint.kind == "revolute"}
        hinged: set[str] = set()
        for j, each in enumerate(self.joints):
            what = f"parent of joint {each.name} (a joint before it that is no cable)"
            known(what, each.parent, [name for name in frames if name in joints[:j]])
            if each.parent in hinges | hinged:
                hinged.add(each.name)

        def known_soft(what: str, name: str | None, names: list[str] | tuple[str, ...]) -> None:
            known(what, name, names)
            if name in hinged:
                raise SceneError(
                    f"scene {self.name}: {what} {name} is carried by a revolute joint, so it can carry "
                    "rigid bodies only; choose another joint"
                )

        for attachment in self.attachments:
            known("body", attachment.body, bodies)
            known_soft("attachment target", attachment.to, ("world", "free", *frames))
            known("joint", attachment.relative_to, frames)
        for each in self.joints:
            if each.cable is not None:
                known(f"body of cable {each.name}", each.cable.body, bodies)
                known_soft(f"pull_on of cable {each.name}", each.cable.pull_on, frames)
        for rigid in self.rigid_bodies:
            carriers = ("world", *free, *frames, *(f"{name}_base" for name in frames))
            known(f"carrier of rigid body {rigid.name}", rigid.on, carriers)
        for collision in self.collisions:
            known(f"body of collision {collision.name}", collision.body, self.body_names)
        known("effector (an attachment with to = free)", self.effector, free)
        for pose, values in self.poses.items():
            if len(values) != len(joints):
                raise SceneError(
                    f"scene {self.name}: pose {pose} has {len(values)} values for {len(joints)} joints"
                )
            need_finite(f"scene {self.name}", f"poses.{pose}", values)
        if self.start is not None:
            known("pose", self.start.pose, tuple(self.poses))
        known("pose", self.inverse.posture, tuple(self.poses))
        for part in self.view.hidden:
            known("part to hide", part, self.shown_parts)
        for binding in self.keys.values():
            known("pose", binding.pose, tuple(self.poses))
            for joint in binding.joints:
                known("joint", joint, joints)
        if self.board is not None:
            for servo in self.board.servos:
                known("joint", servo.joint, joints)
