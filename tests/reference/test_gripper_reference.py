"""Three fingers on the reference meshes: notch walls meet and do not cross; random commands end finite."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import Box, MeshFile, Placement
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    CollisionDescription,
    JointDescription,
    MaterialDescription,
    SceneDescription,
    SolverSettings,
)

MILLIMETRES = Placement(scale=1e-3)


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Slivers of the reference's mesh are no news."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def finger(data: Path, distance: float) -> SceneDescription:
    """The finger with its notch walls as two collision surfaces, at rest `distance` [m] apart."""
    folder = data / "data" / "cable_gripper"
    cable = CableDescription(
        body="finger", points=folder / "cable.json", placement=MILLIMETRES, pull_point=(0.0, 0.0, 0.0)
    )
    walls = tuple(
        CollisionDescription(
            name=f"wall_{k}",
            body="finger",
            surface=MeshFile(file=folder / f"fingerCollision_part{k}.stl", placement=MILLIMETRES),
            groups=(str(k),),
        )
        for k in (1, 2)
    )
    mesh = MeshFile(file=folder / "finger.vtk", placement=MILLIMETRES)
    material = MaterialDescription(young_modulus=18e6, poisson_ratio=0.3)
    base = Box(center=(0.0, 0.005, 0.01), size=(0.010, 0.030, 0.020))
    return SceneDescription(
        name="finger",
        gravity=(0.0, -0.981, 0.0),
        solver=SolverSettings(rotation="qr"),
        bodies=(
            BodyDescription(
                name="finger", mesh=mesh, material=material, total_mass=0.5, mass_distribution="equal"
            ),
        ),
        joints=(JointDescription(name="cable", kind="cable", limits=JointLimits(0.0, 0.1), actuator=cable),),
        attachments=(AttachmentDescription(name="base", body="finger", to="world", box=base),),
        collisions=walls,
        contact=ContactSettings(alarm_distance=0.004, contact_distance=distance, friction=0.08),
    )


def pulled(sim: Simulation, travel: float) -> int:
    """Pull the cable by `travel` [m] and hold it; the most contacts that ever bore a force."""
    touched = 0
    for k in range(240):
        sim.command([travel * min(1.0, (k + 1) / 200)])
        sim.step()
        touched = max(touched, int(sim.contacts.forces.any(axis=1).sum()))
        assert sim.contacts.residual < 1e-6
        assert sim.contacts.gaps.min(initial=0.0) > -1e-3 * sim.contact_limits.contact_distance
        assert sim.joint_efforts[0] >= 0.0
        if sim.collision_surfaces:
            assert sim._contacts.near(sim.collision_points, 0.004).distance.min(initial=1.0) > 0.0
    return touched


@pytest.mark.slow
@pytest.mark.parametrize(
    ("distance", "travel"), [(0.003, 0.040), pytest.param(0.001, 0.060, marks=pytest.mark.exhaustive)]
)
def test_notch_walls_touch_and_do_not_cross_at_full_pull(
    reference_dir: Path, distance: float, travel: float
) -> None:
    scene = finger(reference_dir, distance)
    sim, free = Simulation(scene), Simulation(replace(scene, collisions=()))
    assert pulled(sim, travel) >= 4
    assert pulled(free, travel) == 0
    assert np.abs(free.positions - sim.positions).max() > 1e-4  # it is the walls that stop it


@pytest.mark.slow
@pytest.mark.parametrize("steps", [400, pytest.param(10_000, marks=pytest.mark.exhaustive)])
def test_random_commands_on_the_gripper_are_solved_and_end_finite(steps: int) -> None:
    sim = Simulation(load_scene("cable_gripper", kind="robots"))
    random = np.random.default_rng(11)
    low = np.array([0.0, 0.0, 0.0, -0.055, -0.05])
    high = np.array([0.035, 0.035, 0.035, 0.05, 0.05])
    for step in range(steps):
        if step % 25 == 0:
            sim.command(random.uniform(low, high))
        sim.step()
        assert sim.contacts.residual < 1e-6
    assert np.isfinite(sim.positions).all()
    assert np.isfinite(sim.joint_efforts).all()
    assert (sim.joint_efforts[:3] >= 0.0).all()
    assert np.abs(sim.positions).max() < 1.0
