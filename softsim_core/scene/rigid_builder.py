"""Rigid bodies of a scene, compiled: surfaces in their own frames, mass, inertia, who carries them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.pose import rotation_euler
from softsim_core.mechanics.rigid import RigidBodies, no_rigid_bodies
from softsim_core.mesh import SurfaceMesh
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.objects import RigidBodyDescription


@dataclass(frozen=True, slots=True, eq=False)
class RigidBody:
    """A rigid body, free or carried.

    Attributes:
        name: Its name.
        surface: Its surface in its own frame in [m]; the origin is the centre of mass of a free body.
        colour: Red, green, blue, alpha in 0..1.
        position, rotation: Where it starts: in the world, or in the frame of what carries it.
        free: Number among the free rigid bodies, or -1.
        on: What carries it; see RigidBodyDescription.
        radius: Radius in [m] of an exact sphere, else 0.
    """

    name: str
    surface: SurfaceMesh
    colour: tuple[float, float, float, float]
    position: Array
    rotation: Array
    free: int
    on: str
    radius: float


def rigid_objects(scene: SceneDescription) -> tuple[RigidBody, ...]:
    """All rigid bodies of a scene, in scene order.

    Raises:
        MeshError: a mesh cannot be used, or is open where a mass needs it closed.
    """
    result, count = [], 0
    for description in scene.rigid_bodies:
        surface, centre, _ = _surface_and_mass(description)
        rotation = rotation_euler(np.radians(description.pose.rotation_deg))
        position = np.array(description.pose.translation, dtype=float) + rotation @ centre
        free = -1
        if description.mass is not None:
            free, count = count, count + 1
        radius = description.shape.sphere or 0.0
        shifted = SurfaceMesh(surface.points - centre, surface.triangles, surface.name)
        name, colour, on = description.name, description.colour, description.on
        result.append(RigidBody(name, shifted, colour, position, rotation, free, on, radius))
    return tuple(result)


def rigid_bodies(scene: SceneDescription) -> RigidBodies:
    """The rigid bodies with mass of a scene."""
    chosen = [each for each in scene.rigid_bodies if each.mass is not None]
    if not chosen:
        return no_rigid_bodies()
    places = [each for each in rigid_objects(scene) if each.free >= 0]
    return RigidBodies(
        tuple(each.name for each in chosen),
        np.array([each.mass for each in chosen], dtype=float),
        np.array([_surface_and_mass(each)[2] for each in chosen]),
        np.array([place.position for place in places]),
        np.array([place.rotation for place in places]),
        np.array([(*each.velocity, *each.angular_velocity) for each in chosen], dtype=float),
    )


def _surface_and_mass(description: RigidBodyDescription) -> tuple[SurfaceMesh, Array, Array]:
    """Surface, centre of mass (3,) in its frame, and inertia (3, 3) about it; zeros without mass."""
    from softsim_core.mesh.shapes import mass_properties, surface_of

    surface = surface_of(description.shape)
    if description.mass is None:
        return surface, np.zeros(3), np.zeros((3, 3))
    centre, inertia = mass_properties(description.shape, surface, description.mass)
    if description.inertia is not None:
        inertia = np.diag(description.inertia)
    return surface, centre, inertia
