"""Joint limits and the check of a command."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, seed
from hypothesis import strategies as st

from softsim_core.actuation.limits import JointLimits, check_command
from softsim_core.errors import CommandError, SceneError

JOINTS = ("servo_0", "servo_1", "servo_2")
finite = st.floats(-1e3, 1e3)


@seed(0)
@given(finite, finite, finite)
def test_clamp_gives_the_nearest_allowed_position(a: float, b: float, position: float) -> None:
    limits = JointLimits(min(a, b), max(a, b))
    clamped = limits.clamp(position)
    assert limits.lower <= clamped <= limits.upper
    assert limits.clamp(clamped) == clamped
    if limits.lower <= position <= limits.upper:
        assert clamped == position


@seed(0)
@given(finite, finite, st.floats(0.01, 100.0))
def test_towards_is_never_faster_than_allowed_and_arrives(
    current: float, target: float, speed: float
) -> None:
    limits = JointLimits(speed=speed)
    after = limits.towards(current, target, 0.01)
    assert abs(after - current) <= speed * 0.01 * (1.0 + 1e-9) + 1e-12
    assert abs(after - target) <= abs(current - target)
    if abs(target - current) <= speed * 0.01:
        assert after == target


@pytest.mark.parametrize("limits", [(1.0, 0.0), (math.nan, 1.0), (0.0, math.nan)])
def test_an_empty_interval_is_refused(limits: tuple[float, float]) -> None:
    with pytest.raises(SceneError, match="lower <= upper"):
        JointLimits(*limits)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_a_speed_limit_is_positive(speed: float) -> None:
    with pytest.raises(SceneError, match="speed limit must be > 0"):
        JointLimits(speed=speed)


def test_check_command_returns_floats() -> None:
    accepted = check_command(np.array([1, 2, 3]), JOINTS)
    assert accepted == [1.0, 2.0, 3.0]
    assert all(type(value) is float for value in accepted)


@pytest.mark.parametrize("count", [0, 1, 2, 4, 300])
def test_a_command_of_the_wrong_length_names_the_joints(count: int) -> None:
    with pytest.raises(CommandError, match=rf"of {count} values.*expected 3 \(servo_0, servo_1, servo_2\)"):
        check_command([0.0] * count, JOINTS)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_command_that_is_not_finite_names_the_joint(value: float, place: int) -> None:
    values = [0.0, 0.0, 0.0]
    values[place] = value
    with pytest.raises(CommandError, match=f"servo_{place}.*finite"):
        check_command(values, JOINTS)
