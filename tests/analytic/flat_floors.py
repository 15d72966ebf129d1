"""Bodies that slide on flat floors of every kind, at any angle, and their closed forms. SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from contact_scenes import GRAVITY, downhill, touching
from scipy.spatial.transform import Rotation

from softsim_core import Simulation
from softsim_core.base import Array, Box, MeshFile, Placement
from softsim_core.physics.mesh import Shape, TetMesh, boundary_surface, box_mesh, write_surface
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    MaterialDescription,
    RigidBodyDescription,
)

DISTANCE = 0.0005
"""Contact distance in [m]."""
LENGTH, WIDTH, DEPTH = 0.24, 0.05, 0.02
CELLS = {"coarse mesh": (12, 3, 1), "mesh": (24, 5, 1), "fine mesh": (48, 10, 1)}
SOFT_CELLS = (16, 4, 2)
RIGID_FLOORS = ("box", "plane", *CELLS)
FLOORS = (*RIGID_FLOORS, "held slab", "soft slab")
BODIES = ("box", "ball", "cube mesh", "soft block")
EDGE, RADIUS = 0.02, 0.01
FREE, MOST_STEPS = 0.13, 60
"""A case ends after this way in [m], or this many steps."""
YAW = 0.2
"""How far in [rad] boxes are turned against their way."""


@dataclass(frozen=True)
class Slide:
    """One case.

    Attributes:
        body, floor: Of BODIES and FLOORS.
        speed: At the start in [m/s].
        dt: Time step in [s].
        friction: Coulomb coefficient.
        slope: Angle in [rad] of the floor against gravity.
        turn: Rotation vector in [rad] of the whole scene.
        backend: Implementation of the step.
    """

    body: str
    floor: str
    speed: float
    dt: float
    friction: float = 0.0
    slope: float = 0.0
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    backend: str = "auto"


def slide(case: Slide, folder: Path) -> tuple[Array, Array, Array]:
    """Simulate a case in as many steps as `closed_form` takes.

    Returns:
        Speeds downhill in [m/s], ways in [m], and gaps in [m] beyond the contact distance, of the undeformed
        floor, at the start and after each step.
    """
    turn = Rotation.from_rotvec(case.turn)
    angles: Any = tuple(turn.as_euler("xyz", degrees=True).tolist())

    def turned(*vector: float) -> Any:
        return tuple(turn.apply(vector).tolist())

    velocity = turned(case.speed, 0.0, 0.0)
    half = RADIUS if case.body == "ball" else 0.5 * EDGE
    rigid, soft, fixed, block_nodes = [], [], [], 0
    if case.body == "soft block":
        mesh = box_mesh((EDGE, EDGE, EDGE), (2, 2, 2), (-half, -half, -half))
        block_nodes = len(mesh.points)
        yawed = Rotation.from_rotvec((0.0, 0.0, YAW)).apply(mesh.points)
        points = turn.apply(yawed + np.array([0.03, 0.003, half + DISTANCE]))
        material = MaterialDescription(young_modulus=1e6, poisson_ratio=0.3)
        soft.append(
            BodyDescription(
                name="body", mesh=TetMesh(points, mesh.tets, "block"), material=material, total_mass=0.05,
                velocity=velocity,
            )
        )  # fmt: skip
    else:
        shape = Shape(sphere=RADIUS) if case.body == "ball" else Shape(box=(EDGE, EDGE, EDGE))
        if case.body == "cube mesh":
            shape = Shape(mesh=MeshFile(file=_surface(folder, (EDGE, EDGE, EDGE), (3, 3, 3))))
        heading: Any = (turn * Rotation.from_rotvec((0.0, 0.0, YAW))).as_euler("xyz", degrees=True).tolist()
        pose = Placement(rotation_deg=tuple(heading), translation=turned(0.03, 0.003, half + DISTANCE))
        rigid.append(RigidBodyDescription(name="body", shape=shape, mass=0.05, velocity=velocity, pose=pose))
    size = (LENGTH, WIDTH, DEPTH)
    if case.floor.endswith("slab"):
        mesh = box_mesh(size, SOFT_CELLS, (0.0, -0.5 * WIDTH, -DEPTH))
        material = MaterialDescription(young_modulus=1e6, poisson_ratio=0.3)
        mesh = TetMesh(turn.apply(mesh.points), mesh.tets, "slab")
        soft.append(BodyDescription(name="floor", mesh=mesh, material=material, density=1000.0))
        region = (9.0, 9.0, 9.0 if case.floor == "held slab" else 1e-6)
        box = Box(center=turned(0.0, 0.0, -DEPTH), size=region, rotation_deg=angles)
        fixed.append(AttachmentDescription(name="fixed", body="floor", to="world", box=box))
    else:
        centre, shape = (0.5 * LENGTH, 0.0, -0.5 * DEPTH), Shape(box=size)
        if case.floor == "plane":
            centre, shape = (0.5 * LENGTH, 0.0, 0.0), Shape(plane=size[:2])
        elif case.floor in CELLS:
            shape = Shape(mesh=MeshFile(file=_surface(folder, size, CELLS[case.floor])))
        pose = Placement(rotation_deg=angles, translation=turned(*centre))
        rigid.append(RigidBodyDescription(name="floor", shape=shape, pose=pose))
    gravity = turned(*downhill(case.slope))
    contact = {"alarm_distance": 0.003, "contact_distance": DISTANCE}
    sim = Simulation(
        touching(
            *rigid, soft=tuple(soft), gravity=gravity, friction=case.friction, backend=case.backend,
            contact=contact, attachments=tuple(fixed), dt=case.dt,
        )
    )  # fmt: skip
    way = np.array(turned(1.0, 0.0, 0.0))
    up = np.array(turned(0.0, 0.0, 1.0))
    block = slice(0, block_nodes)
    expected, speeds, ways, gaps = closed_form(case), [], [], []
    for _ in expected[0]:
        if not block_nodes:
            place, now = sim.rigid_poses[0].position, sim.rigid_velocities[0][:3]
            low = up @ place - half
        else:
            weights = sim.model.mass[block]
            place = np.average(sim.positions[block], axis=0, weights=weights)
            now = np.average(sim.velocities[block], axis=0, weights=weights)
            low = (sim.positions[block] @ up).min()
        speeds.append(way @ now)
        ways.append(way @ place)
        gaps.append(low - DISTANCE)
        sim.step()
    return np.array(speeds), np.array(ways) - ways[0], np.array(gaps)


def closed_form(case: Slide) -> tuple[Array, Array]:
    """Speeds in [m/s] and ways in [m] of Coulomb's law by implicit Euler, from the start on."""
    pull, hold = GRAVITY * math.sin(case.slope), case.friction * GRAVITY * math.cos(case.slope)
    speed, spin, way = case.speed, 0.0, 0.0
    speeds, ways = [speed], [way]
    while way < FREE and len(ways) <= MOST_STEPS:
        sliding = speed + case.dt * (pull - hold)
        if case.body == "ball":
            spun = spin + 2.5 * case.dt * hold  # radius times spin
            if case.friction > 0.0 and spun >= sliding:  # rolls from here on
                sliding = spun = (5.0 * (speed + case.dt * pull) + 2.0 * spin) / 7.0
            spin = spun
        speed = sliding if case.body == "ball" else max(sliding, 0.0)
        way += case.dt * speed
        speeds.append(speed)
        ways.append(way)
    return np.array(speeds), np.array(ways)


def _surface(folder: Path, size: tuple[float, float, float], cells: tuple[int, int, int]) -> Path:
    """The file of a box's surface about its centre, in triangles."""
    file = folder / f"{'x'.join(map(str, cells))}.stl"
    if not file.exists():
        write_surface(file, boundary_surface(box_mesh(size, cells, tuple(-0.5 * x for x in size))))
    return file
