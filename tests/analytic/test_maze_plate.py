"""The maze on a plate of its own: hinges on a slide carry it, and the plan leads the ball to the goal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.control.inverse import tilt_rotation
from softsim_core.physics.mechanics import rotation_of
from softsim_core.scene import JointDescription

GOAL = np.array([0.0252857, -0.0252857])
CORRIDOR = 0.0037143
"""Half the width of a corridor in [m]."""
REST = 0.0025
"""Radius of the ball and contact distance in [m]."""


def run() -> tuple[Simulation, np.ndarray]:
    """The scene after its plan, and the ball in the plate's frame at every step in [m], shape (k, 3)."""
    simulation = Simulation(load_scene("maze_plate"))
    track = []
    for _ in range(1200):
        simulation.step()
        plate, ball = simulation.rigid_poses
        turn = rotation_of(plate.quaternion_xyzw)
        track.append(turn.T @ (ball.position - plate.position))
    return simulation, np.array(track)


@pytest.mark.slow
def test_the_plan_leads_the_ball_to_the_goal() -> None:
    simulation, track = run()
    np.testing.assert_allclose(track[-1, :2], GOAL, atol=CORRIDOR)
    assert track[:, 2].min() > REST - 1e-4
    assert track[:, 2].max() < REST + 1e-3
    again, _ = run()
    assert again.snapshot() == simulation.snapshot()


def test_a_hinge_on_a_hinge_on_a_slide() -> None:
    scene = replace(load_scene("maze_plate"), controllers=())
    simulation = Simulation(scene)
    simulation.command([0.01, 0.3, -0.2])
    simulation.step()
    plate = simulation.rigid_poses[0]
    np.testing.assert_allclose(plate.position, [0.0, 0.0, 0.05], atol=1e-12)
    np.testing.assert_allclose(rotation_of(plate.quaternion_xyzw), tilt_rotation(0.3, -0.2), atol=1e-12)
    motion_subspace = simulation.model.motion_subspace(simulation._state)
    np.testing.assert_allclose(motion_subspace.angular[2], tilt_rotation(0.3, 0.0)[:, 1], atol=1e-12)
    np.testing.assert_allclose(motion_subspace.origin[2], plate.position, atol=1e-12)


def test_an_arm_on_a_hinge_swings_round_it() -> None:
    """A second hinge, 0.1 m along the arm of the first one, at right angles to it."""
    arm = JointDescription(name="shoulder", axis=(0.0, 0.0, 1.0))
    hand = JointDescription(name="elbow", parent="shoulder", axis=(0.0, 1.0, 0.0), rest=0.1)
    hand = replace(hand, base=replace(hand.base, translation=(0.1, 0.0, 0.0)))
    scene = load_scene("maze_plate")
    rigid = tuple(
        replace(each, on="elbow" if each.mass is None else "world") for each in scene.scene.rigid_bodies
    )
    physics = replace(scene.scene, joints=(arm, hand), rigid_bodies=rigid, collisions=())
    simulation = Simulation(physics)
    simulation.command([0.5 * np.pi, 0.1])
    simulation.step()
    np.testing.assert_allclose(simulation.frames()["elbow"].position, [0.0, 0.1, 0.0], atol=1e-12)
    axis = simulation.model.motion_subspace(simulation._state).angular[1]
    np.testing.assert_allclose(axis, [-1.0, 0.0, 0.0], atol=1e-12)
