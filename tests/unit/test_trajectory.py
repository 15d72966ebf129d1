"""Joint trajectories: interpolation from the current command, subsets of joints, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.interpolate import BPoly

from softsim_core.base import CommandError
from softsim_core.physics.actuation import JointTrajectory


def test_linear_from_the_current_command_through_the_way_points() -> None:
    trajectory = JointTrajectory(["a", "b"], [1.0, 3.0], [[1.0, -1.0], [2.0, -1.0]])
    times = [-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 9.0]
    samples = np.array([trajectory.sample(time, [0.0, 1.0]) for time in times])
    np.testing.assert_allclose(samples[:, 0], [0.0, 0.0, 0.5, 1.0, 1.5, 2.0, 2.0])
    np.testing.assert_allclose(samples[:, 1], [1.0, 1.0, 0.0, -1.0, -1.0, -1.0, -1.0])
    velocities = [trajectory.between(time, np.array([0.0, 1.0]))[1].tolist() for time in times]
    assert velocities == [[1.0, -2.0]] * 3 + [[0.5, 0.0]] * 2 + [[0.0, 0.0]] * 2
    assert trajectory.duration == 3.0
    assert [trajectory.is_over(time) for time in (2.99, 3.0 - 1e-12, 3.0)] == [False, True, True]


def test_a_way_point_at_0_is_where_it_starts() -> None:
    trajectory = JointTrajectory(["a"], [0.0, 1.0], [[5.0], [6.0]])
    assert trajectory.sample(0.0, [0.0]) == 5.0
    assert trajectory.sample(0.5, [0.0]) == 5.5


def test_joints_that_it_does_not_name_keep_their_command() -> None:
    trajectory = JointTrajectory(["c", "a"], [1.0], [[3.0, 1.0]])
    start = [0.0, 7.0, 0.0]
    np.testing.assert_allclose(trajectory.sample(0.5, start, ["a", "b", "c"]), [0.5, 7.0, 1.5])
    assert start == [0.0, 7.0, 0.0]


@pytest.mark.parametrize(
    ("joints", "times", "positions", "words"),
    [
        ([], [1.0], [[]], "no joint"),
        (["a", "a"], [1.0], [[1.0, 2.0]], "names a twice"),
        (["a"], [], [], "no way points"),
        (["a"], 1.0, [[1.0]], "no way points"),
        (["a"], [1.0, 2.0], [[1.0]], r"shape \(1, 1\) do not fit 2 times and 1 joints \(a\)"),
        (["a"], [1.0], [[1.0, 2.0]], r"expected shape \(1, 1\)"),
        (["a"], [1.0], [1.0], "expected shape"),
        (["a"], [1.0, 2.0], [[1.0], [1.0, 2.0]], "not all numbers"),
        (["a"], ["soon"], [[1.0]], "times are not all numbers"),
        (["a"], [-1.0], [[1.0]], "strictly increasing"),
        (["a"], [1.0, 1.0], [[1.0], [1.0]], "strictly increasing"),
        (["a"], [2.0, 1.0], [[1.0], [1.0]], "strictly increasing"),
        (["a"], [math.nan], [[1.0]], "finite"),
        (["a"], [1.0, math.inf], [[1.0], [1.0]], "finite"),
        (["a", "b"], [1.0, 2.0], [[1.0, 1.0], [1.0, math.nan]], "position nan of joint b at way point 1"),
    ],
)
def test_refusals(joints: list[str], times: object, positions: object, words: str) -> None:
    with pytest.raises(CommandError, match=words) as caught:
        JointTrajectory(joints, times, positions)  # type: ignore[arg-type]
    assert str(caught.value).endswith("nothing was moved")
    assert "\n" not in str(caught.value)


def test_unknown_joints_and_wrong_starts_are_refused() -> None:
    trajectory = JointTrajectory(["a", "x"], [1.0], [[1.0, 2.0]])
    with pytest.raises(CommandError, match="unknown joint x; known joints: a, b"):
        trajectory.sample(0.0, [0.0, 0.0], ["a", "b"])
    with pytest.raises(CommandError, match="3 start positions do not fit 2 joints"):
        trajectory.sample(0.0, [0.0, 0.0, 0.0])


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(st.floats(0.001, 10.0), min_size=1, max_size=6), st.randoms(use_true_random=False))
def test_it_passes_through_every_way_point_and_never_leaves_their_range(
    gaps: list[float], random: object
) -> None:
    times = np.cumsum(gaps)
    positions = np.array([[random.uniform(-3.0, 3.0)] for _ in gaps])  # type: ignore[attr-defined]
    trajectory = JointTrajectory(["a"], times, positions)
    for time, position in zip(times, positions, strict=True):
        assert trajectory.sample(float(time), [0.0]) == pytest.approx(position)
    low, high = min(0.0, positions.min()), max(0.0, positions.max())
    for time in np.linspace(0.0, trajectory.duration, 50):
        assert low - 1e-12 <= trajectory.sample(float(time), [0.0])[0] <= high + 1e-12


@pytest.mark.parametrize("order", [2, 3])
def test_velocities_and_accelerations_make_cubics_and_quintics(order: int) -> None:
    random = np.random.default_rng(7)
    times = np.array([0.4, 1.0, 2.5])
    slopes = random.normal(size=(3, order, 2))  # point, derivative, joint
    slopes[-1, 1] = 0.0
    trajectory = JointTrajectory(["a", "b"], times, *np.moveaxis(slopes, 1, 0))
    start = np.zeros((1, order, 2))
    start[0, 0] = [0.3, -0.2]
    curve = BPoly.from_derivatives(np.append(0.0, times), np.concatenate([start, slopes]))
    for time in np.linspace(0.0, 2.5, 41):
        np.testing.assert_allclose(trajectory.sample(time, start[0, 0]), curve(time), atol=1e-12)
        velocities = trajectory.between(time, start[0, 0])[1]
        np.testing.assert_allclose(velocities, curve.derivative()(time), atol=1e-11)
    np.testing.assert_allclose(trajectory.sample(9.0, start[0, 0]), slopes[-1, 0])


@pytest.mark.parametrize(
    ("velocities", "accelerations", "words"),
    [
        ([[0.0, 0.0]], None, "velocities are not one finite number"),
        ([[math.nan], [0.0]], None, "velocities are not one finite number"),
        ([[1.0], [1.0]], None, "last way point must be 0"),
        (None, [[0.0], [0.0]], "accelerations need velocities"),
    ],
)
def test_slopes_that_do_not_fit_are_refused(velocities: object, accelerations: object, words: str) -> None:
    with pytest.raises(CommandError, match=words):
        JointTrajectory(["a"], [1.0, 2.0], [[1.0], [2.0]], velocities, accelerations)  # type: ignore[arg-type]


def test_the_round_off_of_a_planner_at_the_end_counts_as_rest() -> None:
    """1e-12 after 1 rad/s is rest, a thousandth of the speed is not."""
    trajectory = JointTrajectory(["a"], [1.0, 2.0], [[0.5], [1.0]], [[1.0], [1e-12]])
    assert trajectory.velocities is not None
    assert trajectory.velocities[-1, 0] == 0.0
    with pytest.raises(CommandError, match="last way point must be 0"):
        JointTrajectory(["a"], [1.0, 2.0], [[0.5], [1.0]], [[1.0], [1e-3]])
