"""Outcomes that the tutorials' tables "Explore" promise, measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from softsim_core import Simulation, load_scene


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
    start = load_scene("gripper_step_4").source.parents[1] / "tutorials/cable_gripper/step_4_start.yaml"
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
