"""What keys do: steps from the measured position, limits, poses, actions, repeats, refusals."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, seed, settings, strategies as st
from typed_keys import Typed, press

from softsim_core.base import SoftSimError
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import (
    KEY_NAMES,
    CommandSettings,
    JointDescription,
    KeyBinding,
    RobotDescription,
    SceneDescription,
    load_scene,
)
from softsim_ros.client import (
    STALE_AFTER_S,
    GoToPose,
    MoveAll,
    MoveJoint,
    RobotState,
    StepJoints,
    commandable,
    decide,
    format_command,
    format_position,
    stationary_commands,
    with_command,
    with_measurement,
    with_received_command,
)
from softsim_ros.keys import CallAction, KeyPress, Quit, key_table

TRIPOD = load_scene("tripod")
FREE = replace(TRIPOD, commands=CommandSettings(enforce_limits=False))
AT = (-1.0, -1.1, -1.2)
MEASURED = Typed(RobotState(measured=AT, measured_at=0.0))
HERE = MEASURED.state


def published(
    typed: Typed, name: str, now: float = 0.0, robot: RobotDescription = TRIPOD
) -> tuple[float, ...]:
    """The one command a key publishes."""
    _, effects = press(typed, robot, KeyPress(name), now)
    assert len(effects) == 1
    assert type(effects[0]) is tuple
    return effects[0]


@pytest.mark.parametrize("ctrl", [False, True])
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("up", (-0.9, -1.1, -1.2)),
        ("down", (-1.1, -1.1, -1.2)),
        ("left", (-1.0, -1.0, -1.2)),
        ("right", (-1.0, -1.2, -1.2)),
        ("plus", (-1.0, -1.1, -1.1)),
        ("minus", (-1.0, -1.1, -1.3)),
        ("q", (-3.14 / 3,) * 3),
        ("z", (-3.14 / 4,) * 3),
    ],
)
def test_the_tripods_keys(name: str, ctrl: bool, expected: tuple[float, ...]) -> None:
    typed, effects = press(MEASURED, TRIPOD, KeyPress(name, ctrl), 0.0)
    assert effects == (pytest.approx(expected),)
    assert typed.state.commanded == effects[0]
    assert typed.keys.last_key == str(KeyPress(name, ctrl))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("plus", (0.0015, 0.001, 0.021, -0.01, 0.02)),
        ("minus", (0.0, 0.0, 0.019, -0.01, 0.02)),  # not below 0
        ("up", (0.0005, 0.0, 0.02, -0.009, 0.02)),
        ("down", (0.0005, 0.0, 0.02, -0.011, 0.02)),
        ("left", (0.0005, 0.0, 0.02, -0.01, 0.021)),
        ("right", (0.0005, 0.0, 0.02, -0.01, 0.019)),
    ],
)
def test_the_grippers_keys(name: str, expected: tuple[float, ...]) -> None:
    """Plus closes all fingers by 1 mm, minus opens them; arrows move the whole gripper by 1 mm."""
    state = Typed(RobotState(measured=(0.0005, 0.0, 0.02, -0.01, 0.02), measured_at=0.0))
    assert published(state, name, robot=load_scene("cable_gripper")) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "action"), [("a", "start"), ("b", "send"), ("i", "inverse"), ("r", "reset"), ("space", "pause")]
)
def test_action_keys_need_no_measurement(name: str, action: str) -> None:
    for ctrl in (False, True):
        _, effects = press(Typed(), TRIPOD, KeyPress(name, ctrl), 0.0)
        assert effects == (CallAction(action),)


@pytest.mark.parametrize("key", [KeyPress("x"), KeyPress("x", True), KeyPress("c", True)])
def test_quitting(key: KeyPress) -> None:
    assert press(Typed(), TRIPOD, key, 0.0)[1] == (Quit(),)


def test_a_step_starts_from_the_last_command() -> None:
    commanded = MEASURED.knowing(commanded=(-0.2, -0.3, -0.4), trusted_until=10.0)
    assert published(commanded, "up") == pytest.approx((-0.1, -0.3, -0.4))
    moved_since = MEASURED.knowing(commanded=(-0.2, -0.3, -0.4), trusted_until=-1.0)
    assert published(moved_since, "up") == pytest.approx((-0.9, -1.1, -1.2))


def test_eight_quick_presses_are_eight_steps_of_each_finger_however_far_they_have_come() -> None:
    gripper = load_scene("cable_gripper")
    typed = Typed(RobotState(measured=(0.0,) * 5, measured_at=0.0))
    for number in range(8):
        now = 0.11 * number
        late = tuple(0.6 * each for each in typed.state.commanded or (0.0,) * 5)  # fingers lag behind
        typed, effects = press(typed.knowing(measured=late, measured_at=now), gripper, KeyPress("plus"), now)
        assert len(effects) == 1
    assert typed.state.commanded == pytest.approx((0.008, 0.008, 0.008, 0.0, 0.0))


def test_other_joints_keep_a_command_unless_something_else_moved_them() -> None:
    state = with_command(HERE, TRIPOD, (-1.0, -0.5, -1.205), now=0.0)
    assert stationary_commands(state, 0.1) == (-1.0, -0.5, -1.205)  # still on the way
    later = with_measurement(state, AT, 9.0)
    assert stationary_commands(later, 9.0) == (-1.0, -1.1, -1.205)  # joint 1 was moved; joint 2 only sags
    assert stationary_commands(HERE, 0.0) == AT


def test_commands_of_others_are_adopted_and_own_echoes_are_not() -> None:
    typed, _ = press(MEASURED, TRIPOD, KeyPress("up"), 0.0)
    first = typed.state.commanded
    assert first is not None
    typed, _ = press(typed, TRIPOD, KeyPress("left"), 0.0)
    state, second = typed.state, typed.state.commanded
    state = with_received_command(state, TRIPOD, first, 0.01)  # late echo of the first
    assert state.commanded == second
    state = with_received_command(state, TRIPOD, second or (), 0.02)
    assert (state.commanded, state.echoes) == (second, ())
    assert with_received_command(state, TRIPOD, second or (), 0.03) == state  # repeated
    others = with_received_command(state, TRIPOD, (-0.5, -0.5, -0.5), 0.03)
    assert (state.owns_command, others.owns_command) == (True, False)
    assert others.commanded == (-0.5, -0.5, -0.5)
    for nonsense in ((1.0,), (math.nan, 0.0, 0.0)):
        assert with_received_command(state, TRIPOD, nonsense, 0.04) == state


def test_limits_stop_a_step_and_say_so() -> None:
    near = MEASURED.measuring((-0.05, -2.0, -1.0), 0.0)
    state, effects = press(near, TRIPOD, KeyPress("up"), 0.0)
    assert effects == ((-0.0255, -2.0, -1.0),)
    assert state.message == "servo_0 stops at its upper limit -0.0255 rad (-1.5 deg)"
    state, _ = press(near, TRIPOD, KeyPress("right"), 0.0)
    assert state.message == "servo_1 stops at its lower limit -2.0225 rad (-115.9 deg)"


def test_limits_that_are_not_enforced_allow_full_turns() -> None:
    near = MEASURED.measuring((3.1, -2.0, -1.0), 0.0)
    assert published(near, "up", robot=FREE) == pytest.approx((3.2, -2.0, -1.0))


def test_the_simulators_switch_of_the_limits_wins() -> None:
    near = MEASURED.measuring((-0.05, -2.0, -1.0), 0.0)
    assert published(near.knowing(enforce_limits=False), "up")[0] == pytest.approx(0.05)
    assert published(near.knowing(enforce_limits=True), "up", robot=FREE)[0] == -0.0255


def test_slides_are_shown_in_metres() -> None:
    robot = RobotDescription(
        scene=SceneDescription(
            name="slide",
            joints=(JointDescription(name="rail", kind="prismatic", limits=JointLimits(upper=0.01)),),
        ),
        keys={"up": KeyBinding(joints=("rail",), by=0.002, help="out")},
    )
    state, _ = press(Typed(RobotState(measured=(0.001,), measured_at=0.0)), robot, KeyPress("up"), 0.0)
    assert state.message == "rail to 0.0030 m (3.0 mm)"


def test_a_held_key_steps_ten_times_a_second() -> None:
    state, times = MEASURED, []
    for tick in range(91):  # 3 s of key repeat at 30 Hz
        now = tick / 30.0
        state, effects = press(state.measuring(AT, now), TRIPOD, KeyPress("up"), now)
        times += [now] * len(effects)
    assert 25 <= len(times) <= 31
    assert min(b - a for a, b in pairwise(times)) >= 0.1 - 1e-9
    _, effects = press(state, TRIPOD, KeyPress("left"), now)  # other keys are not held back
    assert effects


def test_a_slow_joint_is_stepped_slower() -> None:
    slow = JointDescription(name="slow", limits=JointLimits(speed=0.1))
    robot = RobotDescription(
        scene=SceneDescription(name="one", joints=(slow,)),
        keys={"up": KeyBinding(joints=("slow",), by=0.1, help="up")},
    )
    state, effects = press(Typed(RobotState(measured=(0.0,), measured_at=0.0)), robot, KeyPress("up"), 0.0)
    assert effects
    state, effects = press(state, robot, KeyPress("up"), 0.9)
    assert not effects
    assert press(state, robot, KeyPress("up"), 1.0)[1]


@pytest.mark.parametrize("name", ["b", "space", "i", "r", "a"])
def test_a_held_action_key_acts_once(name: str) -> None:
    state, count = MEASURED, 0
    for now in (0.0, *(0.66 + tick / 25.0 for tick in range(50))):  # X11's slowest delay, then repeats
        state, effects = press(state, TRIPOD, KeyPress(name), now)
        count += len(effects)
    assert count == 1
    assert press(state, TRIPOD, KeyPress(name), now + 1.0)[1]  # released, pressed again


def test_nothing_moves_without_a_measurement() -> None:
    state, effects = press(Typed(), TRIPOD, KeyPress("up"), 0.0)
    assert not effects
    assert "no joint_states received yet" in state.message
    late = STALE_AFTER_S + 1.0
    state, effects = press(MEASURED, TRIPOD, KeyPress("q"), late)
    assert not effects
    assert "no joint_states for 3 s" in state.message
    state, effects = press(MEASURED.knowing(simulator="paused"), TRIPOD, KeyPress("q"), late)
    assert not effects
    assert "paused" in state.message


def test_a_non_finite_measurement_is_not_used() -> None:
    assert with_measurement(HERE, (0.0, math.nan, 0.0), 1.0) is HERE


@pytest.mark.parametrize("name", ["q", "z"])
def test_inverse_control_owns_the_joints(name: str) -> None:
    state, effects = press(MEASURED.knowing(inverse=True), TRIPOD, KeyPress(name), 0.0)
    assert effects == ()
    assert "inverse control" in state.message


def test_unbound_keys_and_help() -> None:
    state, effects = press(MEASURED, TRIPOD, KeyPress("k"), 0.0)
    assert not effects
    assert "k is not bound" in state.message
    state, effects = press(state, TRIPOD, KeyPress("?"), 0.0)
    assert not effects
    assert not state.keys.show_help


def test_a_robot_may_bind_the_built_in_keys_itself() -> None:
    robot = replace(TRIPOD, keys={"x": KeyBinding(pose="mid", help="mid pose")})
    assert published(MEASURED, "x", robot=robot) == pytest.approx((-3.14 / 3,) * 3)
    assert press(MEASURED, robot, KeyPress("c", True), 0.0)[1] == (Quit(),)
    assert list(key_table(robot)) == ["x", "space", "r", "enter", "e"]


def test_the_e_stop_acts_at_every_press_and_only_where_there_is_a_board() -> None:
    state = MEASURED
    for at in (0.0, 0.1, 0.2):  # pressed in fright, again and again
        state, effects = press(state, TRIPOD, KeyPress("enter"), at)
        assert effects == (CallAction("e_stop"),)
    state, effects = press(state, TRIPOD, KeyPress("e"), 0.3)
    assert effects == (CallAction("clear_e_stop"),)
    assert press(state, TRIPOD, KeyPress("e"), 0.4)[1] == ()  # held
    assert press(state, TRIPOD, KeyPress("enter"), 0.5)[1] == (CallAction("e_stop"),)
    assert "enter" not in key_table(load_scene("cable_gripper"))
    stopping = press(MEASURED.knowing(inverse=True), TRIPOD, KeyPress("enter"), 0.0)
    assert stopping[1] == (CallAction("e_stop"),)


def test_keys_no_terminal_sends_are_refused() -> None:
    with pytest.raises(SoftSimError, match=r"keys.uparrow must be the name of a key: .*, up"):
        replace(TRIPOD, keys={"uparrow": KeyBinding(pose="mid", help="mid")})


@seed(22)
@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(sorted(KEY_NAMES)),
            st.booleans(),
            st.floats(0.0, 0.3),
            st.tuples(*[st.floats(-4.0, 4.0)] * 3),
        ),
        max_size=40,
    )
)
def test_whatever_is_typed_commands_stay_finite_and_within_limits(
    presses: list[tuple[str, bool, float, tuple[float, ...]]],
) -> None:
    state, now = Typed(), 0.0
    for name, ctrl, pause, positions in presses:
        now += pause
        state = state.measuring(positions, now)
        state, effects = press(state, TRIPOD, KeyPress(name, ctrl), now)
        for effect in effects:
            if type(effect) is tuple:
                assert all(
                    joint.limits.lower <= value <= joint.limits.upper
                    for joint, value in zip(TRIPOD.joints, effect, strict=True)
                )


@pytest.mark.parametrize(
    ("wish", "expected"),
    [
        (MoveJoint("servo_1", -0.5), (-1.0, -0.5, -1.2)),
        (MoveAll((-0.3, -0.4, -9.0)), (-0.3, -0.4, -2.0225)),
        (GoToPose("mid"), (-3.14 / 3,) * 3),
        (StepJoints(("servo_0", "servo_2"), 0.1), (-0.9, -1.1, -1.1)),
        (StepJoints(("servo_0", "servo_2"), (0.1, -0.2)), (-0.9, -1.1, -1.4)),
    ],
)
def test_wishes_of_a_script_become_commands_within_limits(wish: Any, expected: tuple[float, ...]) -> None:
    assert decide(HERE, TRIPOD, wish, 0.0).values == pytest.approx(expected)


@pytest.mark.parametrize(
    ("wish", "word"),
    [
        (MoveJoint("servo_9", 0.0), "unknown joint servo_9; known: servo_0, servo_1, servo_2"),
        (GoToPose("top"), "unknown pose top; known: start"),
        (StepJoints(("a", "servo_0"), 0.1), "unknown joint a;"),
        (MoveAll((0.0, 0.0)), "command of 2 values refused: expected 3"),
        (MoveAll((0.0, math.nan, 0.0)), "expected a finite number"),
        (MoveJoint("servo_1", math.nan), "for joint servo_1 refused: expected a finite number"),
    ],
)
def test_wishes_that_mean_nothing_move_nothing(wish: Any, word: str) -> None:
    decision = decide(HERE, TRIPOD, wish, 0.0)
    assert (decision.values, decision.state) == (None, HERE)
    assert word in decision.message


def test_a_pressure_is_held_where_it_is_and_not_where_the_hollow_is() -> None:
    """The position of a chamber is a volume; what keys step from, and what rests, is its pressure."""
    chambers = load_scene("inflated_cube")
    state = with_measurement(RobotState(), (3.3e-6,), 1.0, (8000.0,))
    assert commandable(state, chambers).measured == (8000.0,)
    assert commandable(with_measurement(state, (3.3e-6,), 1.0), chambers).measured == (3.3e-6,)  # not told
    assert commandable(HERE, TRIPOD) == HERE
    assert format_command(chambers.joints[0], 8000.0) == "8000 Pa (8.0 kPa)"
    assert format_position(chambers.joints[0], 3.3e-6) == "3.3e-06 m^3 (3.3 ml)"
