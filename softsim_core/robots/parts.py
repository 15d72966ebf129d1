"""Ready-made parts: functions with parameters that return items for `Scene.add`.

scene.add(servo("pan", limits=JointLimits(-1.0, 1.0, 3.5)))
scene.add(tripod(ServoCircle(servos=4), silicone=my_cross))
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from softsim_core.base import Array, Box, MeshFile, Placement, SceneError, Sphere, Vector
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import TetMesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    Controller,
    JointDescription,
    KeyBinding,
    MaterialDescription,
    Part,
    RunningSimulation,
    TendonSegment,
    animated,
)
from softsim_core.scene.io import config_file

MeshLevel: TypeAlias = Literal["low", "mid", "high"]

TRIPOD_LIMITS = JointLimits(lower=-2.0225, upper=-0.0255, speed=3.5, acceleration=35.0)
"""Range in [rad], top speed in [rad/s] (200 deg/s) and acceleration of the Tripod's servos as mounted."""

BEND_KEYS = (("up", "down", "left", "right"), ("w", "s", "k", "l"), ("t", "g", "f", "h"))
"""Keys of a tendon arm's first three segments: bend towards +x, -x, +y, -y."""

_TOWARDS = ((1.0, 0.0, "+x"), (-1.0, 0.0, "-x"), (0.0, 1.0, "+y"), (0.0, -1.0, "-y"))
_TIP_SIZE: Vector = (0.030, 0.045, 0.015)
_NOWHERE = Placement()
_FREE = JointLimits()


@dataclass(frozen=True, slots=True)
class WheelSpring:
    """A spring that pulls a servo's wheel to its command.

    Attributes:
        stiffness: In [N m/rad], > 0.
        inertia: Generalised inertia of the wheel in [kg m^2], >= 0.
    """

    stiffness: float
    inertia: float = 0.0


@dataclass(frozen=True, slots=True)
class ServoCircle:
    """Servos on a circle about z, their local x pointing to the centre.

    Attributes:
        radius: Radius of the circle in [m].
        servos: Number of servos, >= 1.
        angle_shift_deg: Angle of servo 0 in the xy plane in [deg]; the others follow counter-clockwise.
        height: Height of the wheels' axes in [m].
    """

    radius: float = 0.060
    servos: int = 3
    angle_shift_deg: float = 180.0
    height: float = -0.00135

    def place(self, index: int) -> Placement:
        """Return the base of the servo with a 0-based number."""
        turn = 360.0 * index / self.servos
        angle = math.radians(turn + self.angle_shift_deg)
        return Placement(
            translation=(self.radius * math.cos(angle), self.radius * math.sin(angle), self.height),
            rotation_deg=(0.0, 0.0, turn + self.angle_shift_deg - 180.0),
        )


TRIPOD_CIRCLE = ServoCircle()
"""Circle on which the Tripod's servos are mounted."""


def servo(
    name: str,
    base: Placement = _NOWHERE,
    limits: JointLimits = _FREE,
    horn_length: float = 0.0,
    spring: WheelSpring | None = None,
) -> Part:
    """Return a hobby servo: one wheel that rotates about the local y axis of its base.

    Args:
        name: Name of the joint.
        base: Placement of the servo's body, its origin on the wheel's axis. At angle 0 a horn points along
            local z; a positive angle rotates it towards local x.
        limits: Range in [rad] and top speed in [rad/s].
        horn_length: Length in [m] of the arm on the wheel, for pictures only.
        spring: Spring that pulls the wheel; None: it is exactly at its command.
    """
    joint = JointDescription(
        name=name,
        base=base,
        axis=(0.0, 1.0, 0.0),
        slide_axis=(1.0, 0.0, 0.0),
        limits=limits,
        horn_length=horn_length,
        stiffness=None if spring is None else spring.stiffness,
        inertia=0.0 if spring is None else spring.inertia,
    )
    return Part(joints=(joint,))


def actuated_arm(
    name: str,
    base: Placement = _NOWHERE,
    limits: JointLimits = _FREE,
    arm_length: float = 0.025,
    holds: str | None = None,
    tip: str | None = None,
    tip_size: Vector = _TIP_SIZE,
    spring: WheelSpring | None = None,
) -> Part:
    """Return a servo with an arm, whose end may be attached rigidly to a part of a deformable body.

    Args:
        name: Name of the joint.
        base: Placement of the servo's body, as in `servo`; the arm points along local z at angle 0.
        limits: Range in [rad] and top speed in [rad/s].
        arm_length: From the wheel's axis to the end of the arm, in [m].
        holds: Name of the attached body; None: there is none.
        tip: Name of the attachment; None: the joint's name + "_tip".
        tip_size: Box around the end of the arm with the attached nodes, along the local axes, in [m].
        spring: As in `servo`.
    """
    arm = servo(name, base, limits, arm_length, spring)
    if holds is None:
        return arm
    box = Box(center=(0.0, 0.0, arm_length), size=tip_size)
    tip = tip or f"{name}_tip"
    attachment = AttachmentDescription(name=tip, body=holds, to=name, relative_to=name, box=box)
    return Part(joints=arm.joints, attachments=(attachment,))


def elastic_body(
    name: str,
    mesh: str | PathLike[str] | MeshFile | TetMesh,
    young_modulus: float = 250.0e3,
    poisson_ratio: float = 0.45,
    total_mass: float = 0.032,
    surface: str | PathLike[str] | MeshFile | None = None,
    placement: Placement = _NOWHERE,
    density: float | None = None,
) -> Part:
    """Return a deformable body of linear elastic corotational tetrahedra.

    `elastic_body(...).with_bodies(mass_distribution="equal")` sets fields without an argument here.

    Args:
        name: Name of the body.
        mesh: Tetrahedra: a file, or arrays in [m].
        young_modulus: Young modulus in [Pa], > 0.
        poisson_ratio: Poisson ratio in [-], in (-1, 0.5).
        total_mass: Mass in [kg], > 0; not used with a density.
        surface: File of a finer visual surface that follows the body; None shows the tetrahedra's boundary.
        placement: Placement of the mesh and surface files; a MeshFile or TetMesh has its own.
        density: Mass per volume in [kg/m^3], > 0; None takes `total_mass`.
    """

    def to_mesh_file(file: str | PathLike[str] | MeshFile) -> MeshFile:
        return file if isinstance(file, MeshFile) else MeshFile(file=Path(file), placement=placement)

    body = BodyDescription(
        name=name,
        mesh=mesh if isinstance(mesh, TetMesh) else to_mesh_file(mesh),
        material=MaterialDescription(young_modulus=young_modulus, poisson_ratio=poisson_ratio),
        density=density,
        total_mass=total_mass if density is None else None,
        surface=None if surface is None else to_mesh_file(surface),
        colour=(0.98, 0.84, 0.72, 0.75),
    )
    return Part(bodies=(body,))


def fixing_box(
    name: str,
    body: str,
    center: Vector,
    size: Vector,
    rotation_deg: Vector = (0.0, 0.0, 0.0),
    stiffness: float | None = None,
) -> Part:
    """Return an attachment that fixes the nodes of a body inside a box to the world.

    Args:
        name: Name of the attachment.
        body: Name of the body.
        center: Centre in [m], in world coordinates.
        size: Full edge lengths in [m].
        rotation_deg: Orientation: angles about the fixed x, y, z axes in [deg].
        stiffness: None fixes the nodes exactly; a number is a spring in [N/m] for each of them.
    """
    box = Box(center=center, size=size, rotation_deg=rotation_deg)
    fixing = AttachmentDescription(name=name, body=body, to="world", box=box, stiffness=stiffness)
    return Part(attachments=(fixing,))


def tripod_silicone(
    level: MeshLevel = "low",
    height: float = 0.025,
    young_modulus: float = 250.0e3,
    poisson_ratio: float = 0.45,
    total_mass: float = 0.032,
) -> Part:
    """Return the Tripod's silicone Y: three arms, 5 mm thick, with a hole in the middle.

    Args:
        level: Fineness of the tetrahedra: "low", "mid" or "high". The visual surface is at least "mid".
        height: Height in [m] of its lower face.
        young_modulus: Young modulus in [Pa], > 0.
        poisson_ratio: Poisson ratio in [-], in (-1, 0.5).
        total_mass: Mass in [kg], > 0.

    Raises:
        ConfigError: the mesh files are not among the configs.
    """
    return elastic_body(
        "silicone",
        config_file(f"meshes/tripod_{level}.vtk"),
        young_modulus,
        poisson_ratio,
        total_mass,
        surface=config_file(f"meshes/tripod_{'mid' if level == 'low' else level}.stl"),
        placement=Placement(translation=(0.0, 0.0, height)),
    ).with_bodies(mass_distribution="equal")


def tripod(
    circle: ServoCircle = TRIPOD_CIRCLE,
    silicone: Part | BodyDescription | None = None,
    limits: JointLimits = TRIPOD_LIMITS,
    arm_length: float = 0.025,
    tips: Literal["servo", "free", "none"] = "servo",
    centre_radius: float | None = 0.0075,
    spring: WheelSpring | None = None,
) -> Part:
    """Return the Tripod: servos on a circle, each attached to one end of a silicone piece with the effector.

    Args:
        circle: Circle and number of the servos; joints servo_0, servo_1, ...
        silicone: The silicone piece, one body; None: `tripod_silicone()`.
        limits: Range in [rad] and top speed in [rad/s] of every servo.
        arm_length: Length in [m] of the arms.
        tips: Carriers of the ends of the silicone: "servo" arms, "free" rigid frames, "none" (soft).
        centre_radius: Nodes within this distance in [m] of the middle of the upper face, taken 5 mm above
            the end of the arms, form a rigid frame "centre", the effector; None leaves them soft.
        spring: As in `servo`.

    Raises:
        SceneError: no servo, or not exactly one silicone body.
    """
    if circle.servos < 1:
        raise SceneError(f"tripod: needs at least one servo, not {circle.servos}")
    if silicone is None:
        silicone = tripod_silicone()
    bodies = silicone.bodies if isinstance(silicone, Part) else (silicone,)
    if len(bodies) != 1:
        raise SceneError(f"tripod: silicone must be one body, not {len(bodies)}")
    joints: list[JointDescription] = []
    regions: list[AttachmentDescription] = []
    for index in range(circle.servos):
        base = circle.place(index)
        name, tip = f"servo_{index}", f"tip_{index}"
        arm = actuated_arm(name, base, limits, arm_length, bodies[0].name, tip, spring=spring)
        joints += arm.joints
        if tips == "servo":
            regions += arm.attachments
        elif tips == "free":
            x, y, z = base.translation
            frame = Placement(translation=(x, y, z + arm_length), rotation_deg=base.rotation_deg)
            regions += [replace(region, to="free", frame=frame) for region in arm.attachments]
    if centre_radius is not None:
        top = (0.0, 0.0, arm_length + 0.005)
        region, frame = Sphere(center=top, radius=centre_radius), Placement(translation=top)
        body = bodies[0].name
        regions.append(AttachmentDescription(name="centre", body=body, to="free", sphere=region, frame=frame))
    effector = None if centre_radius is None else "centre"
    return Part(bodies=bodies, joints=tuple(joints), attachments=tuple(regions), effector=effector)


def move_all(target: float, duration: float, delay: float = 0.0) -> Controller:
    """Return a controller that moves every joint from 0 to `target` in [rad] or [m] at constant speed.

    Args:
        target: Final position of all joints.
        duration: Duration of the move in [s], > 0.
        delay: Simulated time at which it starts in [s], >= 0.
    """

    def move(simulation: RunningSimulation, factor: float) -> None:
        simulation.command([target * factor] * len(simulation.joint_names))

    return animated(move, duration, delay=delay)


def bending_commands(segments: Sequence[TendonSegment], bends: Array) -> Array:
    """Return the displacement of each tendon in [m] that bends segments of constant curvature, shape (t,).

    A tendon of a segment also passes through all segments before it, so that a segment bends alone only if
    the tendons of later ones follow: s = sum_j radius_j (bx_j cos a + by_j sin a), over its own segment and
    those before. Stretch of tendons and of the rod is neglected.

    Args:
        segments: As in `tendon_arm`.
        bends: Angle in [rad] by which each segment bends towards the axes x and y, shape (k, 2).

    Raises:
        ValueError: not one bend per segment.
    """
    total = np.cumsum([segment.radius * bend for segment, bend in zip(segments, bends, strict=True)], axis=0)
    return np.concatenate([
        np.array([np.cos(angles), np.sin(angles)]).T @ along
        for angles, along in zip(
            (np.radians(segment.angles_deg) for segment in segments), total, strict=True
        )
    ])  # fmt: skip


def bend_keys(segments: Sequence[TendonSegment], step: float = 0.05) -> dict[str, KeyBinding]:
    """Return keys that bend one segment each, while the tendons of later segments follow.

    Args:
        segments: One to three, as in `tendon_arm`.
        step: Bend by one press in [rad].
    """
    keys = {}
    joints = tuple(f"s{k}t{t}" for k, each in enumerate(segments) for t in range(len(each.angles_deg)))
    for k, names in enumerate(BEND_KEYS[: len(segments)]):
        for name, (x, y, towards) in zip(names, _TOWARDS, strict=True):
            bends = np.zeros((len(segments), 2))
            bends[k] = step * x, step * y
            by = tuple(bending_commands(segments, bends).tolist())
            keys[name] = KeyBinding(joints=joints, by=by, help=f"segment {k} to {towards}")
    return keys
