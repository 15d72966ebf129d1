"""Joint limits and the check of a command."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, seed, settings, strategies as st

from softsim_core.base import CommandError, SceneError
from softsim_core.physics.mechanics import ARRIVED, JointLimits, check_command

JOINTS = ("servo_0", "servo_1", "servo_2")
finite = st.floats(-1e3, 1e3)


@seed(0)
@settings(deadline=None)
@given(finite, finite, finite)
def test_clamp_gives_the_nearest_allowed_position(a: float, b: float, position: float) -> None:
    limits = JointLimits(min(a, b), max(a, b))
    clamped = limits.clamp(position)
    assert limits.lower <= clamped <= limits.upper
    assert limits.clamp(clamped) == clamped
    if limits.lower <= position <= limits.upper:
        assert clamped == position


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


@pytest.mark.parametrize("acceleration", [0.0, -1.0, math.nan])
def test_an_acceleration_limit_is_positive(acceleration: float) -> None:
    with pytest.raises(SceneError, match="acceleration limit must be > 0"):
        JointLimits(acceleration=acceleration)


inside = st.floats(-2.0, 2.0)
uneven_steps = st.lists(st.one_of(st.floats(1e-6, 1e-3), st.floats(1e-3, 0.3)), min_size=1, max_size=40)


@seed(0)
@settings(deadline=None)
@given(inside, inside, st.floats(0.1, 100.0), st.floats(0.1, 1e4), uneven_steps)
def test_a_motion_of_uneven_steps_keeps_every_limit_and_stops_on_its_target(
    start: float, target: float, speed: float, acceleration: float, uneven: list[float]
) -> None:
    limits = JointLimits(-2.0, 2.0, speed, acceleration)
    position, velocity = start, 0.0
    sign = math.copysign(1.0, target - start)
    for dt in itertools.chain(uneven, itertools.repeat(0.02, 10_000)):
        after, new_velocity = limits.step(position, velocity, target, dt)
        assert abs(new_velocity) <= speed * (1.0 + 1e-9)
        assert abs(new_velocity - velocity) <= acceleration * dt * (1.0 + 1e-9) + 1e-9
        assert abs(after - position) <= speed * dt * (1.0 + 1e-9) + 1e-12
        assert sign * (target - after) >= -2.0 * ARRIVED  # no overshoot
        if dt == 0.02 and after == position == target:
            break
        position, velocity = after, new_velocity
    assert position == target
    assert limits.step(position, 0.0, target, dt) == (target, 0.0)


@seed(0)
@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(-9.0, 9.0), st.floats(0.0, 0.04)), max_size=60))
def test_targets_that_jump_and_uneven_steps_break_no_limit(moves: list[tuple[float, float]]) -> None:
    limits = JointLimits(-2.0, 1.0, 3.5, 35.0)
    position, velocity = 0.0, 0.0
    for target, dt in moves:
        after, new_velocity = limits.step(position, velocity, target, dt)
        assert limits.lower <= after <= limits.upper
        assert abs(after - position) <= limits.speed * dt + 1e-12
        assert abs(new_velocity - velocity) <= limits.acceleration * dt + 1e-9
        position, velocity = after, new_velocity


@pytest.mark.parametrize("way", [0.005, 0.02, 0.3, 2.0])
def test_a_motion_takes_little_longer_than_the_shortest(way: float) -> None:
    """The shortest: half the way at full acceleration, half at full braking, or with top speed between."""
    limits, dt = JointLimits(speed=3.5, acceleration=35.0), 0.02
    ramp = limits.speed**2 / limits.acceleration
    if way > ramp:
        shortest = 2.0 * limits.speed / limits.acceleration + (way - ramp) / limits.speed
    else:
        shortest = 2.0 * math.sqrt(way / limits.acceleration)
    position, velocity, steps = 0.0, 0.0, 0
    while abs(way - position) > math.radians(0.1):
        position, velocity = limits.step(position, velocity, way, dt)
        steps += 1
    assert steps * dt <= shortest + 2.0 * dt


def test_braking_takes_its_time_and_standing_still_none() -> None:
    limits = JointLimits(-2.0, 2.0, 3.5, 35.0)
    assert limits.brake(1.0, 0.0, 0.02) == (1.0, 0.0)
    assert limits.brake(1.0, 3.5, 0.0) == (1.0, 3.5)
    position, velocity = limits.brake(1.0, -3.5, 0.02)
    assert velocity == pytest.approx(-2.8)
    assert position == pytest.approx(1.0 - 2.8 * 0.02)
    assert JointLimits(-2.0, 2.0, 3.5).brake(1.0, 3.5, 0.02) == (1.0, 0.0)


@pytest.mark.parametrize("value", ["0.1", None, 1j, [0.1]])
def test_a_command_that_is_no_number_is_refused(value: object) -> None:
    with pytest.raises(CommandError, match="for joint a refused: expected a finite number"):
        check_command([value], ["a"])  # type: ignore[list-item]
