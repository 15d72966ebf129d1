"""Goals for the robot `tendon_arm`, made by equilibria of its simulation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softsim_core import Pose, Simulation
from softsim_core.control.inverse import effector
from softsim_core.robots import bending_commands
from softsim_core.scene import RobotDescription, TendonSegment

SEGMENTS = tuple(TendonSegment(0.08, (angle, angle + 120.0, angle + 240.0)) for angle in (0.0, 40.0, 80.0))
"""Segments of the robot."""

LOWEST, HIGHEST = 1.0, 35.0
"""Tensions in [N] that no motion crosses; it crosses the bounds of the program, 1.5 and 32 N, by little."""


def random_goals(robot: RobotDescription, count: int) -> Iterator[Pose]:
    """Poses at rest with random bends of the segments up to 0.9 rad."""
    rng, simulation = np.random.default_rng(7), Simulation(robot.robot_alone())
    for _ in range(count):
        size, angle = 0.9 * np.sqrt(rng.uniform(size=3)), rng.uniform(0.0, 2.0 * np.pi, 3)
        bends = np.stack([size * np.cos(angle), size * np.sin(angle)], axis=1)
        simulation.settle(bending_commands(SEGMENTS, bends))
        yield effector(simulation)
