"""The gripper on the arm picks and places: the plan of the demo, step by step, without ROS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from softsim_core import RobotDescription, Simulation, load_scene
from softsim_core.physics.contact import PairFriction
from softsim_ros.cli.demos import AWAY, objects_of, way_of

RUNS = 20


def drawn(seed: int) -> RobotDescription:
    """The demo with objects of 10 to 80 g, and friction of 0.5 to 1.0 between them and the fingers."""
    rng, robot = np.random.default_rng(seed), load_scene("pick_and_place")
    objects = list(objects_of(robot))
    mass, friction = (dict(zip(objects, rng.uniform(*between, len(objects)).tolist(), strict=True))
                      for between in ((0.010, 0.080), (0.5, 1.0)))  # fmt: skip
    fingers = [body.name for body in robot.scene.bodies]
    pairs = tuple(
        PairFriction(between=(finger, name), friction=friction[name])
        for finger in fingers
        for name in objects
    )
    bodies = tuple(replace(each, mass=mass.get(each.name)) for each in robot.scene.rigid_bodies)
    contact = replace(robot.scene.contact, friction_pairs=pairs)
    return robot.with_scene(rigid_bodies=bodies, contact=contact)


def misses(robot: RobotDescription) -> dict[str, float]:
    """How far each object ends from its place, across and up, in [m]."""
    simulation = Simulation(robot)
    way = way_of(robot)
    start = simulation.joint_positions
    times = np.array([0.0, *(time for time, _ in way)])
    positions = np.array([start, *([where[name] for name in robot.joint_names] for _, where in way)])
    while simulation.time < times[-1]:
        now = simulation.time + simulation.dt
        simulation.command([float(np.interp(now, times, column)) for column in positions.T])
        simulation.step()
    numbers = {
        name: robot.scene.body_names.index(name) - len(robot.scene.bodies) for name in objects_of(robot)
    }
    return {
        name: float(np.linalg.norm(simulation.rigid_poses[numbers[name]].position - start - AWAY))
        for name, start in objects_of(robot).items()
    }


@pytest.mark.exhaustive
def test_objects_of_any_weight_and_friction_are_moved() -> None:
    failed = {}
    for seed in range(RUNS):
        missed = misses(drawn(seed))
        failed |= {f"{seed} {name}": miss for name, miss in missed.items() if miss > 0.015}
        print(seed, {name: round(1e3 * miss, 1) for name, miss in missed.items()}, flush=True)
    assert not failed
