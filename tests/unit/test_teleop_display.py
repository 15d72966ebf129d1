"""The status display fits every terminal and shows what matters."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, seed, settings, strategies as st

from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import JointDescription, RobotDescription, SceneDescription, load_scene
from softsim_ros.client import RobotState
from softsim_ros.keys import KeyState
from softsim_ros.nodes.teleop import WARNING_S, View, bar, frame, render

TRIPOD = load_scene("tripod")
STATE = RobotState(
    measured=(-1.4963, -1.0, 0.0),
    measured_at=10.0,
    commanded=(-1.4965, -1.1, -0.5),
    bridge="no-comm",
)
KEYS = KeyState(last_key="Ctrl+Up")
MESSAGE = "servo_0 to -1.3965 rad (-80.0 deg)"


def shown(
    state: RobotState = STATE,
    size: tuple[int, int] = (80, 24),
    now: float = 10.0,
    *,
    keys: KeyState = KEYS,
    message: str = MESSAGE,
    notice: str = "",
    warning: str = "",
    warned_at: float = 0.0,
) -> list[str]:
    view = View(TRIPOD, state, keys, message, now, "/tripod", notice, warning, warned_at)
    return render(view, *size)


def test_a_usual_terminal_shows_everything() -> None:
    text = "\n".join(shown())
    for wanted in (
        "tripod teleop", "/tripod", "simulator: running", "servo bridge: no-comm", "key: Ctrl+Up",
        "> servo_0 to -1.3965 rad (-80.0 deg)", "Ctrl+C quits",
        "up  servo 0 up", "+  servo 2 up", "a  start pose", "b  send to the board (again: stop)", "x  quit",
        "space  pause", "r  reset",
    ):  # fmt: skip
        assert wanted in text
    row = next(line for line in shown() if line.startswith("servo_0"))
    assert row.split() == [
        "servo_0",
        "-2.0225",
        row.split()[2],
        "-0.0255",
        "-1.4965",
        "-85.7",
        "-1.4963",
        "-85.7",
    ]


def test_a_latched_e_stop_is_shown_with_the_key_that_releases_it() -> None:
    text = "\n".join(shown(replace(STATE, bridge="comm", e_stopped=True)))
    assert "servo bridge: E-STOP latched, e releases it; comm (sending)" in text
    assert "enter  E-STOP" in text
    assert "E-STOP latched" not in "\n".join(shown())


@pytest.mark.parametrize(("age", "stays"), [(0.0, True), (WARNING_S, True), (WARNING_S + 0.1, False)])
def test_a_warning_stands_beside_the_answer_for_a_while(age: float, stays: bool) -> None:
    lines = shown(warning="servo_bridge: no answer", warned_at=5.0, now=5.0 + age)
    assert f"> {MESSAGE}" in lines
    assert ("! servo_bridge: no answer" in lines) is stays


@seed(23)
@settings(max_examples=300, deadline=None)
@given(
    width=st.integers(1, 200), height=st.integers(1, 60), message=st.text(max_size=300), known=st.booleans()
)
def test_it_fits_every_size(width: int, height: int, message: str, known: bool) -> None:
    lines = shown(STATE if known else RobotState(), (width, height), message=message)
    assert 1 <= len(lines) <= height
    assert all(len(line) <= width and ((line.isascii() and line.isprintable()) or not line) for line in lines)


@pytest.mark.parametrize(
    ("size", "wanted", "absent"),
    [
        ((80, 12), ["servo_2", "simulator", "> servo_0", "key:"], ["start pose"]),
        ((80, 6), ["servo_2", "simulator", "> servo_0"], ["start pose", "tripod teleop"]),
        ((60, 24), ["servo_2", "-85.7", "start pose"], ["[-"]),
        ((30, 10), ["servo_2", "-1.4963"], ["-85.7"]),
        ((20, 3), ["servo_0", "servo_2"], ["simulator"]),
    ],
)
def test_small_terminals_keep_what_matters(
    size: tuple[int, int], wanted: list[str], absent: list[str]
) -> None:
    text = "\n".join(shown(size=size))
    assert all(word in text for word in wanted)
    assert not any(word in text for word in absent)


@pytest.mark.parametrize(
    ("state", "now", "wanted"),
    [
        (RobotState(), 0.0, "simulator: no data yet"),
        (STATE, 14.0, "simulator: no data for 4 s"),
        (replace(STATE, simulator="paused"), 10.0, "simulator: paused"),
        (replace(STATE, simulator="paused"), 14.0, "simulator: paused"),
        (replace(STATE, simulator="stopped"), 10.0, "simulator: stopped"),
        (
            replace(STATE, simulator="running", real_time_factor=0.5),
            10.0,
            "simulator: running at 0.50 x real time",
        ),
        (replace(STATE, enforce_limits=False), 10.0, "simulator: running, limits off"),
        (STATE, 10.0, "no-comm (ready, not sending)"),
        (replace(STATE, bridge="comm"), 10.0, "comm (sending)"),
        (replace(STATE, bridge="init"), 10.0, "init (port closed)"),
        (RobotState(), 0.0, "servo bridge: not running"),
        (replace(STATE, inverse=True), 10.0, "inverse control: on"),
        (replace(STATE, pulses_at=9.0), 10.0, "emulated board: pulses none yet (us)"),
        (
            replace(STATE, pulses_at=9.0, pulses_us=(1472.06, 1781.3, 2090.7)),
            10.0,
            "emulated board: pulses 1472 1781 2091 (us)",
        ),
    ],
)
def test_states_have_words(state: RobotState, now: float, wanted: str) -> None:
    assert wanted in "\n".join(shown(state, (120, 24), now))


def test_pulses_that_nobody_measures_any_more_are_not_shown() -> None:
    assert "emulated" not in "\n".join(shown(replace(STATE, pulses_at=7.0), now=10.0))


def test_help_can_be_hidden() -> None:
    lines = shown(keys=replace(KEYS, show_help=False))
    assert "? shows the keys" in lines
    assert not any("start pose" in line for line in lines)


def test_the_address_of_the_page_stays_beside_newer_sentences() -> None:
    address = "open http://127.0.0.1:8080/?token=GvPy0jZkqVd in a browser"
    assert address in shown(notice=address)
    assert f"> {MESSAGE}" in shown(notice=address)
    assert address not in shown(size=(80, 8), notice=address)


def test_a_long_message_is_wrapped() -> None:
    lines = shown(size=(40, 30), message="word " * 30)
    assert sum("word" in line for line in lines) == 3


JOINT = JointDescription(name="j", limits=JointLimits(lower=-1.0, upper=1.0))


@pytest.mark.parametrize(
    ("measured", "commanded", "expected"),
    [
        (-1.0, 1.0, "[o-------|]"),
        (0.0, 0.0, "[----#----]"),
        (-9.0, 9.0, "[o-------|]"),
        (0.5, None, "[------o--]"),
        (None, None, "[---------]"),
    ],
)
def test_bars(measured: float | None, commanded: float | None, expected: str) -> None:
    assert bar(JOINT, measured, commanded, 11) == expected


def test_joints_without_limits() -> None:
    turning = JointDescription(name="turning")
    slide = JointDescription(name="slide", kind="prismatic")
    assert bar(turning, 0.0, math.pi, 11) == "[----o---|]"
    assert bar(slide, 0.0, 1.0, 11) == "[---------]"
    robot = RobotDescription(scene=SceneDescription(name="two", joints=(turning, slide)))
    state = RobotState(measured=(1.0, 0.0123), measured_at=0.0)
    lines = render(View(robot, state, KEYS, "", 0.0, "/two"), 100, 24)
    assert any("57.3" in line and "inf" in line for line in lines)
    assert any("12.3" in line for line in lines)
    assert any("rad|m" in line and "deg|mm" in line for line in lines)


def test_a_frame_overwrites_and_clears_the_rest() -> None:
    text = frame(["one", "two"], 24)
    assert "\x1b[Hone\x1b[K\r\ntwo\x1b[K\x1b[J" in text
    assert "\x1b[J" not in frame(
        ["one", "two"], 2
    )  # would clear the last column's neighbour on some terminals
