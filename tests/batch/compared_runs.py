"""Copies beside single runs: `python compared_runs.py SCENE WORKERS` ends with 1 where bytes differ."""

from __future__ import annotations

import sys

import numpy as np

from softsim_core import Batch, RobotDescription, Simulation, load_scene
from softsim_core.base import Array

COPIES = 3
SCENES = {  # what is commanded: lowest and highest, by joint
    "tripod_ball": ([-1.6] * 3, [-0.4] * 3),
    "cable_gripper": ([0.0, 0.0, 0.0, -0.05, -0.01], [0.02, 0.02, 0.02, -0.02, 0.01]),
    "pneu_finger": (None, None),
}


def commands(robot: RobotDescription, name: str, seed: int, count: int) -> Array:
    """Random commands in the range of a scene, shape (count, COPIES, j)."""
    low, high = SCENES[name]
    limits = [joint.limits for joint in robot.joints]
    low = [each.lower for each in limits] if low is None else low
    high = [each.lower + 0.3 * (each.upper - each.lower) for each in limits] if high is None else high
    return np.random.default_rng(seed).uniform(low, high, (count, COPIES, len(robot.joints)))


def same_bytes(name: str, workers: int, rounds: int = 10) -> bool:
    """Whether copies, of which one is stiffer, are where single runs are, and something touches there."""
    robot = load_scene(name)
    modulus, value = next(iter(robot.scene.bodies[0].material.values.items()))
    stiffer = {modulus: 1.3 * value}
    singles = [Simulation(robot) for _ in range(COPIES)]
    touched = not robot.scene.collisions
    with Batch(robot, COPIES, workers) as batch:
        singles[1].set_material(robot.scene.bodies[0].name, **stiffer)
        batch.call(1, "set_material", robot.scene.bodies[0].name, **stiffer)
        for rows in commands(robot, name, 1, rounds):
            accepted = batch.command(rows)
            for single, row, own in zip(singles, rows, accepted, strict=True):
                if single.command(row).tobytes() != own.tobytes():
                    return False
                for _ in range(6):
                    single.step()
            if batch.step(6):
                return False
            touched |= any(len(batch.call(k, "contacts").forces) for k in range(COPIES))
        return touched and all(
            batch.call(k, "snapshot") == single.snapshot()
            and np.array_equal(batch.array("positions")[k], single.positions)
            for k, single in enumerate(singles)
        )


if __name__ == "__main__":
    sys.exit(0 if same_bytes(sys.argv[1], int(sys.argv[2])) else 1)
