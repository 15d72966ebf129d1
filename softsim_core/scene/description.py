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

Backend: TypeAlias = Literal["auto", "numba", "scipy"]
RotationLaw: TypeAlias = Literal["polar", "qr"]
EffectorTask: TypeAlias = Literal["position", "orientation", "height_tilt", "pose"]
Action: TypeAlias = Literal["start", "send", "inverse", "reset", "pause", "quit"]


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
class CommandSettings:
    """What the simulator does with commands.

    Attributes:
        enforce_limits: Keep joint limits (position and speed); False allows full turns, in simulation only.
        out_of_range: "clamp" to the nearest allowed position, or "refuse" the whole command.
    """

    enforce_limits: bool = True
    out_of_range: Literal["clamp", "refuse"] = "clamp"


@dataclass(frozen=True, slots=True, kw_only=True)
class StartAnimation:
    """The robot's start move: all joints from rest to a named pose, bases sliding in, in simulation only.

    Attributes:
        pose: Name of the pose reached.
        duration: Time in [s], > 0.
        base_shift: Shift in [m] of every joint's base along its slide_axis.
        at_start: Play it as soon as the simulation runs.
    """

    pose: str
    duration: float = 0.2
    base_shift: float = 0.0
    at_start: bool = False

    def __post_init__(self) -> None:
        need_positive("start animation", "duration", self.duration, "s")
        need_finite("start animation", "base_shift", (self.base_shift,))


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyBinding:
    """What a teleop key does: move joints `by` [rad] or [m], go to a `pose`, or an `action`."""

    help: str
    joints: tuple[str, ...] = ()
    by: float = 0.0
    pose: str | None = None
    action: Action | None = None

    def __post_init__(self) -> None:
        if sum((bool(self.joints), self.pose is not None, self.action is not None)) != 1:
            raise SceneError(f"key binding {self.help!r}: give exactly one of joints, pose and action")
        need_finite(f"key binding {self.help!r}", "by", (self.by,))


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoCalibration:
    """From joint angle to a hobby servo's degree byte: floor(sign * degrees + trim_deg) + zero_byte, clipped.

    Attributes:
        joint: Name of the joint.
        zero_byte: Byte at joint angle 0.
        sign: +1 or -1.
        trim_deg: Mounting correction in [deg].
        byte_min, byte_max: Range the servo may be sent to, within 0..180.
        rest_byte: Safe byte before start and after the end.
    """

    joint: str
    zero_byte: int = 179
    sign: Literal[1, -1] = 1
    trim_deg: float = 0.0
    byte_min: int = 60
    byte_max: int = 180
    rest_byte: int = 150

    def __post_init__(self) -> None:
        if not 0 <= self.byte_min <= self.rest_byte <= self.byte_max <= 180:
            raise SceneError(f"servo {self.joint}: needs 0 <= byte_min <= rest_byte <= byte_max <= 180")


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardDescription:
    """The serial board that drives the servos: header byte, then one degree byte a servo.

    Attributes:
        servos: Calibrations in packet order.
        baud_rate: Bits a second.
        header: First byte of a packet; servo bytes never reach it.
        rate: Packets a second in [Hz].
    """

    servos: tuple[ServoCalibration, ...]
    baud_rate: int = 115200
    header: int = 255
    rate: float = 50.0

    def __post_init__(self) -> None:
        if not self.baud_rate > 0:
            raise FieldError("board", "baud_rate", self.baud_rate, "> 0 bits/s")
        if not 180 < self.header <= 255:
            raise FieldError("board", "header", self.header, "in 181..255, above every servo byte")
        need_positive("board", "rate", self.rate, "Hz")


@dataclass(frozen=True, slots=True, kw_only=True)
class InverseSettings:
    """Inverse control: which effector coordinates follow the goal, and how.

    Attributes:
        task: What of a goal is followed: "position" (x, y, z), "orientation" (a rotation), "height_tilt"
            (z and where the effector's z axis points) or "pose" (all six).
        position_weights: Weight of the error along world x, y, z in [-], >= 0.
        orientation_weights: Weight of the rotation error about world x, y, z in [-], >= 0.
        lever: Length in [m] with which an angle counts as a displacement beside positions, > 0.
        gain: Share of the error that one control tick takes away, in (0, 1].
        max_shift: Largest position error in [m] along an axis that a tick looks at, > 0.
        max_turn: Largest rotation error in [rad] about an axis that a tick looks at, > 0.
        effort_weight: Weight of small joint efforts against tracking in [-], >= 0; decides between joints
            that can do the same.
        posture_weight: Weight of staying near `posture` against tracking in [-], >= 0.
        posture: Name of the pose that `posture_weight` pulls to; None: where control starts.
        lower, upper: Narrower joint interval in [rad] or [m] for all joints; None: the joints' own limits.
        speed: Lower joint speed in [rad/s] or [m/s], > 0; None: the joints' own.
        torque_limit: Largest holding torque in [N m] or force in [N] of a joint, > 0; None: not limited.
        backend: Effector Jacobian by the static tangent ("analytic") or from sampled equilibria ("sampled").
        feedback_gain: Rate in [1/s] at which the model's error against the measured pose is learned, >= 0.
        max_correction: Largest learned position error in [m], >= 0; anti-windup.
        max_correction_turn: Largest learned rotation error in [rad], >= 0; anti-windup.
        tolerance: A goal is reached within this distance in [m], > 0.
        tolerance_turn: And within this angle in [rad], > 0.
    """

    task: EffectorTask = "position"
    position_weights: Vector = (1.0, 1.0, 1.0)
    orientation_weights: Vector = (1.0, 1.0, 1.0)
    lever: float = 0.03
    gain: float = 0.5
    max_shift: float = 0.030
    max_turn: float = 0.2
    effort_weight: float = 1.0e-6
    posture_weight: float = 0.0
    posture: str | None = None
    lower: float | None = None
    upper: float | None = None
    speed: float | None = None
    torque_limit: float | None = None
    backend: Literal["analytic", "sampled"] = "analytic"
    feedback_gain: float = 5.0
    max_correction: float = 0.010
    max_correction_turn: float = 0.2
    tolerance: float = 1.0e-4
    tolerance_turn: float = 1.0e-3

    def __post_init__(self) -> None:
        units = (("lever", "m"), ("max_shift", "m"), ("max_turn", "rad"), ("tolerance", "m"))
        for name, unit in (*units, ("tolerance_turn", "rad"), ("speed", ""), ("torque_limit", "")):
            value = getattr(self, name)
            if value is not None:
                need_positive("inverse", name, value, unit)
        for name in (
            "effort_weight",
            "posture_weight",
            "feedback_gain",
            "max_correction",
            "max_correction_turn",
        ):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise FieldError("inverse", name, getattr(self, name), ">= 0")
        for name in ("position_weights", "orientation_weights"):
            if not all(0.0 <= weight < math.inf for weight in getattr(self, name)):
                raise FieldError("inverse", name, list(getattr(self, name)), "three numbers >= 0")
        if not 0.0 < self.gain <= 1.0:
            raise FieldError("inverse", "gain", self.gain, "> 0 and <= 1")
        for name in ("lower", "upper"):
            if math.isnan(getattr(self, name) or 0.0):
                raise FieldError("inverse", name, math.nan, "a number (or absent)")
        if self.lower is not None and self.upper is not None and not self.lower <= self.upper:
            raise FieldError("inverse", "lower", self.lower, f"<= upper = {self.upper}")


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
