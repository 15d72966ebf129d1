"""Ready-made parts of the cable gripper: a finger with its cable, three fingers on slides, objects to grasp.

scene.add(cable_finger("finger"))
scene.add([cable_gripper(), rigid_thing("cube", Shape(box=(0.04, 0.04, 0.04)), mass=0.03)])
"""

from __future__ import annotations

import math

import numpy as np

from softsim_core.base import Box, MeshFile, Placement, Vector, vector
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import Shape, place
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    CollisionDescription,
    Colour,
    JointDescription,
    MaterialDescription,
    Part,
    RigidBodyDescription,
)
from softsim_core.scene.io import config_file

FINGER_LIMITS = JointLimits(lower=0.0, upper=0.035, speed=0.05)
"""Travel in [m] and top speed in [m/s] of a finger's cable."""

_NOWHERE = Placement()
_BASE: Vector = (0.0075, 0.0, 0.0025)
_WALL_SIZE: Vector = (0.016, 0.001, 0.0077)
_TIP_WALLS, _BASE_WALLS = "tip_walls", "base_walls"
_WALLS = {  # along the finger in [m] where the middle of each notch wall is, and how it leans in [deg]
    _TIP_WALLS: ((-0.045718, -0.076064), 37.5),
    _BASE_WALLS: ((-0.034975, -0.065322), -37.5),
}


def cable_finger(
    name: str,
    placement: Placement = _NOWHERE,
    pull_point: Vector | None = None,
    pull_on: str | None = None,
    base_to: str = "world",
    limits: JointLimits = FINGER_LIMITS,
    max_tension: float | None = 30.0,
    collides: bool = True,
) -> Part:
    """Return a silicone finger of 1.8 MPa with a cable: along -y from its base, its notches towards +z.

    `cable_finger(...).with_bodies(total_mass=0.03)` sets fields without an argument here.

    Args:
        name: Name of the body; its joint is `name`_cable, its fixing `name`_base.
        placement: Its placement (the scale is not used).
        pull_point: Point where its cable leaves the robot, in world coordinates in [m]; None: the cable
            begins at its first point inside.
        pull_on: Name of the joint that carries the pull point; None: fixed in space.
        base_to: Carrier of its base: "world" or the name of a joint.
        limits: Travel in [m] and top speed in [m/s] of the cable.
        max_tension: Largest tension in [N]; None: not limited.
        collides: Whether to add its collision surfaces: the whole finger, and the two sides of its notches.

    Raises:
        ConfigError: the mesh files are not among the configs.
    """
    rotation = placement.rotation_deg
    base = Box(center=_place_point(_BASE, placement), size=(0.020, 0.004, 0.020), rotation_deg=rotation)
    body = BodyDescription(
        name=name,
        mesh=MeshFile(file=config_file("meshes/finger_low.vtk"), placement=placement),
        surface=MeshFile(file=config_file("meshes/finger_mid.stl"), placement=placement),
        material=MaterialDescription(young_modulus=1.8e6, poisson_ratio=0.45),
        total_mass=0.0198,
        mass_distribution="equal",
        colour=(0.0, 0.8, 0.7, 1.0),
    )
    cable = CableDescription(
        body=name,
        points=config_file("meshes/finger_cable.json"),
        placement=placement,
        pull_point=pull_point,
        pull_on=pull_on,
        max_tension=max_tension,
    )
    return Part(
        bodies=(body,),
        joints=(JointDescription(name=f"{name}_cable", kind="cable", limits=limits, actuator=cable),),
        attachments=(AttachmentDescription(name=f"{name}_base", body=name, to=base_to, box=base),),
        collisions=_surfaces(name, placement) if collides else (),
    )


def cable_gripper(collides: bool = True) -> Part:
    """Return three fingers below a slide at z = 0, closing towards y = 0.

    Joints: finger_1_cable, finger_2_cable, finger_3_cable, vertical, sideways, all in [m].

    Args:
        collides: As in `cable_finger`.

    Raises:
        ConfigError: the mesh files are not among the configs.
    """
    places = {
        "finger_1": (Placement(rotation_deg=(105.0, 0.0, 0.0), translation=(0.0, 0.020, 0.0)), 0.003),
        "finger_2": (Placement(rotation_deg=(-65.0, 180.0, 0.0), translation=(-0.004, -0.010, 0.0)), -0.007),
        "finger_3": (Placement(rotation_deg=(-65.0, 180.0, 0.0), translation=(0.034, -0.010, 0.0)), 0.0315),
    }
    fingers = [
        cable_finger(name, placement, (x, 0.003, 0.0105), "sideways", "sideways", collides=collides)
        for name, (placement, x) in places.items()
    ]
    up_down, to_sides = JointLimits(-0.055, 0.050, 0.05), JointLimits(-0.050, 0.050, 0.05)
    up, across = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    slides = (
        JointDescription(name="vertical", kind="prismatic", axis=up, limits=up_down),
        JointDescription(name="sideways", kind="prismatic", parent="vertical", axis=across, limits=to_sides),
    )
    return Part(
        bodies=tuple(body for finger in fingers for body in finger.bodies),
        joints=(*(joint for finger in fingers for joint in finger.joints), *slides),
        attachments=tuple(each for finger in fingers for each in finger.attachments),
        collisions=tuple(each for finger in fingers for each in finger.collisions),
    )


def rigid_thing(
    name: str,
    shape: Shape,
    pose: Placement = _NOWHERE,
    mass: float | None = None,
    on: str = "world",
    groups: tuple[str, ...] = (),
    colour: Colour = (0.9, 0.7, 0.2, 1.0),
) -> Part:
    """Return a rigid body that touches others with its whole surface: a floor, a cube, a ball.

    Args:
        name: Name of the body and of its collision surface.
        shape: Its surface.
        pose: Its initial pose (the scale is not used).
        mass: Mass in [kg] of a free body; None: it is carried by `on`.
        on: "world", or the name of a free frame or joint.
        groups: Surfaces that share a group never touch.
        colour: Red, green, blue, alpha in 0..1.
    """
    body = RigidBodyDescription(name=name, shape=shape, pose=pose, mass=mass, on=on, colour=colour)
    return Part(rigid_bodies=(body,), collisions=(CollisionDescription(name=name, body=name, groups=groups),))


def _surfaces(name: str, placement: Placement) -> tuple[CollisionDescription, ...]:
    """Return collision surfaces of the whole finger and of the sides of its notches, which can touch."""
    surfaces = [CollisionDescription(name=name, body=name, groups=(_TIP_WALLS, _BASE_WALLS))]
    about_x, about_y, about_z = placement.rotation_deg
    for side, (middles, lean_deg) in _WALLS.items():
        # a box leans about the finger's x axis before the finger itself is placed
        turn = math.remainder(about_x + lean_deg, 360.0), about_y, about_z
        centers = [_place_point((_BASE[0], along, 0.012), placement) for along in middles]
        boxes = tuple(Box(center=each, size=_WALL_SIZE, rotation_deg=turn) for each in centers)
        surfaces.append(CollisionDescription(name=f"{name}_{side}", body=name, groups=(side,), boxes=boxes))
    return tuple(surfaces)


def _place_point(point: Vector, placement: Placement) -> Vector:
    return vector(place(np.array([point]), placement)[0])
