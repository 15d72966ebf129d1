"""What a scene may hold beside silicone and joints: rigid bodies, collision surfaces; typed, SI."""

from __future__ import annotations

from dataclasses import dataclass, field

from softsim_core.errors import SceneError
from softsim_core.mesh.shapes import Shape
from softsim_core.values import DIRECTION, Box, MeshFile, Placement, Vector, need_finite, need_positive

Colour = tuple[float, float, float, float]


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
        velocity, angular_velocity: How a body with mass moves at the start, of its centre of mass in [m/s]
            and in [rad/s], world axes.
        on: What carries a body without mass: "world", the name of a free frame (an attachment with to =
            free), or of a joint (the frame that the joint moves), or JOINT_base (the joint's base).
        colour: Red, green, blue, alpha in 0..1, for pictures only.
    """

    name: str
    shape: Shape
    mass: float | None = None
    inertia: Vector | None = None
    pose: Placement = Placement()
    velocity: Vector = field(default=(0.0, 0.0, 0.0), metadata=DIRECTION)
    angular_velocity: Vector = field(default=(0.0, 0.0, 0.0), metadata=DIRECTION)
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
        need_finite(owner, "velocity", self.velocity)
        need_finite(owner, "angular_velocity", self.angular_velocity)
        if self.mass is None and any((*self.velocity, *self.angular_velocity)):
            raise SceneError(
                f"{owner}: what carries a body without mass moves it; remove `velocity` and "
                "`angular_velocity`, or give a `mass`"
            )
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
        faces: Only those of a physical group of faces of the body's Gmsh file; None: all.
        groups: Names of the groups it belongs to.
    """

    name: str
    body: str
    surface: MeshFile | None = None
    boxes: tuple[Box, ...] = ()
    faces: str | None = None
    groups: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.faces is not None and (self.boxes or self.surface is not None):
            raise SceneError(
                f"collision {self.name}: `faces` names all of its triangles; remove `boxes` and `surface`, "
                "or `faces`"
            )
