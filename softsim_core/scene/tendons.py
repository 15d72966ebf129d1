"""Arms pulled by tendons, the key `tendon_arm` of a scene's file: a rod, disks along it, tendons to disks.

segments = [TendonSegment(0.06, angles_deg=(0.0, 120.0, 240.0)), TendonSegment(0.06, (60.0, 180.0, 300.0))]
scene.add(tendon_arm(segments, Backbone(diameter=0.001, young_modulus=60.0e9)))
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from itertools import accumulate, pairwise

import numpy as np

from softsim_core.base import (
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
from softsim_core.scene.deformable import AddedMassDescription, AttachmentDescription, BodyDescription
from softsim_core.scene.description import RigidBodyDescription
from softsim_core.scene.joint import JointDescription
from softsim_core.scene.material import MaterialDescription
from softsim_core.scene.rod import RodDescription, RodSectionDescription
from softsim_core.scene.scene import Part

TENDON_LIMITS = JointLimits(lower=-0.020, upper=0.020, speed=0.05, acceleration=0.5)
"""Travel in [m], top speed in [m/s] and acceleration in [m/s^2] of a tendon."""

MOST_DISKS = 1000
"""Largest number of disks of a segment."""

_BACKBONE, _DISK = (0.75, 0.77, 0.80, 1.0), (0.25, 0.45, 0.85, 1.0)


@dataclass(frozen=True, slots=True)
class TendonSegment:
    """A segment of an arm, and the tendons that end at its last disk.

    Attributes:
        length: In [m], > 0.
        angles_deg: Angle of each of its tendons about the arm's axis in [deg]; it has them from the base on.
        disks: Number of its disks, evenly spaced, the last one at its end, 1 to 1000.
        radius: Distance from the axis in [m], > 0, of all tendons that run through it.
        stiffness: Factor on the stiffness of the backbone in it, > 0.
        slack: Length in [m] by which each of its tendons is longer than its way through the arm as drawn,
            negative where it is shorter; none: 0.
        tendon: Properties of its tendons; None: those of the arm.
    """

    length: float
    angles_deg: tuple[float, ...] = (0.0, 120.0, 240.0)
    disks: int = 5
    radius: float = 0.008
    stiffness: float = 1.0
    slack: tuple[float, ...] = ()
    tendon: Tendon | None = None

    def __post_init__(self) -> None:
        need_positive("segment", "length", self.length, "m")
        need_positive("segment", "radius", self.radius, "m")
        need_positive("segment", "stiffness", self.stiffness, "")
        need_finite("segment", "angles_deg", self.angles_deg)
        need_finite("segment", "slack", self.slack)
        if len(self.slack) not in (0, len(self.angles_deg)):
            raise FieldError("segment", "slack", list(self.slack), f"{len(self.angles_deg)} lengths, or none")
        if not 1 <= self.disks <= MOST_DISKS:
            raise FieldError("segment", "disks", self.disks, f"1 to {MOST_DISKS}")


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

    Tendon T of segment K, both numbered from 0, is the joint sKtT. It runs from a fixed point at the base
    through all disks up to the end of its segment, straight from disk to disk, at one angle about the axis
    and as far from it as each segment says; at the base as far as in the first segment. The free
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
        FieldError: a mass is negative, or a slack leaves a tendon no length.
    """
    if not segments:
        raise SceneError(f"tendon arm {name}: needs at least one segment")
    need_not_negative(f"tendon arm {name}", "disk_mass", disk_mass, "kg")
    need_not_negative(f"tendon arm {name}", "tip_load", tip_load, "kg")
    sign = -1.0 if down else 1.0
    ends = [0.0, *accumulate(segment.length for segment in segments)]
    disks, radii = list[float](), list[float]()
    for start, segment in zip(ends, segments, strict=False):
        disks += [start + segment.length * (disk + 1) / segment.disks for disk in range(segment.disks)]
        radii += [segment.radius] * segment.disks
    shares = [(end / ends[-1], segment.stiffness) for end, segment in zip(ends[1:], segments, strict=True)]
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
            stiffness_factors=tuple(shares) if any(factor != 1.0 for _, factor in shares) else (),
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
        through = sum(each.disks for each in segments[: k + 1])
        for t, angle in enumerate(np.radians(segment.angles_deg)):
            x, y = math.cos(angle), math.sin(angle)
            points = [
                (radius * x, radius * y, sign * disk)
                for radius, disk in zip((radii[0], *radii[:through]), (0.0, *disks[:through]), strict=True)
            ]
            drawn = sum(math.dist(*pair) for pair in pairwise(points))
            if segment.slack and not drawn + segment.slack[t] > 0.0:
                need = f"above {-drawn:g} m, as tendon {t} is {drawn:g} m long as drawn"
                raise FieldError(f"segments[{k}]", "slack", segment.slack[t], need)
            cable = CableDescription(
                body=name,
                points=tuple(points[1:]),
                pull_point=points[0],
                rest_length=drawn + segment.slack[t] if segment.slack else None,
                **asdict(segment.tendon or tendon),
            )
            joints.append(JointDescription(name=f"s{k}t{t}", kind="cable", actuator=cable, limits=limits))
    return Part(
        bodies=(body,),
        joints=tuple(joints),
        attachments=tuple(frames),
        rigid_bodies=tuple(pictures),
        effector=frames[-1].name,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TendonArmDescription:
    """The key `tendon_arm` of a scene's file: the arguments of the function `tendon_arm`."""

    segments: tuple[TendonSegment, ...]
    backbone: Backbone
    tendon: Tendon = _INEXTENSIBLE
    limits: JointLimits = TENDON_LIMITS
    disk_mass: float = 0.0
    tip_load: float = 0.0
    down: bool = True
    name: str = "arm"

    def part(self) -> Part:
        """Return the arm."""
        return tendon_arm(**{each.name: getattr(self, each.name) for each in fields(self)})
