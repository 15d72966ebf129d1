"""The whole Tripod with compliant servos against the reference simulator and an independent computation."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from reference_scenes import from_reference, full_tripod, quaternion_from_reference

from softsim_core import Pose, Simulation
from softsim_core.base import Array, Backend
from softsim_core.physics.dynamics import solve_static
from softsim_core.physics.mechanics import Control, State, rotation_log, rotation_of

pytestmark = [pytest.mark.reference, pytest.mark.filterwarnings("ignore:body silicone")]

A = -1.4965
"""Command of the start pose in [rad]."""

POSES = {
    "rest_theta0_base_r60": ((0.0, 0.0, 0.0), 0.0),
    "A": ((A, A, A), 0.035),
    "Q": ((-1.046667, -1.046667, -1.046667), 0.035),
    "all_-1.0": ((-1.0, -1.0, -1.0), 0.035),
    "Z": ((-0.785, -0.785, -0.785), 0.035),
    "A_servo0_plus0.1": ((A + 0.1, A, A), 0.035),
    "A_servo1_plus0.1": ((A, A + 0.1, A), 0.035),
    "A_servo2_plus0.1": ((A, A, A + 0.1), 0.035),
}
"""Command in [rad] and base shift in [m] of each pose of tripod_reference_poses.json."""

NEAR = {"Q": "all_-1.0", "all_-1.0": "Z", **{f"A_servo{k}_plus0.1": "A" for k in range(3)}}
"""Where statics begin that do not begin at rest."""

DAILY = ("rest_theta0_base_r60", "A", "Z", "A_servo1_plus0.1")
"""Poses of the daily run; the other ones are exhaustive."""


def turn_between(pose: Pose, quaternion_xyzw: Array) -> float:
    """Angle in [rad] between a pose and an orientation."""
    difference = (
        rotation_of(pose.quaternion_xyzw) @ rotation_of(quaternion_xyzw / np.linalg.norm(quaternion_xyzw)).T
    )
    return float(np.linalg.norm(rotation_log(difference)))


def test_start_animation(reference_dir: Path, backend: Backend) -> None:
    results = np.load(reference_dir / "simulator" / "tripod_low.npz")
    sim = Simulation(full_tripod(reference_dir, "low"), backend=backend)
    sim.start_animation()
    for row in results["A_animation_center_angles"]:
        sim.step()
        pose = sim.effector_pose
        assert pose is not None
        np.testing.assert_allclose(pose.position, from_reference(row[:3]), rtol=0, atol=5e-9)  # m; seen 1e-9
        assert turn_between(pose, quaternion_from_reference(row[3:7])) < 5e-7  # rad
        np.testing.assert_allclose(sim.joint_positions, row[7:], rtol=0, atol=1e-7)  # rad


@pytest.mark.parametrize(("level", "pose"), [("low", "pose0"), ("low", "pose3"), ("mid", "pose0")])
def test_settled_poses_node_by_node(reference_dir: Path, level: str, pose: str) -> None:
    results = np.load(reference_dir / "simulator" / f"tripod_{level}.npz")
    sim = Simulation(full_tripod(reference_dir, level))
    sim.start_animation()
    for _ in range(60):
        sim.step()
    sim.command(results[f"{pose}_command"])
    for _ in range(400):
        sim.step()
        if np.abs(sim.velocities).max() < 1e-9:
            break
    np.testing.assert_allclose(
        sim.positions, from_reference(results[f"{pose}_position"]), rtol=0, atol=5e-9
    )  # m; seen 1e-9
    effector, expected = sim.effector_pose, results[f"{pose}_center"]
    assert effector is not None
    np.testing.assert_allclose(effector.position, from_reference(expected[:3]), rtol=0, atol=5e-9)
    assert turn_between(effector, quaternion_from_reference(expected[3:])) < 5e-7
    np.testing.assert_allclose(sim.joint_positions, results[f"{pose}_angles"], rtol=0, atol=1e-7)


@cache
def solved(reference_dir: Path, level: str, name: str) -> State:
    """The equilibrium in a pose, from the rest state or from that in a near pose."""
    command, base_shift = POSES[name]
    sim = Simulation(full_tripod(reference_dir, level), backend="scipy")
    first = solved(reference_dir, level, NEAR[name]) if name in NEAR else sim.model.rest_state()
    control = Control(np.array(command), sim.forces, base_shift)
    return solve_static(sim.model, first, control, sim.parameters).state


@pytest.mark.parametrize(
    "name",
    [each if each in DAILY else pytest.param(each, marks=pytest.mark.exhaustive) for each in POSES],
)
@pytest.mark.parametrize("level", ["low", pytest.param("mid", marks=pytest.mark.exhaustive)])
@pytest.mark.slow
def test_poses_of_the_independent_computation(reference_dir: Path, level: str, name: str) -> None:
    poses = json.loads((reference_dir / "data" / "fixtures" / "tripod_reference_poses.json").read_text())[
        level
    ]
    if name not in poses:
        pytest.skip(f"{name} was not computed on the {level} mesh")
    expected = poses[name]
    state = solved(reference_dir, level, name)
    centre = from_reference(np.array(expected["center"]))
    np.testing.assert_allclose(state.frame_positions[0], centre, rtol=0, atol=1e-7)  # printed to 1e-4 mm
    quaternion = quaternion_from_reference(np.array(expected["quat_xyzw"]))
    turn = rotation_log(state.frame_rotations[0] @ rotation_of(quaternion / np.linalg.norm(quaternion)).T)
    assert np.linalg.norm(turn) < 3e-6  # printed to 1e-6
    np.testing.assert_allclose(state.joint_positions, expected["theta"], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_nodes_of_pose_a_of_the_independent_computation(reference_dir: Path) -> None:
    nodes = np.loadtxt(reference_dir / "data" / "fixtures" / "tripod_low_A_pose_nodes.csv", delimiter=",")
    state = solved(reference_dir, "low", "A")
    np.testing.assert_allclose(
        state.positions, from_reference(nodes), rtol=0, atol=2e-8
    )  # printed to 1e-5 mm


def test_servo_torque_in_pose_a_is_the_documented_one(reference_dir: Path) -> None:
    sim = Simulation(full_tripod(reference_dir, "low"))
    sim.start_animation()
    for _ in range(200):
        sim.step()
    assert np.abs(sim.joint_efforts).max() == pytest.approx(0.204, abs=5e-3)  # N m, "about 0.19 N m"
    held = 1e3 * (np.full(3, A) - sim.joint_positions)  # spring law of the servo, 1e3 N m/rad
    np.testing.assert_allclose(sim.joint_efforts, held, rtol=1e-9)
