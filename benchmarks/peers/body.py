"""Input of every engine: the same mesh, material, mass, gravity and clamped nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from softsim_core.base import Array, Box, IndexArray
from softsim_core.physics.mechanics import FIXED
from softsim_core.scene import RobotDescription, SceneDescription
from softsim_core.scene.building import build


class PeerMissingError(ImportError):
    """An engine is not installed or is too old; the text says how to install it."""


@dataclass(frozen=True, eq=False)
class ClampedBody:
    """A deformable body whose nodes inside one box are clamped.

    Attributes:
        scene: Scene that contains only this body, clamped in one box.
        points: Rest positions in [m], shape (n, 3).
        tets: Tetrahedra, shape (m, 4).
        clamped_nodes: Indices of the clamped nodes, shape (k,).
        box: Region in which nodes are clamped.
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
    clamped_nodes: IndexArray
    box: Box
    volume: float
    young_modulus: float
    poisson_ratio: float
    total_mass: float
    gravity: Array
    dt: float

    def sag(self, points: Array) -> float:
        """Return how far in [m] the lowest of `points`, shape (n, 3), is below the lowest node at rest."""
        return float(self.points[:, 2].min() - points[:, 2].min())


class Engine(Protocol):
    """The body simulated by one engine, falling from rest.

    Attributes:
        name: Path in the records.
        version: Version of the engine.
        method: How it computes a step, in a few words.
        rests: Whether the body comes to rest, so that its sag can be measured.
    """

    name: str
    version: str
    method: str
    rests: bool

    def restart(self) -> None:
        """Return to the rest shape with zero velocity."""
        ...

    def advance(self) -> None:
        """Advance by one step of dt."""
        ...

    def points(self) -> Array:
        """Return the current node positions in [m], shape (n, 3), in the order of ClampedBody.points."""
        ...


def clamped_body(description: RobotDescription) -> ClampedBody:
    """Return the only body of a scene with one clamped box, in the form that other engines need."""
    model = build(description.scene).model
    body, box = description.scene.bodies[0], description.scene.attachments[0].box
    assert box is not None  # the attachment of held_centre is a box
    return ClampedBody(
        scene=description.scene,
        points=model.rest,
        tets=model.groups[0].cells,
        clamped_nodes=np.flatnonzero(model.region_of_node == FIXED),
        box=box,
        volume=float(model.groups[0].volumes.sum()),
        young_modulus=body.material.young_modulus,
        poisson_ratio=body.material.poisson_ratio,
        total_mass=float(model.mass.sum()),
        gravity=model.gravity,
        dt=model.dt,
    )
