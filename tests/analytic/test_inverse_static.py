"""Static inverse: goals from forward equilibria, redundant joints, goals out of reach."""

from __future__ import annotations

import numpy as np
import pytest
from inverse_goals import COUNTS, LOWER, UPPER, goals, tripod_at_start
from small_scenes import body, scene, slab

from softsim_core import Simulation
from softsim_core.control.inverse import PositionTask, analytic_sensitivity, solve_pose, task_for
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import InverseSettings, JointDescription, RobotDescription, SceneDescription


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize(("kind", "allowed"), [("position", 0), ("height_tilt", 1)])
def test_reachable_goals_in_ten_programs_each(kind: str, allowed: int, count: int) -> None:
    """Height and tilt may miss one: at an arm bent double the body snaps, and the search lands beside it."""
    pytest.importorskip("numba")
    sim = tripod_at_start()
    home, missed = sim.snapshot(), []
    settings = InverseSettings(task=kind)  # type: ignore[arg-type]
    for joints, goal in goals(count, seed=1):
        sim.restore(home)
        found = solve_pose(sim, task_for(goal, settings), settings=settings)
        assert found.iterations <= 10
        assert ((found.joints >= LOWER) & (found.joints <= UPPER)).all()
        assert found.kkt_residual <= 1e-8
        if found.residual_m > 1e-5 or found.residual_rad > 1e-4:  # 0.01 mm, 1e-4 rad
            missed.append((joints, found))
    assert len(missed) <= allowed, missed


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["position", "height_tilt"])
def test_reachable_goals(kind: str) -> None:
    sim = tripod_at_start()
    home = sim.snapshot()
    settings = InverseSettings(task=kind)  # type: ignore[arg-type]
    for _, goal in goals(4, seed=2):
        sim.restore(home)
        found = solve_pose(sim, task_for(goal, settings), settings=settings)
        assert found.reachable
        assert found.residual_m <= 1e-5
        assert found.residual_rad <= 1e-4


@pytest.mark.slow
def test_a_goal_beside_the_workspace_ends_at_a_limit_and_nearest_to_it() -> None:
    sim = tripod_at_start()
    found = solve_pose(sim, PositionTask(np.array([0.2, 0.0, 0.05]), np.ones(3)), most_steps=30)
    assert not found.reachable
    pull = np.array([0.2, 0.0, 0.05]) - found.pose.position
    downhill = analytic_sensitivity(sim).effector[:3].T @ pull  # would shorten the distance
    at_upper, at_lower = found.joints == UPPER, found.joints == LOWER
    assert (at_upper | at_lower).any()
    assert (downhill[at_upper] > 0.0).all()
    assert (downhill[at_lower] < 0.0).all()
    free = ~(at_upper | at_lower)
    assert np.abs(downhill[free]).max(initial=0.0) < 1e-4 * np.linalg.norm(pull)


def bar(**fields: object) -> SceneDescription:
    """A bar between two slides along x, a free frame in its middle."""
    slides = [
        JointDescription(name=name, kind="prismatic", axis=(1.0, 0.0, 0.0), limits=JointLimits(-0.02, 0.02))
        for name in ("left", "right")
    ]
    regions = (
        slab("left_end", "left", 0.0),
        slab("right_end", "right", 0.08),
        slab("middle", "free", 0.04),
    )
    return scene(
        body(box_mesh((0.08, 0.01, 0.01), (8, 1, 1), (0.0, -0.005, -0.005), "bar")),
        joints=tuple(slides), attachments=regions, effector="middle", gravity=(0.0, 0.0, 0.0), **fields,
    )  # fmt: skip


def test_two_slides_and_one_coordinate_pick_the_least_effort() -> None:
    sim = Simulation(bar(), backend="scipy")
    sim.settle([0.004, -0.003])  # stretched: both hold
    assert np.abs(sim.joint_efforts).min() > 0.1
    goal = sim.effector_pose
    assert goal is not None
    task = PositionTask(goal.position + np.array([0.002, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    found = solve_pose(sim, task)
    assert found.residual_m < 1e-8
    np.testing.assert_allclose(
        found.joints, 0.0025, rtol=0, atol=1e-8
    )  # (0.004 - 0.003) / 2 + 0.002: a shift
    assert np.abs(sim.joint_efforts).max() < 1e-4  # nothing left to hold


def test_without_effort_weight_redundant_joints_stay_near_the_posture() -> None:
    posture = (0.005, -0.001)
    settings = InverseSettings(effort_weight=0.0, posture_weight=1e-6, posture="wanted")
    sim = Simulation(
        RobotDescription(scene=bar(), poses={"wanted": posture}, inverse=settings), backend="scipy"
    )
    sim.settle([0.0, 0.0])
    x = sim.frames()["middle"].position
    found = solve_pose(sim, PositionTask(x + np.array([0.002, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])))
    assert found.residual_m < 1e-8
    np.testing.assert_allclose(found.joints, posture, rtol=0, atol=1e-7)  # its mean is 0.002: it fits exactly
