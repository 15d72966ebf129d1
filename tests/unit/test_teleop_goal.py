"""Inverse control from the keys: they move the goal, from the effector on; the display says where."""

from __future__ import annotations

from dataclasses import replace

import pytest
from typed_keys import Typed, press

from softsim_core.scene import load_scene
from softsim_ros.client import STALE_AFTER_S, EffectorPose, RobotState, with_inverse
from softsim_ros.keys import GOAL_KEYS, CallAction, KeyPress
from softsim_ros.nodes.teleop import View, render

TRIPOD = load_scene("tripod")
EFFECTOR = EffectorPose((0.001, -0.002, 0.031), (0.0, 0.0, 0.6, 0.8))
ON = Typed(
    RobotState(measured=(-1.0, -1.0, -1.0), measured_at=0.0, inverse=True, effector=EFFECTOR, effector_at=0.0)
)


def moved(state: Typed, name: str, now: float = 0.0) -> tuple[Typed, EffectorPose]:
    """The one goal a key publishes."""
    state, effects = press(state, TRIPOD, KeyPress(name), now)
    assert len(effects) == 1
    assert isinstance(effects[0], EffectorPose)
    assert effects[0] == state.state.goal
    return state, effects[0]


def view_of(typed: Typed) -> View:
    return View(TRIPOD, typed.state, typed.keys, typed.message, 0.0, "/tripod")


@pytest.mark.parametrize(
    ("name", "shift"),
    [
        ("up", (2, 0, 0)), ("down", (-2, 0, 0)), ("left", (0, 2, 0)), ("right", (0, -2, 0)),
        ("plus", (0, 0, 2)), ("minus", (0, 0, -2)),
    ],
)  # fmt: skip
def test_a_key_moves_the_goal_by_two_millimetres_from_the_effector(
    name: str, shift: tuple[int, int, int]
) -> None:
    _, goal = moved(ON, name)
    expected = [value + 1e-3 * step for value, step in zip(EFFECTOR.position, shift, strict=True)]
    assert goal.position == pytest.approx(expected, abs=1e-12)
    assert goal.quaternion_xyzw == EFFECTOR.quaternion_xyzw


def test_the_goal_goes_on_from_the_goal_not_from_the_effector() -> None:
    state, _ = moved(ON, "up")
    state, goal = moved(state, "plus", 1.0)
    assert goal.position == pytest.approx((0.003, -0.002, 0.033))
    again = Typed(with_inverse(replace(state.state, effector_at=2.0), True))
    _, goal = moved(again, "up", 2.0)  # off and on again
    assert goal.position == pytest.approx((0.003, -0.002, 0.031))


def test_a_held_key_moves_ten_steps_a_second() -> None:
    state, goals = ON, 0
    for tick in range(101):
        state, effects = press(state.knowing(effector_at=0.01 * tick), TRIPOD, KeyPress("up"), 0.01 * tick)
        goals += len(effects)
    assert 10 <= goals <= 11


def test_without_an_effector_nothing_is_published() -> None:
    state, effects = press(ON, TRIPOD, KeyPress("up"), STALE_AFTER_S + 1.0)
    assert effects == ()
    assert "no effector pose" in state.message


@pytest.mark.parametrize("action", ["inverse", "reset", "pause", "send"])
def test_the_other_actions_still_work(action: str) -> None:
    key = {"inverse": "i", "reset": "r", "pause": "space", "send": "b"}[action]
    assert press(ON, TRIPOD, KeyPress(key), 0.0)[1] == (CallAction(action),)  # type: ignore[arg-type]


def test_the_display_shows_goal_effector_distance_and_keys() -> None:
    state, _ = moved(ON.knowing(inverse_note="unreachable, 3.2 mm away"), "plus")
    text = "\n".join(render(view_of(state), 120, 30))
    for wanted in (
        "inverse control: on (unreachable, 3.2 mm away)",
        "goal mm: x 1.0 y -2.0 z 33.0   effector: x 1.0 y -2.0 z 31.0   off by 2.00",
        "up  goal +x",
        "left  goal +y",
        "-  goal -z",
        "i  inverse control (again: off)",
    ):
        assert wanted in text
    for absent in ("servo 0 up", "mid pose", "start pose"):
        assert absent not in text
    text = "\n".join(render(view_of(Typed(with_inverse(state.state, False))), 120, 30))
    assert "goal mm" not in text


def test_every_goal_key_fits_a_small_terminal() -> None:
    for width in range(1, 100):
        lines = render(view_of(ON), width, 12)
        assert all(len(line) <= width for line in lines)
    assert len(GOAL_KEYS) == 6
