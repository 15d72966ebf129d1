"""A robot that is left alone comes to rest in its equilibrium, whatever the pose and the time step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sampled_cases import sampled

from softsim_core import Simulation, load_scene
from softsim_core.base import Array

DISTANCE = 1e-6
"""The robot stands this near its equilibrium, in [m]."""

SPEED = 1e-6
"""No node is faster than this, in [m/s]."""

STEPS = (0.005, 0.01, 0.02)
POSES = ("start", "mid", "high", -2.0)
"""Named poses, and a position in [rad] of all joints."""

FIRST = [
    ("tripod", "numba", 0.02, -2.0),
    ("tripod", "numba", 0.01, "mid"),
    ("tripod_mid", "numba", 0.01, "start"),
]
"""What frozen rotations of the elements never bring to rest."""

PLAIN = [("tripod", "scipy", 0.02, "high")]
"""What the suite runs on the readable path, too, which takes 10 to 200 ms per step."""

FINE = [("tripod_high", "numba", 0.02, "start")]
"""What the suite runs on the finest mesh."""

OTHERS = [
    pytest.param(robot, backend, dt, pose, marks=pytest.mark.exhaustive)
    for backend in ("numba", "scipy")
    for robot in ("tripod", "tripod_mid", "tripod_high")
    for dt in STEPS
    for pose in POSES
    if (robot, backend) not in (("tripod", "numba"), ("tripod_mid", "numba"))
    and (robot, backend, dt, pose) not in PLAIN + FINE
]

REST = [
    *sampled("tripod", [("tripod", "numba", dt, pose) for dt in STEPS for pose in POSES]),
    *sampled("tripod_mid", [("tripod_mid", "numba", dt, pose) for dt in STEPS for pose in POSES]),
    *PLAIN,
    *FINE,
    *OTHERS,
]


def left_alone(robot: str, backend: str, dt: float, pose: str | float) -> tuple[Simulation, Array]:
    """A Tripod 5 s after it has gone to its start pose and then to another one, and its command."""
    if backend == "numba":
        pytest.importorskip("numba")
    scene = load_scene(robot, {"dt": dt}, kind="robots")
    simulation = Simulation(scene, backend)  # type: ignore[arg-type]
    goal = np.array(scene.poses[pose]) if isinstance(pose, str) else np.full(3, pose)
    simulation.start_animation()
    run(simulation, 0.25)
    simulation.command(goal)
    run(simulation, 0.25 + 5.0)  # the longest way, 0.7 rad, takes 0.2 s
    return simulation, goal


def run(simulation: Simulation, seconds: float) -> None:
    for _ in range(round(seconds / simulation.dt)):
        simulation.step()


def assert_rests(simulation: Simulation, goal: Array) -> None:
    at_rest = simulation.equilibrium(goal).state
    assert np.abs(simulation.velocities).max() < SPEED
    assert np.abs(simulation.positions - at_rest.positions).max() < DISTANCE
    for frame, expected in zip(simulation.frames().values(), at_rest.frame_positions, strict=False):
        assert np.abs(frame.position - expected).max() < DISTANCE


@pytest.mark.parametrize("case", FIRST, ids=str)
@pytest.mark.slow
def test_it_rests_in_its_equilibrium(case: tuple[Any, ...]) -> None:
    assert_rests(*left_alone(*case))


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "backend", "dt", "pose"), REST)
def test_it_rests_in_every_pose(robot: str, backend: str, dt: float, pose: str | float) -> None:
    assert_rests(*left_alone(robot, backend, dt, pose))


PULLS = (0.0, 0.020, 0.035)
PULLED = [(robot, dt, pull) for robot in ("cable_finger", "cable_gripper") for dt in STEPS for pull in PULLS]

FINGERS = [
    *sampled("fingers", [(robot, "numba", dt, pull) for robot, dt, pull in PULLED]),
    ("cable_finger", "scipy", 0.02, 0.020),
    *(
        pytest.param(robot, "scipy", dt, pull, marks=pytest.mark.exhaustive)
        for robot, dt, pull in PULLED
        if (robot, dt, pull) != ("cable_finger", 0.02, 0.020)
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "backend", "dt", "pull"), FINGERS)
def test_fingers_rest(robot: str, backend: str, dt: float, pull: float) -> None:
    """Without contact, which has no part in an equilibrium."""
    if backend == "numba":
        pytest.importorskip("numba")
    described = load_scene(robot, {"dt": dt})
    scene = described.with_scene(collisions=(), rigid_bodies=())
    simulation = Simulation(scene, backend)  # type: ignore[arg-type]
    goal = np.array([pull if joint.kind == "cable" else 0.0 for joint in scene.joints])
    simulation.command(goal)
    run(simulation, 5.0 + pull / 0.05)  # at the speed limit of the cables
    assert_rests(simulation, goal)
