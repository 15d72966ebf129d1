"""Tolerances of a goal against steps of its trajectory, and what a goal may not ask for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from softsim_core import load_scene
from softsim_core.base import CommandError
from softsim_core.physics.actuation import JointTrajectory
from softsim_ros.description import GOAL_TOLERANCE
from softsim_ros.nodes.simulator import End, FollowedGoal, Progress, check_reachable, followed_goal

JOINTS = load_scene("tripod").scene.joints
WAY = JointTrajectory(["servo_1", "servo_0"], [1.0], [[-0.5, -0.6]])


def message(**fields: Any) -> Any:
    empty = {"multi_dof_trajectory": SimpleNamespace(joint_names=[], points=[])}
    names = ("path_tolerance", "goal_tolerance", "component_path_tolerance", "component_goal_tolerance")
    none: dict[str, Any] = {name: [] for name in names}
    return SimpleNamespace(
        **{**none, **empty, "goal_time_tolerance": SimpleNamespace(sec=0, nanosec=0), **fields}
    )


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0, acceleration: float = 0.0) -> Any:
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=acceleration)


def step(elapsed: float, error: float = 0.0, velocity_error: float = 0.0) -> Progress:
    """A step at which servo_0 is off."""
    desired, velocities = WAY.between(elapsed, np.zeros(2))
    off = np.array([0.0, 1.0])
    return Progress(elapsed, desired, velocities, desired + error * off, velocities + velocity_error * off)


def end_of(goal: FollowedGoal, progress: Progress) -> End | None:
    outcome = goal.outcome_of(progress)
    return None if outcome is None else outcome.end


def test_without_wishes_only_the_end_counts_and_waits() -> None:
    goal = followed_goal(message(), WAY, JOINTS)
    assert end_of(goal, step(0.5, error=9.0, velocity_error=9.0)) is None
    assert end_of(goal, step(1.0, error=1.01 * GOAL_TOLERANCE)) is None
    assert end_of(goal, step(1.0e6, error=1.01 * GOAL_TOLERANCE)) is None
    assert end_of(goal, step(1.0, error=0.99 * GOAL_TOLERANCE, velocity_error=9.0)) is End.REACHED


@pytest.mark.parametrize(("wish", "allowed"), [(0.1, 0.1), (0.0, GOAL_TOLERANCE), (-1.0, np.inf)])
def test_a_tolerance_holds_for_its_joint_alone(wish: float, allowed: float) -> None:
    goal = followed_goal(message(goal_tolerance=[tolerance("servo_0", position=wish)]), WAY, JOINTS)
    assert goal.goal.position.tolist() == [GOAL_TOLERANCE, allowed]
    assert end_of(goal, step(1.0, error=min(0.999 * allowed, 9.0))) is End.REACHED
    assert np.isinf(allowed) or end_of(goal, step(1.0, error=1.001 * allowed)) is None


def test_on_the_way_positions_and_velocities_are_kept() -> None:
    path = [tolerance("servo_0", position=0.1, velocity=0.2)]
    goal = followed_goal(message(path_tolerance=path), WAY, JOINTS)
    assert end_of(goal, step(0.5, error=0.09, velocity_error=-0.19)) is None
    assert goal.outcome_of(step(0.5, error=-0.11)) == (
        End.LEFT_PATH,
        "path tolerance violated: joint servo_0 is 0.11 rad from its trajectory after 0.50 s, "
        "allowed are 0.1 rad",
    )
    told = goal.outcome_of(step(0.5, velocity_error=0.21))
    assert told is not None
    assert "joint servo_0 is 0.21 rad/s from" in told.message
    assert end_of(goal, step(1.0, velocity_error=9.0)) is End.REACHED  # at the end the path's do not hold


def test_the_goal_is_missed_after_its_time() -> None:
    late = SimpleNamespace(sec=0, nanosec=500_000_000)
    goal = followed_goal(message(goal_time_tolerance=late), WAY, JOINTS)
    assert end_of(goal, step(1.5 + 1e-12, error=1.0)) is None
    assert end_of(goal, step(1.51, error=1.0)) is End.MISSED
    assert end_of(goal, step(1.49, error=0.0)) is End.REACHED


def test_what_would_never_be_reached_is_refused() -> None:
    lower = JOINTS[0].limits.lower
    for beyond, refused in ((0.99 * GOAL_TOLERANCE, False), (1.01 * GOAL_TOLERANCE, True)):
        way = JointTrajectory(["servo_0"], [0.5, 1.0], [[lower - 9.0], [lower - beyond]])
        goal = followed_goal(message(), way, JOINTS)
        if refused:
            with pytest.raises(CommandError, match="beyond the limits of joint servo_0"):
                check_reachable(goal, JOINTS)
        else:
            check_reachable(goal, JOINTS)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"multi_dof_trajectory": SimpleNamespace(joint_names=["a"], points=[])}, "multi_dof_trajectory"),
        ({"component_path_tolerance": [None]}, "component tolerances"),
        (
            {"path_tolerance": [tolerance("servo_2", 1.0)]},
            "names servo_2, the trajectory moves servo_1, servo_0",
        ),
        ({"path_tolerance": [tolerance("servo_1")] * 3}, "has 3 entries for 2 joints"),
        ({"goal_tolerance": [tolerance("servo_1", np.inf)]}, "is not finite"),
        ({"goal_tolerance": [tolerance("servo_1", acceleration=1.0)]}, "accelerations are not measured"),
    ],
)
def test_wishes_that_nobody_keeps_are_refused(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(CommandError, match=words):
        followed_goal(message(**fields), WAY, JOINTS)


@pytest.mark.parametrize("name", ["pneu_finger", "inflated_cube"])  # told a volume, told a pressure
def test_volumes_and_pressures_have_no_tolerance_but_what_is_asked(name: str) -> None:
    joints = load_scene(name).scene.joints
    way = JointTrajectory([joints[0].name], [1.0], [[1000.0]])
    assert followed_goal(message(), way, joints).goal.position.tolist() == [np.inf]
    if joints[0].by_effort:
        asked = message(path_tolerance=[tolerance(joints[0].name, velocity=1.0)])
        with pytest.raises(CommandError, match="velocities are not measured"):
            followed_goal(asked, way, joints)
