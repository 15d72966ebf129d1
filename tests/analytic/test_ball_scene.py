"""The ball on the Tripod: rests in the hole, follows, rolls off; the silicone stays above the servo tops."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.physics.mechanics import rotation_of

RADIUS, CONTACT = 0.013, 0.0005
HOLE = 0.005
WEIGHT = 0.032 * 9.81
TOPS = (2, 3, 4)
"""Numbers of the servo tops among the collision surfaces."""


@pytest.fixture(scope="module")
def at_start() -> tuple[Simulation, bytes]:
    """The scene in the start pose, at rest."""
    simulation = Simulation(load_scene("tripod_ball"))
    simulation.start_animation()
    for _ in range(150):
        simulation.step()
    return simulation, simulation.snapshot()


@pytest.fixture
def simulation(at_start: tuple[Simulation, bytes]) -> Simulation:
    """The scene in the start pose, anew for every test."""
    simulation, snapshot = at_start
    simulation.restore(snapshot)
    simulation.enforce_limits = True
    return simulation


def above_hole(simulation: Simulation) -> np.ndarray:
    """Where the ball is from the effector, in its axes, in [m]."""
    pose = simulation.effector_pose
    assert pose is not None
    return rotation_of(pose.quaternion_xyzw).T @ (simulation.rigid_poses[0].position - pose.position)


def depth_in_tops(simulation: Simulation) -> float:
    """How deep the deepest silicone node is in a servo top, in [m]; negative: how far above or beside."""
    deepest = -np.inf
    for body, pose in zip(simulation.rigid_bodies, simulation.rigid_poses, strict=True):
        if body.name.startswith("servo_top"):
            half = body.surface.points.max(axis=0)
            local = (simulation.positions - pose.position) @ rotation_of(pose.quaternion_xyzw)
            deepest = max(deepest, float((half - np.abs(local)).min(axis=1).max()))
    return deepest


@pytest.mark.slow
def test_the_ball_rests_in_the_hole(simulation: Simulation) -> None:
    simulation.step()
    ball = above_hole(simulation)
    np.testing.assert_allclose(ball[:2], 0.0, atol=1e-6)
    reach = RADIUS + CONTACT  # it sits on the rim of the hole, whose polygon cuts a little below its circle
    lowest, highest = np.sqrt(reach**2 - (HOLE * 1.05) ** 2), reach
    assert lowest - 2e-4 < ball[2] < highest
    contacts = simulation.contacts
    np.testing.assert_allclose(contacts.forces.sum(axis=0), [0.0, 0.0, -WEIGHT], atol=1e-3 * WEIGHT)
    assert contacts.residual < 1e-6
    assert contacts.gaps.min() > -CONTACT


@pytest.mark.slow
def test_the_ball_follows_the_plate(simulation: Simulation) -> None:
    for pose, height in (("mid", 0.05), ("high", 0.06), ("start", 0.035)):
        simulation.command(simulation.robot.poses[pose])
        for _ in range(200):
            simulation.step()
        np.testing.assert_allclose(above_hole(simulation)[:2], 0.0, atol=1e-4)
        assert simulation.rigid_poses[0].position[2] > height


@pytest.mark.slow
def test_a_small_tilt_holds_the_ball_and_a_large_one_lets_it_go(simulation: Simulation) -> None:
    start = simulation.robot.poses["start"]
    simulation.command([-1.2, *start[1:]])
    for _ in range(200):
        simulation.step()
    assert np.linalg.norm(above_hole(simulation)[:2]) < HOLE
    simulation.command([-0.6, *start[1:]])
    for _ in range(60):
        simulation.step()
    left = above_hole(simulation)
    assert np.linalg.norm(left) > 2.0 * RADIUS  # servo 0 is at -x: the plate falls off to +x
    assert simulation.rigid_poses[0].position[0] > 0.02


def test_the_ball_comes_to_lie_on_the_table(simulation: Simulation) -> None:
    start = simulation.robot.poses["start"]
    simulation.command([-0.6, *start[1:]])
    lowest = np.inf
    for _ in range(80):
        simulation.step()
        lowest = min(lowest, simulation.rigid_poses[0].position[2])
    assert lowest == pytest.approx(-0.024 + RADIUS + CONTACT, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [-2.0225, pytest.param(-3.0, marks=pytest.mark.exhaustive)])
def test_the_silicone_does_not_pass_through_the_servo_tops(simulation: Simulation, angle: float) -> None:
    simulation.enforce_limits = angle >= -2.0225
    simulation.command([angle] * 3)
    touched, deepest, residual = set(), -np.inf, 0.0
    for _ in range(150):
        simulation.step()
        touched |= set(simulation.contacts.pairs[simulation.contacts.forces.any(axis=1)][:, 1].tolist())
        deepest = max(deepest, depth_in_tops(simulation))
        residual = max(residual, simulation.contacts.residual)
    assert touched >= set(TOPS)
    assert deepest < 0.0
    assert residual < 1e-6


def test_without_tops_it_would(simulation: Simulation) -> None:
    """The same command on the bare robot leads through the place of the tops: the contact holds it off."""
    bare = Simulation(load_scene("tripod"))
    bare.start_animation()
    for _ in range(30):
        bare.step()
    bare.command([-2.0225] * 3)
    for _ in range(150):
        bare.step()
    top = simulation.rigid_poses[1].position[2] + 0.004
    over = np.linalg.norm(bare.positions[:, :2], axis=1) < 0.025
    assert bare.positions[over, 2].min() < top - 0.004


def test_the_tops_move_in_with_the_servos() -> None:
    simulation = Simulation(load_scene("tripod_ball"), backend="scipy")
    simulation.base_shift = 0.035
    simulation.step()
    frames = simulation.frames()
    for k in range(3):
        expected = np.add(frames[f"servo_{k}"].position, [0.0, 0.0, 0.0075])
        np.testing.assert_allclose(simulation.rigid_poses[1 + k].position, expected, atol=1e-12)
        surface = simulation.collision_surfaces[TOPS[k]]
        middle = simulation.collision_points[surface.vertices].mean(axis=0)
        np.testing.assert_allclose(middle, expected, atol=1e-12)
        assert np.linalg.norm(middle[:2]) == pytest.approx(0.025)


@pytest.mark.slow
def test_the_same_bytes_twice(simulation: Simulation) -> None:
    before, states = simulation.snapshot(), []
    for _ in range(2):
        simulation.restore(before)
        simulation.command([-0.8, -1.4, -1.4965])
        for _ in range(40):
            simulation.step()
        states.append(simulation.snapshot())
    assert states[0] == states[1]
