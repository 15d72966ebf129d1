"""Motion of the servos on an injected clock: limits, ramps, refusals, hold, rest, e-stop."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings, strategies as st

from servo_bridge.driver import (
    SERVO_ACCELERATION,
    SERVO_SPEED,
    MotionSettings,
    ServoMotion,
    byte_to_angle,
    servo_limits,
)
from softsim_core.base import CommandError, SceneError
from softsim_core.physics.mechanics import JointLimits, check_command
from softsim_core.scene import ServoCalibration

SERVO = ServoCalibration(joint="servo_0")
LIMITS = servo_limits(SERVO, JointLimits(-2.0225, -0.0255, 3.5, acceleration=1e9))
REAL = servo_limits(SERVO, JointLimits(-2.0225, -0.0255, 3.5))
REST = byte_to_angle(150, SERVO)
NAMES = ("servo_0", "servo_1", "servo_2")
PERIOD = 0.02


def tripod_motion(**changes: float) -> ServoMotion:
    motion = ServoMotion(NAMES, [LIMITS] * 3, [REST] * 3, MotionSettings(**changes))
    motion.start(0.0)
    assert motion.step(0.0) == (REST,) * 3
    return motion


def real_motion() -> ServoMotion:
    """With the acceleration limit of a hobby servo."""
    motion = ServoMotion(NAMES, [REAL] * 3, [REST] * 3)
    motion.start(0.0)
    motion.step(0.0)
    return motion


def run(motion: ServoMotion, start: float, end: float) -> list[tuple[float, ...]]:
    """Positions of the steps after `start` up to `end`, one a period."""
    first, last = round(start / PERIOD) + 1, round(end / PERIOD)
    return [motion.step(step * PERIOD) for step in range(first, last + 1)]


def test_the_first_pose_is_rest_and_nothing_moves_without_a_command() -> None:
    motion = tripod_motion()
    assert set(run(motion, 0.0, 5.0)) == {(REST,) * 3}
    assert motion.mode == "rest"


def test_a_command_is_reached_at_the_speed_limit_and_kept() -> None:
    motion = tripod_motion()
    motion.command([-1.4965] * 3, 0.0)
    path = [REST] + [positions[0] for positions in run(motion, 0.0, 0.4)]
    for before, after in pairwise(path):
        assert abs(after - before) <= 3.5 * PERIOD + 1e-12
    steps_needed = math.ceil((1.4965 + REST) / (3.5 * PERIOD))
    assert path[steps_needed] == -1.4965 != path[steps_needed - 1]
    assert set(path[steps_needed:]) == {-1.4965}


def test_a_command_beyond_the_limits_is_clamped_and_counted() -> None:
    motion = tripod_motion()
    motion.command([1e9, -1e9, -1.0], 0.0)
    assert run(motion, 0.0, 0.5)[-1] == (-0.0255, -2.0225, -1.0)
    assert motion.clipped == 1


def test_a_robot_at_rest_beyond_the_limits_is_clipped_once() -> None:
    """Joint states of the simulated Tripod before its start animation: 0 rad, at 100 Hz."""
    motion = tripod_motion()
    for count in range(100):
        motion.command([0.0] * 3, 0.01 * count)
    assert motion.clipped == 1
    motion.command([-1.0] * 3, 1.0)
    motion.command([0.0] * 3, 1.01)
    assert motion.clipped == 2


def test_only_the_newest_command_counts() -> None:
    motion = tripod_motion()
    for target in (-2.0, -0.1, -1.2):
        motion.command([target] * 3, 0.0)
    assert run(motion, 0.0, 0.4)[-1] == (-1.2,) * 3


def test_silence_holds_after_half_a_second_and_goes_slowly_to_rest_after_two() -> None:
    motion = tripod_motion()
    motion.command([-1.5] * 3, 0.0)
    run(motion, 0.0, 0.5)
    assert motion.mode == "track"
    assert set(run(motion, 0.5, 2.0)) == {(-1.5,) * 3}
    assert motion.mode == "hold"
    creep = [-1.5] + [positions[0] for positions in run(motion, 2.0, 5.0)]
    assert motion.mode == "rest"
    assert all(0.0 <= after - before <= 0.5 * PERIOD + 1e-12 for before, after in pairwise(creep))
    assert creep[-1] == REST


def test_silence_in_the_middle_of_a_ramp_stops_it() -> None:
    motion = tripod_motion(hold_timeout_s=0.1)
    motion.command([-2.0] * 3, 0.0)
    stopped = run(motion, 0.0, 0.1)[-1]
    assert stopped[0] > -2.0
    assert set(run(motion, 0.1, 1.0)) == {stopped}


def test_the_e_stop_holds_whatever_is_commanded_until_it_is_cleared() -> None:
    motion = tripod_motion()
    motion.command([-1.5] * 3, 0.0)
    stopped = run(motion, 0.0, 0.1)[-1]
    motion.e_stop.latch()
    motion.command([-0.1] * 3, 0.1)
    assert set(run(motion, 0.1, 30.0)) == {stopped}
    assert motion.step_to_rest(30.02) == stopped
    assert motion.mode == "e_stop"
    motion.e_stop.clear()
    assert motion.step(30.04) == stopped  # a command from before the release does not count
    motion.command([-1.0] * 3, 30.04)
    assert motion.step(30.06) != stopped


def test_start_forgets_old_commands_but_not_the_pose() -> None:
    motion = tripod_motion()
    motion.command([-1.0] * 3, 0.0)
    pose = run(motion, 0.0, 0.4)[-1]
    motion.command([-2.0] * 3, 0.4)
    motion.start(0.41)
    assert motion.step(0.43) == pose
    motion.command([-2.0] * 3, 0.43)
    motion.start(0.44)
    motion.command([-2.0] * 3, 0.44)
    assert motion.step(0.46) == pose  # the first packet is the last known pose, whatever is commanded
    assert motion.step(0.48) != pose


def test_a_stall_is_not_caught_up_with_one_jump() -> None:
    motion = tripod_motion()
    motion.command([-2.0] * 3, 0.0)
    motion.step(0.02)
    before = motion.positions[0]
    motion.step(0.45)
    assert abs(motion.positions[0] - before) <= 3.5 * motion.settings.longest_step_s + 1e-12


def test_a_clock_that_stands_or_steps_back_moves_nothing() -> None:
    motion = tripod_motion()
    motion.command([-2.0] * 3, 1.0)
    motion.start(1.0)
    motion.command([-2.0] * 3, 1.0)
    assert motion.step(1.0) == (REST,) * 3
    assert motion.step(0.5) == (REST,) * 3


def test_the_way_to_rest_ends_exactly_there() -> None:
    motion = tripod_motion()
    motion.command([-2.0, -0.1, REST], 0.0)
    run(motion, 0.0, 0.5)
    assert not motion.at_rest
    for step in range(26, 80):
        motion.step_to_rest(step * PERIOD)
    assert motion.at_rest


def test_servo_limits_are_narrowed_to_the_bytes() -> None:
    full_turn = servo_limits(SERVO, JointLimits(-10.0, 10.0, math.inf))
    assert (full_turn.lower, full_turn.upper) == (byte_to_angle(60, SERVO), byte_to_angle(180, SERVO))
    assert full_turn.speed == SERVO_SPEED
    assert full_turn.acceleration == SERVO_ACCELERATION
    mirrored = servo_limits(
        ServoCalibration(joint="j", sign=-1, zero_byte=90, byte_max=170, rest_byte=90), JointLimits()
    )
    assert mirrored.lower == pytest.approx(math.radians(-80.0))
    assert mirrored.upper == pytest.approx(math.radians(30.0))


def test_a_rest_byte_outside_the_limits_is_refused() -> None:
    with pytest.raises(SceneError, match="rest_byte 150"):
        servo_limits(SERVO, JointLimits(-2.0, -1.0, 3.5))


def test_speed_is_gained_and_lost_within_the_acceleration_limit() -> None:
    motion = real_motion()
    motion.command([-2.0] * 3, 0.0)
    path = [REST, *(positions[0] for positions in run(motion, 0.0, 0.5))]
    motion.command([-0.1] * 3, 0.5)  # and back from the middle of nowhere
    path += [positions[0] for positions in run(motion, 0.5, 0.7)]
    motion.command([-2.0] * 3, 0.7)
    path += [positions[0] for positions in run(motion, 0.7, 1.2)]
    speeds = [(after - before) / PERIOD for before, after in pairwise([REST, *path])]
    assert max(map(abs, speeds)) == pytest.approx(3.5)
    assert max(abs(b - a) for a, b in pairwise(speeds)) <= SERVO_ACCELERATION * PERIOD + 1e-9
    assert path[-1] == -2.0


def test_silence_brakes_and_the_e_stop_stops_at_once() -> None:
    for stop, least_travel in ((False, 0.1), (True, 0.0)):
        motion = real_motion()
        motion.command([-2.0] * 3, 0.0)
        before = run(motion, 0.0, 0.2)[-1][0]
        motion.settings = MotionSettings(hold_timeout_s=0.2)
        if stop:
            motion.e_stop.latch()
        travel = before - run(motion, 0.2, 1.0)[-1][0]
        assert least_travel <= travel <= 3.5**2 / (2 * SERVO_ACCELERATION)
        assert (travel == 0.0) == stop


events = st.lists(
    st.tuples(
        st.floats(0.0, 0.3),  # time since the event before
        st.one_of(
            st.lists(st.floats(-1e9, 1e9), min_size=3, max_size=3),
            st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=4),
            st.sampled_from(["stop", "clear", "start", "rest", "step", "step", "step"]),
        ),
    ),
    max_size=80,
)


@pytest.mark.slow
@settings(derandomize=True, max_examples=400)
@given(events)
def test_no_sequence_of_commands_breaks_position_or_speed_limits(
    sequence: list[tuple[float, list[float] | str]],
) -> None:
    motion, now = tripod_motion(), 0.0
    before, since = motion.positions, 0.0
    for gap, event in sequence:
        now += gap
        if event == "stop":
            motion.e_stop.latch()
        elif event == "clear":
            motion.e_stop.clear()
        elif event == "start":
            motion.start(now)
        elif isinstance(event, list):
            try:
                motion.command(check_command(event, NAMES), now)
            except CommandError:
                assert len(event) != 3 or not all(math.isfinite(value) for value in event)
        else:
            after = motion.step(now) if event == "step" else motion.step_to_rest(now)
            for old, new in zip(before, after, strict=True):
                assert LIMITS.lower <= new <= LIMITS.upper
                assert abs(new - old) <= 3.5 * (now - since) + 1e-12
            before, since = after, now
