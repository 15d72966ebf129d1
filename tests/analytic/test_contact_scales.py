"""Contact does not depend on the size of a scene: the same scene, smaller or larger, moves in proportion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from softsim_core import Simulation
from softsim_core.base import Array, Placement
from softsim_core.physics.contact import CollisionSurface, ContactSettings, surfaces_cross
from softsim_core.physics.contact.detection import Detector, Proximities
from softsim_core.physics.mechanics import rotation_euler
from softsim_core.physics.mesh import Shape, box_mesh, box_surface
from softsim_core.scene import (
    BodyDescription,
    CollisionDescription,
    MaterialDescription,
    RigidBodyDescription,
    SceneDescription,
    SolverSettings,
)

STEPS = 60
BLOCK = 0.004
"""Height in [m] of the block, from which on the defaults of `contact` grow no more."""
DISTANCES = ("alarm_distance", "contact_distance", "tolerance")
pytestmark = pytest.mark.filterwarnings("ignore:.* lengths are in m", "ignore:.* moduli are in Pa")


def blocks(scale: float, contact: ContactSettings) -> SceneDescription:
    """A soft block that falls askew on a floor, and a cube and a ball that fall on it.

    Times stay: lengths and gravity are scaled by `scale`, moduli by its square, masses by its cube.
    """
    s = scale
    mesh = box_mesh((0.012 * s, 0.008 * s, BLOCK * s), (3, 2, 1), (0.0, 0.0, 0.0), "soft")
    tilted = mesh.points @ rotation_euler(np.radians([8.0, 5.0, 0.0])).T + (0.0, 0.0, 0.004 * s)
    soft = BodyDescription(
        name="soft",
        mesh=replace(mesh, points=tilted),
        material=MaterialDescription(young_modulus=2e4 * s**2, poisson_ratio=0.4),
        density=1000.0,
        velocity=(0.05 * s, 0.0, 0.0),
    )
    shapes = {"cube": Shape(box=(BLOCK * s,) * 3), "ball": Shape(sphere=0.5 * BLOCK * s)}
    places = {"cube": (0.003 * s, 0.004 * s, 0.0135 * s), "ball": (0.0085 * s, 0.004 * s, 0.0135 * s)}
    loose = [
        RigidBodyDescription(
            name=name, shape=shape, mass=1e-4 * s**3, pose=Placement(translation=places[name])
        )
        for name, shape in shapes.items()
    ]
    floor = RigidBodyDescription(
        name="floor",
        shape=Shape(box=(0.2 * s, 0.2 * s, 0.004 * s)),
        pose=Placement(translation=(0.0, 0.0, -0.002 * s)),
    )
    return SceneDescription(
        name="blocks",
        dt=0.002,
        gravity=(0.0, 0.0, -9.81 * s),
        solver=SolverSettings(rayleigh_stiffness=0.002),
        bodies=(soft,),
        rigid_bodies=(floor, *loose),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in ("soft", "floor", *shapes)),
        contact=contact,
    )


def motion(scale: float, contact: ContactSettings) -> tuple[Array, Array, int]:
    """Positions at some steps over the scale, largest gap error over it, and contacts with a force."""
    simulation, seen, held, least = Simulation(blocks(scale, contact)), [], 0, 0.0
    for step in range(STEPS):
        simulation.step()
        report = simulation.contacts
        held += int(report.forces.any(axis=1).sum())
        least = min(least, float(report.gaps.min(initial=0.0)))
        if step % 5 == 4:
            state = simulation._state
            seen.append(np.concatenate([state.positions.ravel(), state.rigid_positions.ravel()]) / scale)
    return np.array(seen), np.array(least / scale), held


def scaled(contact: ContactSettings, scale: float) -> ContactSettings:
    named = {name: getattr(contact.limits(), name) * scale for name in DISTANCES}
    return ContactSettings(**named)


@pytest.fixture(scope="module")
def usual() -> tuple[Array, Array, int]:
    return motion(1.0, ContactSettings())


@pytest.mark.parametrize("scale", [0.25, 0.01])
def test_a_smaller_scene_moves_in_proportion(scale: float, usual: tuple[Array, Array, int]) -> None:
    found, gap, held = motion(scale, ContactSettings())
    assert held > 100
    assert found == pytest.approx(usual[0], abs=1e-6)
    assert gap == pytest.approx(usual[1], abs=1e-7)


@pytest.mark.parametrize("scale", [0.001, 10.0])
def test_a_scene_with_scaled_distances_moves_in_proportion(
    scale: float, usual: tuple[Array, Array, int]
) -> None:
    found, gap, _ = motion(scale, scaled(ContactSettings(), scale))
    assert found == pytest.approx(usual[0], abs=1e-6)
    assert gap == pytest.approx(usual[1], abs=1e-7)


SIZES = [2.0**-20, 2.0**-10, 1.0, 2.0**3]
"""Powers of two, so that coordinates are exactly in proportion."""


def touching_cubes(scale: float) -> tuple[Detector, Array]:
    """Two scaled cubes of 10 mm in squares, one turned with a corner beside an edge of the other."""
    cube = box_surface((0.01, 0.01, 0.01), 4)
    turned = cube.points @ rotation_euler(np.radians([45.0, 20.0, 30.0])).T
    lifted = turned - turned[turned[:, 2].argmin()] + np.array([0.0052, 0.0011, 0.0051])
    points, size = scale * np.concatenate([cube.points, lifted]), len(cube.points)
    surfaces = tuple(
        CollisionSurface(
            name=f"cube {k}",
            vertices=slice(k * size, (k + 1) * size),
            triangles=cube.triangles + k * size,
            owner=k,
        )
        for k in range(2)
    )
    return Detector(surfaces, points, ContactSettings().limits(scale * BLOCK)), points


def gaps(scale: float) -> Proximities:
    detector, points = touching_cubes(scale)
    return detector.candidates(points, 0.003 * scale)


@pytest.mark.parametrize("scale", SIZES)
def test_what_comes_close_does_not_depend_on_size(scale: float) -> None:
    found, usual = gaps(scale), gaps(1.0)
    assert len(found.key) > 15
    assert np.array_equal(found.key, usual.key)
    assert np.array_equal(found.foremost, usual.foremost)
    assert found.distance / scale == pytest.approx(usual.distance, abs=1e-12)
    assert found.normal == pytest.approx(usual.normal, abs=1e-9)


@pytest.mark.parametrize("scale", SIZES)
def test_whether_surfaces_cross_does_not_depend_on_size(scale: float) -> None:
    """Cubes that touch do not; those that overlap by a thousandth of their edge do."""
    cube = box_surface((0.01, 0.01, 0.01), 2)
    corners = scale * cube.points[cube.triangles]
    up = np.array([0.3, 0.4, 1.0])
    for depth, crosses in ((0.0, False), (1e-3, True)):
        assert surfaces_cross(corners, corners + scale * 0.01 * (1.0 - depth) * up) is crosses
