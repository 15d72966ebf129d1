"""Flight, spin and landing of rigid bodies: free flight is exact, nothing is shot through."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from closed_forms import fall_height
from contact_scenes import DISTANCE, FLOOR, GRAVITY, loose, run, touching
from small_scenes import body, slab

from softsim_core import Simulation
from softsim_core.base import Box
from softsim_core.physics.mechanics import rotation_of
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.scene import AttachmentDescription


def spun(sim: Simulation, velocity: tuple[float, ...]) -> None:
    """Give the first free rigid body a velocity in [m/s] and a spin in [rad/s]."""
    sim._state.rigid_velocities[0] = velocity


def test_free_flight_is_as_implicit_euler_flies(backend: str) -> None:
    sim = Simulation(touching(FLOOR, loose("box", Shape(box=(0.02, 0.03, 0.04)), 1.0), backend=backend))
    spun(sim, (0.3, -0.2, 1.0, 0.0, 0.0, 0.0))
    for _ in range(40):
        sim.step()
    flown = 40 * sim.dt
    expected = (0.3 * flown, -0.2 * flown, 1.0 + flown - fall_height(GRAVITY, sim.dt, 40))
    assert sim.rigid_poses[1].position == pytest.approx(expected, abs=1e-12)
    assert sim.rigid_poses[1].quaternion_xyzw == pytest.approx((0.0, 0.0, 0.0, 1.0), abs=1e-12)


def tumbling(dt: float, steps: int) -> tuple[list[float], list[Any]]:
    """Energy in [J] and angular momentum about the centre (3,) of a tumbling box, step by step."""
    box = loose("box", Shape(box=(0.02, 0.03, 0.05)), 1.0, mass=0.1)
    sim = Simulation(touching(FLOOR, box, gravity=(0.0, 0.0, 0.0), dt=dt))
    spun(sim, (0.0, 0.0, 0.0, 3.0, 4.0, 2.0))
    inertia, energies, momenta = sim.model.rigid.inertia[0], [], []
    for _ in range(steps):
        rotation = rotation_of(sim.rigid_poses[1].quaternion_xyzw)
        spin = sim._state.rigid_velocities[0, 3:]
        momentum = rotation @ inertia @ rotation.T @ spin
        energies.append(0.5 * float(spin @ momentum))
        momenta.append(momentum)
        sim.step()
    return energies, momenta


@pytest.mark.slow
def test_a_tumbling_box_gains_no_energy_and_keeps_its_momentum_whatever_the_step() -> None:
    for dt, steps in ((0.01, 200), (0.001, 2000)):
        energies, momenta = tumbling(dt, steps)
        assert max(energies) <= energies[0] * (1.0 + 1e-6)
        drift = np.linalg.norm(np.subtract(momenta[-1], momenta[0])) / np.linalg.norm(momenta[0])
        assert drift < 1e-10


def test_a_box_spins_on_about_a_principal_axis_without_loss() -> None:
    box = loose("box", Shape(box=(0.02, 0.03, 0.05)), 1.0)
    sim = Simulation(touching(FLOOR, box, gravity=(0.0, 0.0, 0.0)))
    spun(sim, (0.0, 0.0, 0.0, 0.0, 0.0, 5.0))
    for _ in range(100):
        sim.step()
    assert sim._state.rigid_velocities[0] == pytest.approx((0, 0, 0, 0, 0, 5.0), abs=1e-12)
    turned = rotation_of(sim.rigid_poses[1].quaternion_xyzw)
    assert math.atan2(turned[1, 0], turned[0, 0]) == pytest.approx(5.0 - 2.0 * math.pi, abs=1e-9)


def plate_scene(backend: str = "auto") -> Any:
    """A ball of 20 mm above a silicone plate of 4 mm that is held at both ends."""
    mesh = box_mesh((0.08, 0.04, 0.004), (16, 8, 1), (-0.04, -0.02, -0.004))
    plate = body(mesh, "plate", young_modulus=2e5, total_mass=0.015)
    box = Box(center=(0.04, 0.0, 0.0), size=(0.006, 1.0, 1.0))
    held = AttachmentDescription(name="right", body="plate", to="world", box=box)
    ball = loose("ball", Shape(sphere=0.01), 0.015, mass=0.005)
    return touching(
        ball, soft=(plate,), attachments=(slab("left", "world", -0.04, "plate"), held), backend=backend
    )


@pytest.mark.parametrize("speed", [0.3, 1.0, 2.0, 3.0])
def test_a_ball_is_never_shot_through_a_soft_plate(speed: float) -> None:
    sim = Simulation(plate_scene())
    spun(sim, (0.0, 0.0, -speed, 0.0, 0.0, 0.0))
    touched = False
    for _ in range(60):
        sim.step()
        touched = touched or len(sim.contacts.points) > 0
        near = np.hypot(*(sim.positions[:, :2] - sim.rigid_poses[0].position[:2]).T) < 0.008
        assert sim.rigid_poses[0].position[2] > sim.positions[near, 2].min()
    assert touched


@pytest.mark.parametrize("shape", [Shape(sphere=0.01), Shape(box=(0.02, 0.02, 0.02))])
@pytest.mark.parametrize("speed", [1.0, 3.0])
def test_what_falls_fast_stops_at_the_contact_distance(shape: Shape, speed: float) -> None:
    sim = Simulation(touching(FLOOR, loose("thing", shape, 0.05)))
    spun(sim, (0.0, 0.0, -speed, 0.0, 0.0, 0.0))
    for _ in range(100):
        run(sim, 1)
        assert sim.rigid_poses[1].position[2] > 0.01 + 0.99 * DISTANCE
    assert sim.rigid_poses[1].position[2] == pytest.approx(0.01 + DISTANCE, abs=1e-6)


def test_what_is_thrown_farther_than_its_speed_told_is_caught() -> None:
    mesh = box_mesh((0.08, 0.04, 0.004), (16, 8, 1), (-0.04, -0.02, 0.007))
    plate = body(mesh, "plate", young_modulus=2e5, total_mass=0.015)
    sim = Simulation(touching(FLOOR, soft=(plate,), attachments=(slab("left", "world", -0.04, "plate"),)))
    sim.forces[:, 2] = -40.0 / len(sim.positions)  # from rest by 27 mm in the first step, were there no floor
    for _ in range(30):
        run(sim, 1)
        assert sim.positions[:, 2].min() > 0.5 * DISTANCE
