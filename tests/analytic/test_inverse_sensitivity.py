"""Sensitivities of both back ends against finite differences of settled states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import machine

from softsim_core import Simulation, load_scene
from softsim_core.base import Array, Backend, NotConvergedError, SceneError
from softsim_core.control.inverse import Sensitivity, analytic_sensitivity, sampled_sensitivity
from softsim_core.physics.mechanics import rotation_log, rotation_of

pytestmark = pytest.mark.slow


def differences(sim: Simulation, step: float) -> Sensitivity:
    """Central differences of the poses and efforts of settled states; the simulation stays."""
    home, joints = sim.snapshot(), sim.joint_targets
    columns, efforts = [], []
    here = sim.effector_pose
    assert here is not None
    for k in range(len(joints)):
        column, effort = np.zeros(6), np.zeros(len(joints))
        for offset, weight in ((-1.0, -0.5), (1.0, 0.5)):
            sim.restore(home)
            sim.settle(joints + offset * step * np.eye(len(joints))[k])
            pose = sim.effector_pose
            assert pose is not None
            turn = rotation_log(rotation_of(pose.quaternion_xyzw) @ rotation_of(here.quaternion_xyzw).T)
            column += weight / step * np.concatenate([pose.position - here.position, turn])
            effort += weight / step * sim.joint_efforts
        columns.append(column)
        efforts.append(effort)
    sim.restore(home)
    return Sensitivity(np.column_stack(columns), np.column_stack(efforts))


def distance(a: Array, b: Array) -> float:
    return float(np.abs(a - b).max() / np.abs(b).max())


def assert_agree(a: Sensitivity, b: Sensitivity, tolerance: float) -> None:
    assert distance(a.effector[:3], b.effector[:3]) < tolerance
    assert distance(a.effector[3:], b.effector[3:]) < tolerance
    assert distance(a.effort, b.effort) < tolerance


@pytest.mark.slow
@pytest.mark.parametrize(
    ("poses", "base_shift"),
    [
        (3, 0.035),
        pytest.param(10, 0.035, marks=pytest.mark.exhaustive),
        pytest.param(10, 0.0, marks=pytest.mark.exhaustive),
    ],
)
def test_both_ways_at_random_poses_of_the_tripod(poses: int, base_shift: float) -> None:
    rng, tested = np.random.default_rng(3), 0
    sim = Simulation(replace(load_scene("tripod", kind="robots"), start=None))
    while tested < poses:
        sim.reset()
        try:
            sim.settle(rng.uniform(-1.9, -0.15, 3), base_shift)
        except NotConvergedError:  # unshifted bases stretch the body; some poses turn elements inside out
            continue
        expected = differences(sim, 2e-4)
        assert_agree(analytic_sensitivity(sim), expected, 1e-3)  # seen 1e-7
        assert_agree(sampled_sensitivity(sim), expected, 1e-3)  # seen 2e-6
        tested += 1


def test_a_pose_of_the_tripod(backend: Backend) -> None:
    sim = Simulation(replace(load_scene("tripod", kind="robots"), start=None), backend)
    sim.settle([-1.3, -0.9, -1.6], 0.035)
    before = sim.snapshot()
    expected = differences(sim, 2e-4)
    assert_agree(analytic_sensitivity(sim), expected, 1e-5)
    assert_agree(sampled_sensitivity(sim), expected, 1e-4)
    assert sim.snapshot() == before


def test_compliant_and_prescribed_joints_and_fixings(backend: Backend) -> None:
    sim = Simulation(machine(), backend)
    sim.settle([0.15, -0.1, 0.001, 0.0005])
    expected = differences(sim, 1e-4)
    analytic = analytic_sensitivity(sim)
    assert_agree(analytic, expected, 1e-5)
    assert np.abs(analytic.effector[:, 2:]).max() < 1e-9  # the slides hold another body


def test_a_contact_that_holds_takes_its_direction_away() -> None:
    sim = Simulation(machine(), "scipy")
    wall = np.zeros((10, 10))
    wall[2, 2] = 1e9  # the frame's z, N/m
    free, held = analytic_sensitivity(sim), analytic_sensitivity(sim, wall)
    assert np.abs(free.effector[2]).max() > 1e-3
    assert np.abs(held.effector[2]).max() < 1e-6
    assert held.effort[0, 0] > free.effort[0, 0]


def test_a_scene_without_effector_is_refused() -> None:
    with pytest.raises(SceneError, match="inverse control needs `effector` and `joints`"):
        analytic_sensitivity(Simulation(machine(effector=None), "scipy"))
