"""A Tripod that was "measured" by a sensor with a known frame and offset, as files of a data set."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from softsim_core import Simulation, load_scene, rotation_exp, rotation_of
from softsim_core.base import Array

POINT = np.array([4e-3, -2e-3, 9e-3])
"""Where the sensor sits in the effector's frame, in [m]."""
TURN, SHIFT = rotation_exp(np.array([0.05, -0.08, 0.6])), np.array([0.11, -0.07, 0.02])
"""From the robot's frame to that of the data, before its axes are renamed."""

DESCRIPTION = """
name: bench
robot: tripod
about: A Tripod on a bench.
sessions:
  - name: poses
    file: poses.csv
    commands: {columns: [s0_deg, s1_deg, s2_deg], unit: deg}
    frame: {axes: [z, x, y]}
    sensors: [{name: tracker, columns: [x_mm, y_mm, z_mm], unit: mm}]
    suspect: bad
    alignment: {frame: true, point: true}
"""


@dataclass(frozen=True)
class Poses:
    """Equilibria: joints (k, 3) in [rad], effector positions (k, 3) in [m], rotations (k, 3, 3)."""

    joints: Array
    positions: Array
    rotations: Array


@cache
def tripod_poses(count: int = 24) -> Poses:
    """Equilibria of the Tripod at random joints, the same every time."""
    robot = load_scene("tripod")
    simulation = Simulation(robot.robot_alone())
    joints = np.random.default_rng(3).uniform(-1.6, -0.7, (count, 3)).round(6)
    poses = []
    for each in joints:
        simulation.settle(each, robot.start_shift)
        pose = simulation.effector_pose
        assert pose is not None
        poses.append((pose.position, rotation_of(pose.quaternion_xyzw)))
    return Poses(joints, np.array([each for each, _ in poses]), np.array([turn for _, turn in poses]))


def measured(poses: Poses, noise: float, seed: int = 0) -> Array:
    """What the sensor tells, shape (k, 3) in [m], in the axes of the data (the robot's x is its z)."""
    sensor = poses.positions + poses.rotations @ POINT
    sensor += np.random.default_rng(seed).normal(0.0, noise, sensor.shape) if noise else 0.0
    return np.asarray((sensor @ TURN.T + SHIFT)[:, [1, 2, 0]])


def write_bench(
    folder: Path, *, noise: float = 0.0, edit: dict[str, object] | None = None, text: str = DESCRIPTION
) -> Path:
    """The data set as files; `edit` replaces columns of its table. Returns the folder."""
    poses = tripod_poses()
    x, y, z = 1e3 * measured(poses, noise).T
    s0, s1, s2 = np.degrees(poses.joints).T
    table: dict[str, object] = {"x_mm": x, "y_mm": y, "z_mm": z, "s0_deg": s0, "s1_deg": s1, "s2_deg": s2}
    table |= {"bad": np.zeros(len(x), int), **(edit or {})}
    rows = zip(*table.values(), strict=True)  # type: ignore[call-overload]
    lines = ["# a comment", ",".join(table), *(",".join(map(str, row)) for row in rows)]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "poses.csv").write_text("\n".join(lines))
    (folder / "dataset.yaml").write_text(text)
    return folder
