"""The ball follows the plan through the maze while inverse control drives the Tripod."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import Array
from softsim_core.control.inverse import InverseController, find_path, maze_path, read_maze_plan
from softsim_core.physics.mechanics import rotation_of

PLATE = np.array([0.0, 0.0, 0.005])
GOAL = np.array([0.0252857, -0.0252857])
CORRIDOR = 0.0037143
"""Half the width of a corridor in [m]."""


def ball_on_plate(simulation: Simulation) -> Array:
    """Centre of the ball in the plate's frame in [m], shape (3,)."""
    effector = simulation.effector_pose
    assert effector is not None
    turn = rotation_of(np.asarray(effector.quaternion_xyzw))
    return np.asarray(turn.T @ (simulation.rigid_poses[1].position - effector.position) - PLATE)


@pytest.mark.slow
@pytest.mark.numba
def test_the_ball_reaches_the_goal_and_never_falls_through() -> None:
    pytest.importorskip("numba")
    scene = load_scene("tripod_maze")
    simulation = Simulation(scene)
    simulation.start_animation()
    for _ in range(100):
        simulation.step()
    controller = InverseController(scene.with_scene(rigid_bodies=(), collisions=()))  # it knows of no ball
    controller.start(simulation.joint_positions, simulation.base_shift)
    effector = simulation.effector_pose
    assert effector is not None
    path = maze_path(read_maze_plan(find_path("tripod_maze")), effector.position)
    start = ball_on_plate(simulation)
    np.testing.assert_allclose(start[:2], [-GOAL[0], GOAL[1]], atol=CORRIDOR)
    for tick in range(round(path.duration / simulation.dt) + 50):
        controller.set_goal(path.sample(min(tick * simulation.dt, path.duration)))
        simulation.command(controller.tick(simulation.effector_pose).command)
        simulation.step()
        assert 0.0019 < ball_on_plate(simulation)[2] < 0.0039
    np.testing.assert_allclose(ball_on_plate(simulation)[:2], GOAL, atol=CORRIDOR)
