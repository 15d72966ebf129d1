"""Scenes of things that touch, for tests. SI units."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from softsim_core import Simulation
from softsim_core.base import Array, Placement
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mesh import Shape
from softsim_core.scene import (
    BodyDescription,
    CollisionDescription,
    RigidBodyDescription,
    SceneDescription,
    SolverSettings,
)

GRAVITY = 9.81
DISTANCE = 0.001
"""Contact distance in [m] of these scenes."""
FLOOR = RigidBodyDescription(
    name="floor", shape=Shape(box=(1.0, 1.0, 0.02)), pose=Placement(translation=(0.0, 0.0, -0.01))
)
"""Its top is at z = 0."""


def loose(name: str, shape: Shape, z: float, mass: float = 0.03, **fields: Any) -> RigidBodyDescription:
    """A free rigid body whose centre starts at (0, 0, z)."""
    return RigidBodyDescription(
        name=name, shape=shape, mass=mass, pose=Placement(translation=(0.0, 0.0, z)), **fields
    )


def touching(
    *rigid: RigidBodyDescription,
    soft: tuple[BodyDescription, ...] = (),
    gravity: tuple[float, float, float] = (0.0, 0.0, -GRAVITY),
    friction: float = 0.5,
    backend: str = "auto",
    contact: dict[str, Any] | None = None,
    **fields: Any,
) -> SceneDescription:
    """A scene in which every body's whole surface may touch every other's."""
    settings = {
        "alarm_distance": 0.004,
        "contact_distance": DISTANCE,
        "friction": friction,
        **(contact or {}),
    }
    solver = {key: fields.pop(key) for key in ("rayleigh_stiffness", "rayleigh_mass") if key in fields}
    names = [each.name for each in (*soft, *rigid)]
    return SceneDescription(
        name="touching",
        gravity=gravity,
        solver=SolverSettings(backend=backend, **solver),  # type: ignore[arg-type]
        bodies=soft,
        rigid_bodies=rigid,
        collisions=tuple(CollisionDescription(name=name, body=name) for name in names),
        contact=ContactSettings(**settings),
        **fields,
    )


def downhill(angle: float, heading: float = 0.0) -> tuple[float, float, float]:
    """Gravity on a plane z = 0 tilted by `angle` [rad], downhill towards `heading` [rad] from x."""
    along = GRAVITY * math.sin(angle)
    return along * math.cos(heading), along * math.sin(heading), -GRAVITY * math.cos(angle)


def run(sim: Simulation, steps: int) -> None:
    """Step, and hold every step to the contact law: the residual, and no gap below -1e-6 m."""
    for _ in range(steps):
        sim.step()
        assert sim.contacts.residual < 1e-6
        assert sim.contacts.gaps.min(initial=0.0) > -1e-6


def force_on(sim: Simulation, name: str, of: str) -> Array:
    """Force in [N] on the surface called `name` by the one called `of` in the last step, shape (3,)."""
    names = [surface.name for surface in sim.collision_surfaces]
    first, second = names.index(name), names.index(of)
    report = sim.contacts
    total = report.forces[(report.pairs == (first, second)).all(axis=1)].sum(axis=0)
    return np.asarray(total - report.forces[(report.pairs == (second, first)).all(axis=1)].sum(axis=0))
