"""What every engine is given: the same mesh, material, mass, gravity and held nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from softsim_core.base.arrays import Array, IndexArray
from softsim_core.base.values import Box
from softsim_core.physics.mechanics.model import FIXED
from softsim_core.scene.building.builder import build
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.robot import RobotDescription


class PeerMissingError(ImportError):
    """An engine is not installed, or is too old; the text says how to install it."""


@dataclass(frozen=True, eq=False)
class HeldBody:
    """A deformable body with one box of held nodes.

    Attributes:
        scene: What it is a part of: that body alone, held in one box.
        points: Rest positions in [m], shape (n, 3).
        tets: Tetrahedra, shape (m, 4).
        held: Indices of the held nodes, shape (k,).
        box: The region that holds them.
        volume: Volume at rest in [m^3].
        young_modulus: In [Pa].
        poisson_ratio: In [-].
        total_mass: In [kg].
        gravity: In [m/s^2], shape (3,).
        dt: Time step in [s].
    """

    scene: SceneDescription
    points: Array
    tets: IndexArray
    held: IndexArray
    box: Box
    volume: float
    young_modulus: float
    poisson_ratio: float
    total_mass: float
    gravity: Array
    dt: float

    def sag(self, points: Array) -> float:
        """How far in [m] the lowest node now is below the lowest node at rest; points of shape (n, 3)."""
        return float(self.points[:, 2].min() - points[:, 2].min())


class Engine(Protocol):
    """The body in an engine, falling from rest.

    Attributes:
        name: Path in the records.
        version: Version of the engine.
        method: How it computes a step, in a few words.
        rests: Whether the body comes to rest, so that its sag can be told.
    """

    name: str
    version: str
    method: str
    rests: bool

    def restart(self) -> None:
        """Back to the rest shape, without velocity."""
        ...

    def advance(self) -> None:
        """Go on by one dt."""
        ...

    def points(self) -> Array:
        """Node positions now in [m], shape (n, 3), in the order of HeldBody.points."""
        ...


def held_body(description: RobotDescription) -> HeldBody:
    """The one body of a held scene, as other engines need it."""
    model = build(description.scene).model
    body, box = description.scene.bodies[0], description.scene.attachments[0].box
    assert box is not None  # the scene held_centre holds a box
    return HeldBody(
        scene=description.scene,
        points=model.rest,
        tets=model.groups[0].cells,
        held=np.flatnonzero(model.region_of_node == FIXED),
        box=box,
        volume=float(model.groups[0].volumes.sum()),
        young_modulus=body.material.young_modulus,
        poisson_ratio=body.material.poisson_ratio,
        total_mass=float(model.mass.sum()),
        gravity=model.gravity,
        dt=model.dt,
    )
