"""What falls never sinks in: cubes, rods and piles in any orientation, every step measured by brute force."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import DISTANCE, FLOOR, GRAVITY, touching
from small_scenes import body
from surface_gaps import smallest_gap

from softsim_core import Simulation
from softsim_core.base import Array, MeshFile, Placement
from softsim_core.physics.mechanics import rotation_euler, rotation_of
from softsim_core.physics.mesh import Shape, box_mesh, box_surface, write_surface
from softsim_core.scene import BodyDescription, RigidBodyDescription

Vector = tuple[float, float, float]
Spot = tuple[float, float]
Cells = tuple[int, int, int]

CUBE = (0.04, 0.04, 0.04)
ROD = (0.2, 0.006, 0.006)
MARGIN = 0.004
"""Alarm distance in [m] of these scenes, the default."""
EXACT = 1.0e-6
"""The reported smallest gap may differ by this much in [m] from that of brute force."""
AFTER = 0.4
"""Time in [s] that is watched from the impact on: blow, bounce, rest."""


def turned(seed: int) -> Array:
    """A random rotation (3, 3), all equally likely."""
    quaternion = np.random.default_rng(seed).normal(size=4)
    return rotation_of(quaternion / np.linalg.norm(quaternion))


def soft(
    seed: int, height: float, young_modulus: float, size: Vector = CUBE, cells: Cells = (3, 3, 3),
    name: str = "thing", mass: float = 0.05, aside: Spot = (0.0, 0.0), hexahedra: bool = False,
) -> BodyDescription:  # fmt: skip
    """A soft block at random orientation, its lowest corner `height` [m] above the floor."""
    mesh = box_mesh(size, cells, tuple(-0.5 * each for each in size), name, hexahedra=hexahedra)
    points = mesh.points @ turned(seed).T
    points += [*aside, height - points[:, 2].min()]
    return body(replace(mesh, points=points), name, young_modulus, 0.45, mass)


def rigid(
    seed: int,
    height: float,
    size: Vector = CUBE,
    name: str = "thing",
    aside: tuple[float, float] = (0.0, 0.0),
) -> RigidBodyDescription:
    """A rigid block at random orientation, its lowest corner `height` [m] above the floor."""
    rotation = turned(seed)
    below = float(np.abs(rotation[2]) @ np.array(size)) / 2.0
    angles = np.degrees(euler_of(rotation))
    pose = Placement(translation=(*aside, height + below), rotation_deg=tuple(angles.tolist()))
    return RigidBodyDescription(name=name, shape=Shape(box=size), mass=0.05, pose=pose)


def euler_of(rotation: Array) -> Array:
    """Angles (a, b, c) in [rad] of Rz(c) Ry(b) Rx(a)."""
    angles = np.array(
        [
            np.arctan2(rotation[2, 1], rotation[2, 2]),
            -np.arcsin(np.clip(rotation[2, 0], -1.0, 1.0)),
            np.arctan2(rotation[1, 0], rotation[0, 0]),
        ]
    )
    np.testing.assert_allclose(rotation_euler(angles), rotation, atol=1e-9)
    return angles


def watch(sim: Simulation, height: float, *, edges: bool = True) -> float:
    """Let things fall and settle; every step is measured. Returns the smallest gap seen in [m]."""
    pairs = [(i, j) for i in range(len(sim.collision_surfaces)) for j in range(i)]
    least, near = np.inf, 0
    for _ in range(int((np.sqrt(2.0 * height / GRAVITY) + AFTER) / sim.dt)):
        sim.step()
        report = sim.contacts
        gaps = [smallest_gap(sim, i, j) for i, j in pairs if boxes_near(sim, i, j)]
        if not gaps:
            continue
        vertices, whole = (min(each[k] for each in gaps) for k in (0, 1))
        assert vertices > 0.0
        assert whole > 0.0 or not edges
        if whole <= MARGIN - EXACT:
            assert report.gaps.min() + DISTANCE == pytest.approx(whole, abs=EXACT)
            near += 1
        least = min(least, whole)
    assert near > 0
    return float(least)


def boxes_near(sim: Simulation, i: int, j: int) -> bool:
    """Whether the boxes around two collision surfaces are within the alarm distance."""
    points, surfaces = sim.collision_points, sim.collision_surfaces
    a, b = points[surfaces[i].vertices], points[surfaces[j].vertices]
    apart = np.maximum(a.min(axis=0) - b.max(axis=0), b.min(axis=0) - a.max(axis=0))
    return bool(apart.max() < 1.5 * MARGIN)


def dropped(kind: str, seed: int, height: float, **fields: Any) -> Simulation:
    """A cube above the floor: "rigid", or "soft" with the Young modulus in [kPa]."""
    if kind == "rigid":
        return Simulation(touching(FLOOR, rigid(seed, height), **fields))
    return Simulation(touching(FLOOR, soft=(soft(seed, height, 1e3 * float(kind[4:])),), **fields))


@pytest.mark.parametrize(
    ("kind", "height", "seed"), [("soft30", 0.1, 100), ("soft10", 1.0, 101), ("rigid", 0.3, 102)]
)
def test_a_cube_stops_at_the_contact_distance(kind: str, height: float, seed: int) -> None:
    assert watch(dropped(kind, seed, height), height) > DISTANCE - EXACT


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("kind", ["soft30", "soft10", "rigid"])
@pytest.mark.parametrize("seeds", [1, pytest.param(20, marks=pytest.mark.exhaustive)])
def test_no_cube_ever_sinks_in(kind: str, height: float, seeds: int) -> None:
    for seed in range(seeds):
        assert watch(dropped(kind, seed, height), height) > DISTANCE - EXACT


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 1.0])
@pytest.mark.parametrize("dt", [0.005, 0.02])
@pytest.mark.parametrize("kind", ["soft30", "rigid"])
def test_neither_step_nor_friction_matter(kind: str, dt: float, friction: float) -> None:
    for seed in (200,):
        watch(dropped(kind, seed, 0.3, dt=dt, friction=friction), 0.3)


@pytest.mark.parametrize("seed", [400, 401])
def test_hexahedra_do_not_sink_in(seed: int, backend: str) -> None:
    cube = soft(seed, 0.2, 3e4, hexahedra=True)
    sim = Simulation(touching(FLOOR, soft=(cube,), backend=backend))
    assert sim.model.element(0).name == "hex8"
    assert watch(sim, 0.2) > DISTANCE - EXACT


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [1, pytest.param(2, marks=pytest.mark.exhaustive)])
def test_finer_meshes_do_not_sink_in(seeds: int) -> None:
    for seed in range(300, 300 + seeds):
        sim = Simulation(touching(FLOOR, soft=(soft(seed, 0.3, 3e4, cells=(5, 5, 5)),)))
        assert watch(sim, 0.3) > DISTANCE - EXACT


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["soft", "rigid"])
def test_planes_and_meshes_hold_as_boxes_do(kind: str, tmp_path: Any) -> None:
    file = tmp_path / "floor.stl"
    write_surface(file, box_surface((0.4, 0.4, 0.02)))
    below = Placement(translation=(0.0, 0.0, -0.01))
    plane = RigidBodyDescription(name="floor", shape=Shape(plane=(1.0, 1.0)))
    mesh = RigidBodyDescription(name="floor", shape=Shape(mesh=MeshFile(file=file)), pose=below)
    for floor in (plane, mesh):
        if kind == "rigid":
            sim = Simulation(touching(floor, rigid(400, 0.3)))
        else:
            sim = Simulation(touching(floor, soft=(soft(400, 0.3, 3e4),)))
        assert watch(sim, 0.3) > DISTANCE - EXACT


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.1, 1.0])
@pytest.mark.parametrize("kind", ["soft", "rigid"])
@pytest.mark.parametrize("seeds", [1, pytest.param(3, marks=pytest.mark.exhaustive)])
def test_what_falls_on_each_other_does_not_sink_in(kind: str, height: float, seeds: int) -> None:
    for seed in range(500, 500 + seeds):
        aside, above = (0.005, 0.003), height + 0.09
        if kind == "rigid":
            other = rigid(seed + 50, above, name="other", aside=aside)
            sim = Simulation(touching(FLOOR, rigid(seed, height), other))
        else:
            over = soft(seed + 50, above, 3e4, name="other", aside=aside)
            sim = Simulation(touching(FLOOR, soft=(soft(seed, height, 3e4), over)))
        watch(sim, height)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [1, pytest.param(4, marks=pytest.mark.exhaustive)])
def test_thin_rods_tumble_without_sinking_in(seeds: int) -> None:
    for seed in range(600, 600 + seeds):
        watch(Simulation(touching(FLOOR, rigid(seed, 0.3, ROD))), 0.3)
        rod = soft(seed, 0.3, 2e5, ROD, (20, 1, 1), mass=0.01)
        watch(Simulation(touching(FLOOR, soft=(rod,))), 0.3)
