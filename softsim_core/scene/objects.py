"""What a scene may hold beside silicone and servos: cables, rigid bodies, collision surfaces; typed, SI."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from softsim_core.errors import SceneError
from softsim_core.scene.values import (
    Box,
    FieldError,
    MeshFile,
    Placement,
    Vector,
    need_finite,
    need_positive,
)

Colour = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class CableDescription:
    """The cable that a joint of kind "cable" pulls: it slides without friction through points of a body.

    The joint's position is the travel: by how much the cable is shortened against its rest length, in [m].

    Attributes:
        body: Name of the deformable body that carries the points.
        points: Points in the frame of `placement`, from the pulled end to the anchored one; at least two, or
            one beside a pull point. Or a file that lists them (JSON or YAML).
        placement: Where that frame sits (scale converts file units to [m]).
        pull_point: Point in world coordinates in [m] where the cable leaves the robot; None: the first of
            `points` plays that part.
        pull_on: None: the pull point is fixed in space. A joint name: it moves with that joint.
        control: "displacement": commands are travels in [m]. "force": commands are tensions in [N].
        pull_only: A cable goes slack (True); False makes it a rod that can push, for comparison.
        max_tension: Largest tension in [N], > 0; None: not limited.
        rest_length: Length in [m] at travel 0; None: the length at the start of the scene.
    """

    body: str
    points: tuple[Vector, ...] | Path
    placement: Placement = Placement()
    pull_point: Vector | None = None
    pull_on: str | None = None
    control: Literal["displacement", "force"] = "displacement"
    pull_only: bool = True
    max_tension: float | None = None
    rest_length: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.points, Path):
            least = 2 if self.pull_point is None else 1
            if len(self.points) < least:
                raise FieldError("cable", "points", len(self.points), f"at least {least} points")
            for point in self.points:
                need_finite("cable", "points", point)
        if self.pull_point is not None:
            need_finite("cable", "pull_point", self.pull_point)
        if self.pull_on is not None and self.pull_point is None:
            raise SceneError("cable: pull_on needs a pull_point; give one or remove pull_on")
        for name, unit in (("max_tension", "N"), ("rest_length", "m")):
            value = getattr(self, name)
            if value is not None:
                need_positive("cable", name, value, unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """The surface of a rigid body, in its own frame, centred on the origin; exactly one field is given.

    Attributes:
        sphere: Radius in [m]; collides as an exact sphere.
        box: Edge lengths along x, y, z in [m].
        cylinder: Radius and height (along z) in [m].
        plane: Edge lengths along x and y in [m] of a rectangle that looks to +z.
        mesh: A closed surface; with mass, its frame's origin is moved to the centre of mass.
    """

    sphere: float | None = None
    box: Vector | None = None
    cylinder: tuple[float, float] | None = None
    plane: tuple[float, float] | None = None
    mesh: MeshFile | None = None

    def __post_init__(self) -> None:
        given = [
            each for each in (self.sphere, self.box, self.cylinder, self.plane, self.mesh) if each is not None
        ]
        if len(given) != 1:
            raise SceneError("shape: give exactly one of sphere, box, cylinder, plane and mesh")
        sizes = given[0] if isinstance(given[0], tuple) else (given[0],)
        for size in sizes:
            if isinstance(size, (int, float)) and not 0.0 < size < math.inf:
                raise FieldError("shape", "size", size, "> 0 m")


@dataclass(frozen=True, slots=True, kw_only=True)
class RigidBodyDescription:
    """A rigid body: free (with a mass), or carried by the world, a free frame or a joint (without).

    Attributes:
        name: Unique among all bodies.
        shape: Its surface.
        mass: Mass in [kg], > 0, of a body that moves by itself; None: it is carried by `on`.
        inertia: Principal moments in [kg m^2] about the axes of its frame; None: those of a solid of even
            density.
        pose: Where it starts in the world, or in the frame of `on` (its scale is not used).
        on: What carries a body without mass: "world", the name of a free frame (an attachment with to =
            free), or of a joint (the frame that the joint moves), or JOINT_base (the joint's base).
        colour: Red, green, blue, alpha in 0..1.
    """

    name: str
    shape: Shape
    mass: float | None = None
    inertia: Vector | None = None
    pose: Placement = Placement()
    on: str = "world"
    colour: Colour = (0.9, 0.7, 0.2, 1.0)

    def __post_init__(self) -> None:
        owner = f"rigid body {self.name}"
        if self.mass is not None:
            need_positive(owner, "mass", self.mass, "kg")
            if self.on != "world":
                raise SceneError(f"{owner}: a body with mass moves by itself; remove `on` or `mass`")
            if self.shape.plane is not None:
                raise SceneError(f"{owner}: a plane has no volume, so it takes no mass; remove `mass`")
        if self.inertia is not None:
            for moment in self.inertia:
                need_positive(owner, "inertia", moment, "kg m^2")


@dataclass(frozen=True, slots=True, kw_only=True)
class CollisionDescription:
    """A surface that touches others.

    Two surfaces that share a group never meet; a surface without group meets all others. Surfaces of one
    body meet only where each has groups and none in common (self-contact).

    Attributes:
        name: Unique name.
        body: Name of a deformable or rigid body.
        surface: A surface that follows the body; None: the boundary of the tetrahedra, or the rigid shape.
        boxes: Only the triangles with all corners in one of these boxes (rest shape); none: all.
        groups: Names of the groups it belongs to.
    """

    name: str
    body: str
    surface: MeshFile | None = None
    boxes: tuple[Box, ...] = ()
    groups: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactSettings:
    """How surfaces meet.

    Attributes:
        alarm_distance: Pairs closer than this in [m] are looked at, > contact_distance.
        contact_distance: Gap in [m] at which bodies come to rest, >= 0.
        friction: Coulomb coefficient in [-], >= 0.
        iterations: Most sweeps of the contact solver, > 0.
        tolerance: It stops below this complementarity residual in [m], > 0.
    """

    alarm_distance: float = 0.004
    contact_distance: float = 0.001
    friction: float = 0.5
    iterations: int = 1000
    tolerance: float = 1.0e-8

    def __post_init__(self) -> None:
        need_positive("contact", "tolerance", self.tolerance, "m")
        if not 0.0 <= self.contact_distance < self.alarm_distance < math.inf:
            raise FieldError(
                "contact",
                "alarm_distance",
                self.alarm_distance,
                f"> contact_distance = {self.contact_distance} m, which is >= 0",
            )
        if not 0.0 <= self.friction < math.inf:
            raise FieldError("contact", "friction", self.friction, ">= 0")
        if self.iterations < 1:
            raise FieldError("contact", "iterations", self.iterations, ">= 1")
