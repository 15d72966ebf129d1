"""The shipped robots of quadratic elements: they bend as finer meshes do, rest, grasp, and reach goals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softsim_core import MeshFile, Simulation, load_scene
from softsim_core.base import Array
from softsim_core.control.inverse import InverseController
from softsim_core.scene import RobotDescription

MESHES = Path(__file__).resolve().parents[2] / "configs" / "meshes"
POSES = ((-0.785,) * 3, (-1.0467,) * 3, (-1.0467, -1.3, -0.8), (-1.25,) * 3)
PULLS = ((0.0,), (0.005,), (0.01,), (0.015,), (0.02,))


def with_mesh(robot: RobotDescription, name: str) -> RobotDescription:
    """The robot with another mesh of its one body."""
    (body,) = robot.scene.bodies
    assert isinstance(body.mesh, MeshFile)
    bodies = (replace(body, mesh=replace(body.mesh, file=MESHES / f"{name}.vtk")),)
    return replace(robot, scene=replace(robot.scene, bodies=bodies))


def resting_places(robot: RobotDescription, commands: tuple[tuple[float, ...], ...]) -> Array:
    """Where the effector rests under each command in [m], shape (k, 3)."""
    simulation = Simulation(robot)
    places = []
    for command in commands:
        simulation.settle(command)
        assert simulation.effector_pose is not None
        places.append(simulation.effector_pose.position)
    return np.array(places)


@pytest.mark.parametrize(
    ("name", "finer", "linear", "commands", "near"),
    [
        ("tripod_quadratic", "tripod_low", "tripod", POSES, 0.3e-3),
        ("cable_finger_quadratic", "finger_low", "cable_finger", PULLS, 2.0e-3),
    ],
)
@pytest.mark.slow
def test_few_quadratic_cells_rest_where_many_do(
    name: str, finer: str, linear: str, commands: tuple[tuple[float, ...], ...], near: float
) -> None:
    robot = load_scene(name)
    reference = resting_places(with_mesh(robot, finer), commands)
    away = np.linalg.norm(resting_places(robot, commands) - reference, axis=1)
    assert away.max() < near
    locked = np.linalg.norm(resting_places(load_scene(linear), commands) - reference, axis=1)
    assert locked.max() > 2.0 * away.max()


@pytest.mark.parametrize("dt", [0.002, 0.01])
@pytest.mark.slow
def test_the_pulled_finger_comes_to_rest(dt: float) -> None:
    robot = load_scene("cable_finger_quadratic")
    robot = replace(robot, scene=replace(robot.scene, dt=dt))
    simulation = Simulation(robot)
    simulation.command([0.01])
    for _ in range(round(3.0 / dt)):
        simulation.step()
    (rest,) = resting_places(robot, ((0.01,),))
    assert simulation.effector_pose is not None
    assert np.linalg.norm(simulation.effector_pose.position - rest) < 2e-4


@pytest.mark.slow
def test_the_gripper_lifts_the_cube_and_puts_it_down() -> None:
    """Commands as a grasp sends them: lower, close, lift, hold, put down, open."""
    simulation = Simulation(load_scene("cable_gripper_quadratic"))
    times = (0.5, 2.0, 3.0, 3.5, 4.5, 6.5, 8.0, 9.0)
    pulls = (0.0, 0.0, 0.012, 0.012, 0.012, 0.012, 0.012, 0.0)
    heights = (0.0, -0.05, -0.05, -0.05, -0.02, -0.02, -0.05, -0.05)
    cube = 1  # behind the floor
    at = {}
    for step in range(900):
        time = step * simulation.dt
        pull, height = (float(np.interp(time, times, values)) for values in (pulls, heights))
        simulation.command([pull, pull, pull, height, 0.0])
        simulation.step()
        at[step] = simulation.rigid_poses[cube].position
    assert at[499][2] - at[100][2] > 0.025
    assert np.linalg.norm(at[649] - at[499]) < 1e-3
    assert at[899][2] - at[100][2] < 1e-3


@pytest.mark.slow
def test_inverse_control_leads_the_tripod_to_a_goal() -> None:
    pytest.importorskip("daqp")
    robot = load_scene("tripod_quadratic")
    there = Simulation(robot)
    there.settle((-1.0, -1.15, -0.9))
    goal = there.effector_pose
    assert goal is not None
    controller = InverseController(robot)
    controller.start(POSES[1])
    controller.set_goal(goal)
    for _ in range(100):
        report = controller.tick()
        if report.status == "reached":
            break
    assert report.residual_m < 1e-4
