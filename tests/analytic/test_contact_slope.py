"""What slides on a slope, which way, and how fast: Coulomb's law against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from contact_scenes import DISTANCE, FLOOR, GRAVITY, downhill, force_on, loose, run, touching
from small_scenes import body

from softsim_core import Simulation
from softsim_core.physics.mesh import Shape, box_mesh

FRICTION = 0.3
BLOCK = loose("block", Shape(box=(0.04, 0.04, 0.04)), 0.02 + DISTANCE)


def angle_of(steepness: float) -> float:
    """Angle in [rad] whose tangent is `steepness` times the friction coefficient."""
    return math.atan(steepness * FRICTION)


def test_a_block_rests_just_below_the_friction_angle(backend: str) -> None:
    scene = touching(FLOOR, BLOCK, gravity=downhill(angle_of(0.99)), friction=FRICTION, backend=backend)
    sim = Simulation(scene)
    run(sim, 200)
    assert np.abs(sim.rigid_poses[1].position - (0.0, 0.0, 0.021)).max() < 1e-6


def test_a_block_slides_just_above_it_with_what_friction_leaves(backend: str) -> None:
    angle = angle_of(1.01)
    sim = Simulation(touching(FLOOR, BLOCK, gravity=downhill(angle), friction=FRICTION, backend=backend))
    run(sim, 200)
    acceleration = GRAVITY * (math.sin(angle) - FRICTION * math.cos(angle))
    slid = acceleration * sim.dt**2 * 200 * 201 / 2  # as implicit Euler falls
    assert sim.rigid_poses[1].position[0] == pytest.approx(slid, rel=1e-2)


@pytest.mark.parametrize("heading", [0.0, 0.4, 2.0, -1.1])
def test_friction_points_against_the_slip(heading: float) -> None:
    sim = Simulation(touching(FLOOR, BLOCK, gravity=downhill(0.5, heading), friction=FRICTION))
    run(sim, 60)
    way = np.array([math.cos(heading), math.sin(heading)])
    moved = sim.rigid_poses[1].position[:2]
    assert moved / np.linalg.norm(moved) == pytest.approx(way, abs=1e-3)
    force = force_on(sim, "block", "floor")
    weight = 0.03 * GRAVITY * math.cos(0.5)
    assert force[2] == pytest.approx(weight, rel=1e-3)
    assert force[:2] == pytest.approx(-FRICTION * weight * way, rel=2e-3, abs=1e-4)


def soft_block_speed(steepness: float, steps: int, since: int) -> tuple[float, float]:
    """Mean downhill velocity in [m/s] of a soft block after `steps`, and its gain since step `since`."""
    mesh = box_mesh((0.04, 0.04, 0.02), (4, 4, 2), (-0.02, -0.02, DISTANCE))
    scene = touching(
        FLOOR,
        soft=(body(mesh, "block", young_modulus=1e5, total_mass=0.03),),
        gravity=downhill(angle_of(steepness)),
        friction=FRICTION,
        rayleigh_stiffness=0.01,
    )
    sim = Simulation(scene)
    run(sim, since)
    mean = np.average(sim.velocities[:, 0], weights=sim.model.mass)
    run(sim, steps - since)
    now = np.average(sim.velocities[:, 0], weights=sim.model.mass)
    assert sim.positions[:, 2].min() > 0.0
    return float(now), float(now - mean)


def test_a_soft_block_rests_below_the_friction_angle() -> None:
    speed, _ = soft_block_speed(0.95, 150, 100)
    assert abs(speed) < 1e-6


def test_a_soft_block_slides_above_it() -> None:
    angle = angle_of(1.05)
    _, gained = soft_block_speed(1.05, 150, 100)
    acceleration = GRAVITY * (math.sin(angle) - FRICTION * math.cos(angle))
    assert gained == pytest.approx(acceleration * 0.01 * 50, rel=0.02)


def test_a_ball_rolls_and_does_not_slide(backend: str) -> None:
    angle, radius = 0.3, 0.02  # tan 0.3 = 0.31: steeper than a block would rest, flatter than 7/2 mu
    ball = loose("ball", Shape(sphere=radius), radius + DISTANCE)
    sim = Simulation(touching(FLOOR, ball, gravity=downhill(angle), friction=FRICTION, backend=backend))
    run(sim, 60)
    rolled = 5.0 / 7.0 * GRAVITY * math.sin(angle) * sim.dt**2 * 60 * 61 / 2
    assert sim.rigid_poses[1].position[0] == pytest.approx(rolled, rel=1e-3)
    force = force_on(sim, "ball", "floor")
    assert np.hypot(*force[:2]) == pytest.approx(2.0 / 7.0 * 0.03 * GRAVITY * math.sin(angle), rel=1e-3)


def test_a_ball_slips_where_it_is_too_steep_to_roll() -> None:
    angle, radius = 0.9, 0.02  # tan 0.9 = 1.26 > 7/2 mu = 1.05
    ball = loose("ball", Shape(sphere=radius), radius + DISTANCE)
    sim = Simulation(touching(FLOOR, ball, gravity=downhill(angle), friction=FRICTION))
    run(sim, 40)
    acceleration = GRAVITY * (math.sin(angle) - FRICTION * math.cos(angle))
    assert sim.rigid_poses[1].position[0] == pytest.approx(acceleration * sim.dt**2 * 40 * 41 / 2, rel=1e-3)
