"""A ball in a smooth tube of triangles: it falls freely, and slides down a tilted one without loss."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contact_scenes import GRAVITY, touching
from scipy.spatial.transform import Rotation

from softsim_core import Simulation
from softsim_core.base import Array, Box, MeshFile, Placement
from softsim_core.physics.mesh import (
    Shape,
    TetMesh,
    boundary_surface,
    box_mesh,
    sphere_surface,
    write_surface,
)
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    MaterialDescription,
    RigidBodyDescription,
)

RADIUS, DISTANCE, PLAY = 0.01, 0.0005, 0.0002
"""Of the ball, between it and the wall where they touch, and of the ball's centre about the axis, in [m]."""
LENGTH, THICK, REFINEMENTS = 0.2, 0.004, 2
AROUND, ALONG = 48, 60
"""Cells of the wall; each is 1.4 mm wide and 3.3 mm long."""
WAY, MOST_STEPS = 0.12, 60
WALLS, BALLS = ("rigid", "held"), ("sphere", "mesh")
SPEEDS, STEPS, TILTS = (0.0, 0.1, 0.5), (0.002, 0.01, 0.02), (0.0, 0.2, 0.7, 1.2)
TURNS = ((0.0, 0.0, 0.0), (0.3, -0.2, 0.5), (-0.7, 2.0, 1.0))


@dataclass(frozen=True)
class Fall:
    """One case.

    Attributes:
        ball, wall: Of BALLS and WALLS.
        speed: Along the tube at the start in [m/s].
        dt: Time step in [s].
        tilt: Angle in [rad] of the tube against gravity.
        off: Where the ball's centre starts, off the axis, as a share of PLAY.
        heading: Angle in [rad] about the axis towards which it is off, and towards which the tube is tilted.
        turn: Rotation vector in [rad] of the whole scene.
        backend: Implementation of the step.
    """

    ball: str
    wall: str
    speed: float
    dt: float
    tilt: float
    off: float
    heading: float
    turn: tuple[float, float, float]
    backend: str = "auto"


def tube() -> TetMesh:
    """A tube along z whose flat inner cells are RADIUS + DISTANCE + PLAY from its axis."""
    flat = box_mesh((1.0, THICK, LENGTH), (AROUND, 2, ALONG))
    inner = (RADIUS + DISTANCE + PLAY) / math.cos(math.pi / AROUND)
    angle, radius = -2.0 * math.pi * flat.points[:, 0], inner + flat.points[:, 1]
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), flat.points[:, 2]])
    seam = len(points) - 3 * (ALONG + 1)  # its last nodes are the first ones
    return TetMesh(points[:seam], flat.tets % seam, "tube")


def fall(case: Fall, folder: Path) -> tuple[Array, Array]:
    """Simulate a case; speeds along the tube in [m/s] and how far the centre is off the axis in [m]."""
    turn = Rotation.from_rotvec(case.turn)
    angles: Any = tuple(turn.as_euler("xyz", degrees=True).tolist())
    out = np.array([math.cos(case.heading), math.sin(case.heading), 0.0])
    down = turn.apply((0.0, 0.0, -1.0))

    def turned(vector: Any) -> Any:
        return tuple(turn.apply(vector).tolist())

    mesh, rigid, soft, fixed = tube(), [], [], []
    if case.wall == "held":
        mesh = TetMesh(turn.apply(mesh.points), mesh.tets, "wall")
        material = MaterialDescription(young_modulus=1e6, poisson_ratio=0.3)
        soft.append(BodyDescription(name="wall", mesh=mesh, material=material, density=1000.0))
        everywhere = Box(center=(0.0, 0.0, 0.0), size=(9.0, 9.0, 9.0))
        fixed.append(AttachmentDescription(name="fixed", body="wall", to="world", box=everywhere))
    else:
        write_surface(folder / "tube.stl", boundary_surface(mesh))
        shape = Shape(mesh=MeshFile(file=folder / "tube.stl"))
        rigid.append(RigidBodyDescription(name="wall", shape=shape, pose=Placement(rotation_deg=angles)))
    shape = Shape(sphere=RADIUS)
    if case.ball == "mesh":
        write_surface(folder / "ball.stl", sphere_surface(RADIUS, REFINEMENTS))
        shape = Shape(mesh=MeshFile(file=folder / "ball.stl"))
    rigid.insert(0,
        RigidBodyDescription(
            name="ball", shape=shape, mass=0.03, velocity=tuple((case.speed * down).tolist()),
            pose=Placement(translation=turned(case.off * PLAY * out + (0.0, 0.0, LENGTH - 0.03))),
        )
    )  # fmt: skip
    pull = GRAVITY * (math.cos(case.tilt) * np.array([0.0, 0.0, -1.0]) + math.sin(case.tilt) * out)
    sim = Simulation(
        touching(
            *rigid, soft=tuple(soft), gravity=turned(pull), friction=0.0, backend=case.backend,
            contact={"alarm_distance": 0.003, "contact_distance": DISTANCE}, attachments=tuple(fixed),
            dt=case.dt,
        )
    )  # fmt: skip
    speeds, offs = [], []
    for _ in expected_speeds(case):
        place = np.array(sim.rigid_poses[0].position)
        speeds.append(down @ sim.rigid_velocities[0][:3])
        offs.append(np.linalg.norm(place - (down @ place) * down))
        sim.step()
    return np.array(speeds), np.array(offs)


def expected_speeds(case: Fall) -> Array:
    """Speeds in [m/s] of a free fall along the tube by implicit Euler, from the start on."""
    pull = GRAVITY * math.cos(case.tilt)
    speeds, way = [case.speed], 0.0
    while way < WAY and len(speeds) <= MOST_STEPS:
        speeds.append(speeds[-1] + case.dt * pull)
        way += case.dt * speeds[-1]
    return np.array(speeds)


def check(case: Fall, folder: Path) -> None:
    """Hold a case to the closed form; the flat faces of a ball of triangles let its centre off by more."""
    speeds, offs = fall(case, folder)
    expected = expected_speeds(case)
    assert np.abs(speeds - expected).max() < 0.01 * expected[-1], case
    ball = sphere_surface(RADIUS, REFINEMENTS)
    flat = RADIUS - np.linalg.norm(ball.points[ball.triangles].mean(axis=1), axis=1).min()
    sunk = 0.1 * DISTANCE + (flat if case.ball == "mesh" else 0.0)
    assert offs.max() < PLAY / math.cos(math.pi / AROUND) + sunk, case


def drawn(number: int) -> list[Fall]:
    """As many cases of each ball in each wall, drawn from a seed."""
    random = np.random.default_rng(27)
    cases = []
    for ball, wall in itertools.product(BALLS, WALLS):
        for _ in range(number):
            speed, dt, tilt = (float(random.choice(each)) for each in (SPEEDS, STEPS, TILTS))
            off, heading = float(random.uniform()), float(random.uniform(0.0, 2.0 * math.pi))
            cases.append(Fall(ball, wall, speed, dt, tilt, off, heading, TURNS[random.integers(len(TURNS))]))
    return cases


STRUCK = (
    Fall("mesh", "rigid", 0.0, 0.02, 0.7, 0.47130966518183137, 4.856179620594567, TURNS[1]),
    Fall("mesh", "held", 0.1, 0.01, 0.7, 0.20719116808100124, 3.956966454651954, TURNS[2]),
)
"""A ball that vertices of the wall ahead held up by 6 % of its speed, and one of too many pairs of edges."""


@pytest.mark.slow
@pytest.mark.parametrize("case", [*drawn(1), *STRUCK], ids=lambda case: f"{case.ball}-{case.wall}")
def test_a_ball_falls_freely_through_a_smooth_tube(case: Fall, tmp_path: Path) -> None:
    check(case, tmp_path)


@pytest.mark.exhaustive
@pytest.mark.parametrize("case", drawn(40), ids=lambda case: f"{case.ball}-{case.wall}")
def test_a_ball_falls_freely_whatever_the_tube(case: Fall, tmp_path: Path) -> None:
    check(case, tmp_path)
