"""Effector tasks: errors, their derivatives against finite differences, target limiting."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.base import Array
from softsim_core.control.inverse import (
    HeightTiltTask,
    OrientationTask,
    PoseTask,
    PositionTask,
    Task,
    scale_to_limits,
    task_for,
    tilt_of,
)
from softsim_core.physics.mechanics import Pose, quaternion_of, rotation_exp, rotation_of
from softsim_core.scene import InverseSettings

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def pose(rng: np.random.Generator, angle: float) -> Pose:
    """A random place, turned by at most `angle` [rad] an axis."""
    return Pose(rng.uniform(-0.05, 0.05, 3), quaternion_of(rotation_exp(rng.uniform(-angle, angle, 3))))


def tasks(rng: np.random.Generator) -> list[Task]:
    goal, weights = pose(rng, 0.8), rng.uniform(0.1, 2.0, 6)
    return [
        PositionTask(goal.position, weights[:3]),
        OrientationTask(goal.quaternion_xyzw, weights[3:]),
        HeightTiltTask(0.04, *rng.uniform(-0.5, 0.5, 2), weights[:3]),
        PoseTask(goal, weights),
    ]


def moved(current: Pose, motion: Array) -> Pose:
    rotation = rotation_exp(motion[3:]) @ rotation_of(current.quaternion_xyzw)
    return Pose(current.position + motion[:3], quaternion_of(rotation))


@pytest.mark.parametrize("seed", range(20))
def test_jacobians_are_the_derivatives_of_the_errors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    current, effector = pose(rng, 0.8), rng.normal(size=(6, 4))
    for task in tasks(rng):
        numeric = [
            (task.error(moved(current, -1e-6 * column)) - task.error(moved(current, 1e-6 * column))) / 2e-6
            for column in effector.T
        ]
        np.testing.assert_allclose(
            task.jacobian(effector, current), np.column_stack(numeric), rtol=1e-6, atol=1e-7
        )
        assert len(task.weights) == len(task.angular) == len(task.error(current))


def test_errors_vanish_at_the_goal() -> None:
    rng = np.random.default_rng(1)
    goal = pose(rng, 0.5)
    for kind in ("position", "orientation", "height_tilt", "pose"):
        task = task_for(goal, InverseSettings(task=kind))  # type: ignore[arg-type]
        assert np.abs(task.error(goal)).max() < 1e-12


def test_height_and_tilt_do_not_see_a_turn_about_the_effector_s_own_axis() -> None:
    rng = np.random.default_rng(2)
    current = pose(rng, 0.3)
    turned = rotation_of(current.quaternion_xyzw) @ rotation_exp(np.array([0.0, 0.0, 1.2]))
    task = HeightTiltTask(0.03, 0.1, -0.2, np.ones(3))
    same = Pose(current.position, quaternion_of(turned))
    np.testing.assert_allclose(task.error(same), task.error(current), rtol=0, atol=1e-12)


def test_tilt_is_the_rotation_vector_of_a_frame_without_twist() -> None:
    tilt = np.array([0.3, -0.2, 0.0])
    assert tilt_of(quaternion_of(rotation_exp(tilt))) == pytest.approx(tilt[:2])
    assert tilt_of(UPRIGHT) == (0.0, 0.0)
    error = HeightTiltTask(0.0, 0.3, -0.2, np.ones(3)).error(Pose(np.zeros(3), UPRIGHT))
    np.testing.assert_allclose(error, [0.0, 0.3, -0.2], atol=1e-12)


def test_a_frame_upside_down_still_has_a_finite_error() -> None:
    down = quaternion_of(rotation_exp(np.array([np.pi, 0.0, 0.0])))
    for task in (HeightTiltTask(0.0, 0.0, 0.0, np.ones(3)), OrientationTask(UPRIGHT, np.ones(3))):
        assert np.isfinite(task.error(Pose(np.zeros(3), down))).all()
        assert np.isfinite(task.jacobian(np.ones((6, 2)), Pose(np.zeros(3), down))).all()


@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3])
@pytest.mark.parametrize("seed", range(5))
def test_upside_down_is_half_a_turn_away_and_leads_out(seed: int, off: float) -> None:
    rng = np.random.default_rng(seed)
    goal = pose(rng, 0.5)
    turned = rotation_of(goal.quaternion_xyzw) @ rotation_exp(np.pi * np.array([0.6, 0.8, 0.0]))
    away = off * rng.normal(size=3)
    current = Pose(goal.position, quaternion_of(rotation_exp(away) @ turned))
    for kind in ("orientation", "height_tilt", "pose"):
        task = task_for(goal, InverseSettings(task=kind))  # type: ignore[arg-type]
        turn = np.array(task.angular)
        assert np.linalg.norm(task.error(current)[turn]) > (2.5 if kind == "height_tilt" else 3.13)
        there, effector = current, np.eye(6)
        for _ in range(100):
            error = scale_to_limits(task.error(there), task.angular, 0.01, 0.1)
            step = np.linalg.lstsq(task.jacobian(effector, there), error, rcond=1e-6)[0]
            there = moved(there, step * min(1.0, 0.2 / max(np.linalg.norm(step), 1e-12)))
        assert np.abs(task.error(there)).max() < 1e-6


def test_a_goal_upside_down_is_no_upright_one() -> None:
    down = quaternion_of(np.diag([1.0, -1.0, -1.0]))
    assert np.hypot(*tilt_of(down)) == pytest.approx(np.pi)
    task = task_for(Pose(np.zeros(3), down), InverseSettings(task="height_tilt"))
    assert np.linalg.norm(task.error(Pose(np.zeros(3), UPRIGHT))[1:]) == pytest.approx(np.pi)
    assert np.abs(task.error(Pose(np.zeros(3), down))).max() < 1e-12


def test_target_limiting_keeps_the_direction() -> None:
    error = np.array([0.03, -0.06, 0.1])
    angular = (False, False, True)
    near = scale_to_limits(error, angular, 0.01, 1.0)
    np.testing.assert_allclose(near, error / 6.0)
    np.testing.assert_allclose(scale_to_limits(error, angular, 1.0, 0.05), error / 2.0)
    np.testing.assert_array_equal(scale_to_limits(error, angular, 1.0, 1.0), error)
    np.testing.assert_array_equal(scale_to_limits(np.zeros(3), angular, 0.01, 1.0), np.zeros(3))
