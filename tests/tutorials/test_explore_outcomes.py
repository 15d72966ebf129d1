"""Outcomes that the tutorials' tables "Explore" promise, measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import Array


def ran(
    scene: str,
    seconds: float,
    command: Sequence[float] | None = None,
    overrides: dict[str, Any] | None = None,
) -> Simulation:
    simulation = Simulation(load_scene(scene, overrides))
    if command is not None:
        simulation.command(command)
    return go_on(simulation, seconds)


def go_on(simulation: Simulation, seconds: float, command: Sequence[float] | None = None) -> Simulation:
    if command is not None:
        simulation.command(command)
    for _ in range(round(seconds / simulation.dt)):
        simulation.step()
    return simulation


def sag_mm(simulation: Simulation) -> float:
    return float(-1e3 * (simulation.visual_points() - simulation.visual_rest_points)[:, 2].min())


def tip_moved_mm(simulation: Simulation) -> Array:
    """How far the end of the pneumatic finger has moved on average, by axis."""
    rest = simulation.visual_rest_points
    tip = rest[:, 0] > rest[:, 0].max() - 1e-6
    return 1e3 * (simulation.visual_points() - rest)[tip].mean(axis=0)


def material(body: str, young_modulus: float) -> dict[str, Any]:
    return {"bodies": [{"name": body, "material": {"young_modulus": young_modulus, "poisson_ratio": 0.45}}]}


@pytest.mark.parametrize(("dt", "fall_mm"), [(0.01, 54.0), (0.001, 49.5)])
def test_tripod_step_1_a_smaller_step_is_nearer_to_free_fall(dt: float, fall_mm: float) -> None:
    start = Simulation(load_scene("tripod_step_1")).rigid_poses[0].position[2]
    end = ran("tripod_step_1", 0.1, overrides={"dt": dt}).rigid_poses[0].position[2]
    assert 1e3 * (start - end) == pytest.approx(fall_mm, abs=0.1)


@pytest.mark.parametrize(("young_modulus", "expected_mm"), [(50e3, 11.8), (250e3, 2.4), (1e6, 0.6)])
def test_tripod_step_3_stiffness_and_sag(young_modulus: float, expected_mm: float) -> None:
    simulation = ran("tripod_step_3", 2.0, overrides=material("silicone", young_modulus))
    assert sag_mm(simulation) == pytest.approx(expected_mm, abs=0.1)


def test_tripod_step_5_heights_of_the_poses() -> None:
    simulation = ran("tripod_step_5", 1.5)
    heights = [simulation.effector_pose.position[2]]
    simulation.start_animation()
    heights.append(go_on(simulation, 1.5).effector_pose.position[2])
    for pose in ("mid", "high"):
        heights.append(go_on(simulation, 1.5, simulation.robot.poses[pose]).effector_pose.position[2])
    np.testing.assert_allclose(1e3 * np.array(heights), [29.5, 27.6, 43.9, 55.5], atol=0.2)


@pytest.mark.slow
def test_tripod_step_6_the_ball_rides_and_rolls_off() -> None:
    simulation = ran("tripod_step_6", 1.5)
    heights = [simulation.rigid_poses[0].position[2]]
    for pose in ("mid", "high"):
        heights.append(go_on(simulation, 1.0, simulation.robot.poses[pose]).rigid_poses[0].position[2])
    np.testing.assert_allclose(1e3 * np.array(heights), [40.0, 56.0, 68.0], atol=1.0)
    assert go_on(simulation, 1.5, [-0.3, -1.0, -1.0]).rigid_poses[0].position[2] < 0.04


def test_tripod_step_8_2_the_ball_reaches_the_far_corner() -> None:
    simulation = ran("tripod_step_8_2", 0.6, [0.02, 0.0])
    assert go_on(simulation, 0.5, [0.02, -0.15]).rigid_poses[1].position[1] > 0.024


@pytest.mark.parametrize(("friction", "stays"), [(0.8, True), (0.05, False)])
def test_gripper_step_1_a_slope(friction: float, stays: bool) -> None:
    overrides = {"gravity": [2.0, 0.0, -9.6], "contact": {"friction": friction}}
    moved = abs(ran("gripper_step_1", 1.0, overrides=overrides).rigid_poses[1].position[0] - 0.010)
    assert (moved < 0.005) == stays


@pytest.mark.parametrize(("young_modulus", "expected_mm"), [(1.8e6, 11.4), (0.5e6, 38.0)])
def test_gripper_step_2_2_stiffness_and_sag(young_modulus: float, expected_mm: float) -> None:
    simulation = ran("gripper_step_2_2", 2.0, overrides=material("finger", young_modulus))
    assert sag_mm(simulation) == pytest.approx(expected_mm, abs=0.3)


@pytest.mark.parametrize(("pull", "tension"), [(0.001, 0.26), (0.005, 0.74), (0.010, 1.25), (0.020, 2.1)])
def test_gripper_step_3_pull_and_tension(pull: float, tension: float) -> None:
    assert ran("gripper_step_3", 2.0, [pull]).actuators[0].tension == pytest.approx(tension, abs=0.02)


@pytest.mark.slow
def test_gripper_step_4_notches_that_meet_need_more_tension() -> None:
    start = load_scene("gripper_step_4").source.parents[1] / "tutorials/gripper_step_4_start.yaml"
    free, met = (ran(scene, 2.0, [0.055]).actuators[0].tension for scene in (str(start), "gripper_step_4"))
    assert free == pytest.approx(3.9, abs=0.1)
    assert met == pytest.approx(14.0, abs=2.0)


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "lifted"), [(0.8, True), (0.08, False)])
def test_gripper_step_0_friction_holds_the_cube(friction: float, lifted: bool) -> None:
    simulation = ran("gripper_step_0", 1.5, [0, 0, 0, -0.05, 0], {"contact": {"friction": friction}})
    go_on(simulation, 1.5, [0.012, 0.012, 0.012, -0.05, 0])
    go_on(simulation, 1.5, [0.012, 0.012, 0.012, -0.02, 0])
    assert (simulation.rigid_poses[1].position[2] > -0.120) == lifted


@pytest.mark.parametrize(("order", "expected_mm"), [(2, 7.0), (1, 1.1)])
def test_pneu_step_1_linear_cells_lock(order: int, expected_mm: float) -> None:
    simulation = ran("pneu_step_1", 2.0, overrides={"bodies": [{"name": "finger", "order": order}]})
    assert sag_mm(simulation) == pytest.approx(expected_mm, abs=0.1)


@pytest.mark.slow
def test_pneu_step_2_air_alone_makes_it_longer_and_does_not_lift_it() -> None:
    simulation = ran("pneu_step_2", 2.0)
    before = tip_moved_mm(simulation)
    after = tip_moved_mm(go_on(simulation, 2.0, [9e-7]))
    np.testing.assert_allclose((after - before)[[0, 2]], [1.2, 0.0], atol=0.1)
    assert simulation.joint_efforts[0] == pytest.approx(19e3, abs=500.0)


@pytest.mark.parametrize(
    ("volume", "height_mm", "pressure_kpa"), [(3e-7, 9.3, 21.3), (9e-7, 30.9, 53.6), (1.4e-6, 45.6, 75.1)]
)
@pytest.mark.slow
def test_pneu_step_3_paper_and_thread_turn_growth_into_bending(
    volume: float, height_mm: float, pressure_kpa: float
) -> None:
    simulation = ran("pneu_step_3", 2.5, [volume])
    assert tip_moved_mm(simulation)[2] == pytest.approx(height_mm, abs=0.3)
    assert 1e-3 * simulation.joint_efforts[0] == pytest.approx(pressure_kpa, abs=0.5)


@pytest.mark.slow
def test_pneu_step_4_one_chamber_bends_the_arm_and_three_stretch_it() -> None:
    simulation = ran("pneu_step_4", 2.4)
    rest = simulation.effector_pose.position
    moved = [go_on(simulation, 2.4, simulation.robot.poses[pose]).effector_pose for pose in ("bent", "long")]
    np.testing.assert_allclose(1e3 * (moved[0].position - rest), [-13.5, -0.3, -5.9], atol=0.3)
    np.testing.assert_allclose(1e3 * (moved[1].position - rest), [0.0, 0.0, -9.9], atol=0.3)
