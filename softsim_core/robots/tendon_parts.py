"""Ready-made arms pulled by tendons: one rod, disks along it, and tendons that end at disks.

segments = [TendonSegment(0.06, angles_deg=(0.0, 120.0, 240.0)), TendonSegment(0.06, (60.0, 180.0, 300.0))]
scene.add(tendon_arm(segments, Backbone(diameter=0.001, young_modulus=60.0e9)))
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import accumulate

import numpy as np

from softsim_core.base import (
    Array,
    Box,
    FieldError,
    Placement,
    SceneError,
    need_finite,
    need_not_negative,
    need_positive,
)
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import Shape
from softsim_core.scene import (
    AddedMassDescription,
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    KeyBinding,
    MaterialDescription,
    Part,
    RigidBodyDescription,
    RodDescription,
    RodSectionDescription,
)

TENDON_LIMITS = JointLimits(lower=-0.020, upper=0.020, speed=0.05, acceleration=0.5)
"""Travel in [m], top speed in [m/s] and acceleration in [m/s^2] of a tendon."""

BEND_KEYS = (("up", "down", "left", "right"), ("w", "s", "k", "l"), ("t", "g", "f", "h"))
"""Keys of the first three segments: bend towards +x, -x, +y, -y."""

_TOWARDS = ((1.0, 0.0, "+x"), (-1.0, 0.0, "-x"), (0.0, 1.0, "+y"), (0.0, -1.0, "-y"))
_BACKBONE, _DISK = (0.75, 0.77, 0.80, 1.0), (0.25, 0.45, 0.85, 1.0)


@dataclass(frozen=True, slots=True)
class TendonSegment:
    """A segment of an arm, and the tendons that end at its last disk.

    Attributes:
        length: In [m], > 0.
        angles_deg: Angle of each of its tendons about the arm's axis in [deg]; it has them from the base on.
        disks: Number of its disks, evenly spaced, the last one at its end, >= 1.
        radius: Distance of its tendons from the axis in [m], > 0.
    """

    length: float
    angles_deg: tuple[float, ...] = (0.0, 120.0, 240.0)
    disks: int = 5
    radius: float = 0.008

    def __post_init__(self) -> None:
        need_positive("segment", "length", self.length, "m")
        need_positive("segment", "radius", self.radius, "m")
        need_finite("segment", "angles_deg", self.angles_deg)
        if self.disks < 1:
            raise FieldError("segment", "disks", self.disks, ">= 1")


@dataclass(frozen=True, slots=True)
class Backbone:
    """The round rod in the middle of an arm.

    Attributes:
        diameter: In [m], > 0.
        young_modulus: In [Pa], > 0.
        wall: Thickness of the wall of a tube in [m]; None: it is solid.
        poisson_ratio: In [-], in (-1, 0.5).
        density: In [kg/m^3], > 0.
        stiffness: Replaces the stiffness of shape and material, as in RodSectionDescription.
    """

    diameter: float
    young_modulus: float
    wall: float | None = None
    poisson_ratio: float = 0.3
    density: float = 7800.0
    stiffness: tuple[float, float, float, float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Tendon:
    """Properties of every tendon of an arm; they are fields of CableDescription.

    Attributes:
        axial_stiffness: EA in [N]; None: its length does not stretch.
        compliance: Further stretch in [m/N], >= 0.
        pretension: Tension in [N] at displacement 0 under the command 0, >= 0.
        max_tension: Largest tension in [N]; None: not limited.
        friction: Coefficient of friction at the disks, >= 0.
        friction_per_length: Share of the tension lost per length in [1/m], >= 0.
        presliding: Motion in [m] in which friction grows, > 0.
        pull_only: Whether it can go slack. False makes it an antagonistic pair on one motor, the second
            tendon opposite to the first: its effort is the difference of both tensions, so that its
            compliance is half of that of one tendon.
    """

    axial_stiffness: float | None = None
    compliance: float = 0.0
    pretension: float = 0.0
    max_tension: float | None = None
    friction: float = 0.0
    friction_per_length: float = 0.0
    presliding: float = 1e-4
    pull_only: bool = True


_INEXTENSIBLE = Tendon()


def tendon_arm(
    segments: Sequence[TendonSegment],
    backbone: Backbone,
    tendon: Tendon = _INEXTENSIBLE,
    limits: JointLimits = TENDON_LIMITS,
    disk_mass: float = 0.0,
    tip_load: float = 0.0,
    down: bool = True,
    name: str = "arm",
) -> Part:
    """Return an arm with its base at the origin: a rod with disks, and tendons.

    Tendon T of segment K, both numbered from 0, is the joint sKtT. It runs parallel to the axis from a fixed
    point at the base through all disks up to the end of its segment, straight from disk to disk. The free
    frame NAME_K at the last disk of segment K moves with the rod's nearest section; the last is the effector.

    Args:
        segments: From the base to the tip.
        backbone: The rod.
        tendon: Properties of every tendon.
        limits: Travel in [m] and top speed in [m/s] of every tendon.
        disk_mass: Mass in [kg] of each disk, >= 0.
        tip_load: Further mass in [kg] at the tip, >= 0.
        down: Whether it points along -z, and not along z.
        name: Name of the body; its fixing is NAME_base.

    Raises:
        SceneError: no segment.
        FieldError: a mass is negative.
    """
    if not segments:
        raise SceneError(f"tendon arm {name}: needs at least one segment")
    need_not_negative(f"tendon arm {name}", "disk_mass", disk_mass, "kg")
    need_not_negative(f"tendon arm {name}", "tip_load", tip_load, "kg")
    sign = -1.0 if down else 1.0
    ends = [0.0, *accumulate(segment.length for segment in segments)]
    disks = [
        start + segment.length * (disk + 1) / segment.disks
        for start, segment in zip(ends, segments, strict=False)
        for disk in range(segment.disks)
    ]
    spacing = ends[-1] / (2 * len(disks))  # of the rod's sections: ends and middles of cells of one length

    def across(disk: float) -> Box:
        """Return a box around the section of the rod nearest to a distance in [m] from the base."""
        nearest = spacing * round(disk / spacing)
        return Box(center=(0.0, 0.0, sign * nearest), size=(1.0, 1.0, 0.1 * spacing))

    masses = [AddedMassDescription(mass=disk_mass, box=across(disk)) for disk in disks if disk_mass]
    body = BodyDescription(
        name=name,
        rod=RodDescription(
            centreline=((0.0, 0.0, 0.0), (0.0, 0.0, sign * ends[-1])),
            section=RodSectionDescription(
                shape="ellipse",
                size=(backbone.diameter, backbone.diameter),
                wall=backbone.wall,
                stiffness=backbone.stiffness,
            ),
            first_axis=(1.0, 0.0, 0.0),
            elements=len(disks),
        ),
        material=MaterialDescription(
            law="rod", young_modulus=backbone.young_modulus, poisson_ratio=backbone.poisson_ratio
        ),
        density=backbone.density,
        added_masses=(*masses, *([AddedMassDescription(mass=tip_load, end="end")] if tip_load else [])),
        colour=_BACKBONE,
    )
    joints, pictures = list[JointDescription](), list[RigidBodyDescription]()
    frames = [AttachmentDescription(name=f"{name}_base", body=name, to="world", end="start")]
    for k, segment in enumerate(segments):
        end, frame = ends[k + 1], f"{name}_{k}"
        origin = Placement(translation=(0.0, 0.0, sign * end))
        frames.append(AttachmentDescription(name=frame, body=name, to="free", box=across(end), frame=origin))
        shape = Shape(cylinder=(1.2 * max(each.radius for each in segments[k:]), 0.002))
        pictures.append(RigidBodyDescription(name=f"disk_{k}", shape=shape, on=frame, colour=_DISK))
        for t, angle in enumerate(np.radians(segment.angles_deg)):
            x, y = segment.radius * math.cos(angle), segment.radius * math.sin(angle)
            cable = CableDescription(
                body=name,
                points=tuple((x, y, sign * disk) for disk in disks if disk <= end * (1.0 + 1e-9)),
                pull_point=(x, y, 0.0),
                **asdict(tendon),
            )
            joints.append(JointDescription(name=f"s{k}t{t}", kind="cable", actuator=cable, limits=limits))
    return Part(
        bodies=(body,),
        joints=tuple(joints),
        attachments=tuple(frames),
        rigid_bodies=tuple(pictures),
        effector=frames[-1].name,
    )


def bending_commands(segments: Sequence[TendonSegment], bends: Array) -> Array:
    """Return the displacement of each tendon in [m] that bends segments of constant curvature, shape (t,).

    A tendon of a segment also passes through all segments before it, so that a segment bends alone only if
    the tendons of later ones follow: s = radius sum_j (bx_j cos a + by_j sin a), over its own segment and
    those before. Stretch of tendons and of the rod is neglected.

    Args:
        segments: As in `tendon_arm`.
        bends: Angle in [rad] by which each segment bends towards the axes x and y, shape (k, 2).

    Raises:
        ArrayError: not one bend per segment.
    """
    total = np.cumsum(bends, axis=0)
    return np.concatenate([
        segment.radius * np.array([np.cos(angles), np.sin(angles)]).T @ along
        for segment, angles, along in zip(
            segments, (np.radians(segment.angles_deg) for segment in segments), total, strict=True
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
