"""A robot that is left alone comes to rest in its equilibrium, whatever the pose and the time step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.arrays import Array

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

PLAIN = [("tripod", "scipy", 0.02, -2.0), ("tripod", "scipy", 0.02, "high")]
"""What the suite runs on the readable path, too, which takes 10 to 200 ms per step."""

FINE = [("tripod_high", "numba", 0.01, pose) for pose in ("start", "high")]
"""What the suite runs on the finest mesh."""

REST = [
    pytest.param(
        (robot, backend, dt, pose),
        id=f"{robot}-{backend}-{dt}-{pose}",
        marks=pytest.mark.exhaustive
        if (backend == "scipy" or robot == "tripod_high") and (robot, backend, dt, pose) not in PLAIN + FINE
        else (),
    )
    for backend in ("numba", "scipy")
    for robot in ("tripod", "tripod_mid", "tripod_high")
    for dt in STEPS
    for pose in POSES
    if (robot, backend, dt, pose) not in FIRST
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
@pytest.mark.parametrize("case", REST)
def test_it_rests_in_every_pose(case: tuple[Any, ...]) -> None:
    assert_rests(*left_alone(*case))


FINGERS = [
    pytest.param(
        (robot, backend, dt, pull),
        id=f"{robot}-{backend}-{dt}-{pull}",
        marks=pytest.mark.exhaustive if backend == "scipy" and (robot, dt) != ("cable_finger", 0.02) else (),
    )
    for backend in ("numba", "scipy")
    for robot in ("cable_finger", "cable_gripper")
    for dt in STEPS
    for pull in (0.0, 0.020, 0.035)
]


@pytest.mark.slow
@pytest.mark.parametrize("case", FINGERS)
def test_fingers_rest(case: tuple[str, str, float, float]) -> None:
    """Without contact, which has no part in an equilibrium."""
    robot, backend, dt, pull = case
    if backend == "numba":
        pytest.importorskip("numba")
    described = load_scene(robot, {"dt": dt})
    scene = described.with_scene(collisions=(), rigid_bodies=())
    simulation = Simulation(scene, backend)  # type: ignore[arg-type]
    goal = np.array([pull if joint.kind == "cable" else 0.0 for joint in scene.joints])
    simulation.command(goal)
    run(simulation, 5.0 + pull / 0.05)  # at the speed limit of the cables
    assert_rests(simulation, goal)
