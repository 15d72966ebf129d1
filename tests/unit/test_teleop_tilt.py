"""Keys while the closed loop gives the goals: they turn its reference."""

from __future__ import annotations

import pytest
from typed_keys import Typed, press

from softsim_core.scene import load_scene
from softsim_ros.client import EffectorPose, RobotState, Tilt
from softsim_ros.keys import KeyPress
from softsim_ros.nodes.teleop import View, render

TRIPOD = load_scene("tripod")
HERE = EffectorPose((0.0, 0.0, 0.05), (0.0, 0.0, 0.0, 1.0))
LOOP = Typed(RobotState(inverse=True, effector=HERE, effector_at=0.0, tilt=Tilt(0.05, 0.0)))


def pressed(*names: str) -> tuple[Typed, list[Tilt]]:
    """The state after some keys, one per second, and the references they publish."""
    state, sent = LOOP, []
    for now, name in enumerate(names):
        state, effects = press(state, TRIPOD, KeyPress(name), float(now))
        for effect in effects:
            assert isinstance(effect, Tilt)
            sent.append(effect)
    return state, sent


def test_arrows_choose_the_axis_and_signs_turn_it_by_a_tenth() -> None:
    state, sent = pressed("plus", "plus", "right", "minus", "up", "minus")
    assert sent == [pytest.approx(pair) for pair in ((0.05, 0.1), (0.05, 0.2), (-0.05, 0.2), (-0.05, 0.1))]
    assert state.state.tilt == sent[-1]
    assert state.message == "tilt reference deg: x -2.9 y 5.7   + and - turn y"


def test_other_goal_keys_move_nothing() -> None:
    state, sent = pressed("left", "down")
    assert (sent, state.state.goal) == ([], None)
    assert state.message == "nothing moved: the closed loop gives the goals"


def test_a_held_key_turns_ten_steps_a_second() -> None:
    state, count = LOOP, 0
    for tick in range(101):
        state, effects = press(state, TRIPOD, KeyPress("plus"), 0.01 * tick)
        count += len(effects)
    assert count == pytest.approx(10, abs=1)


def test_without_inverse_control_the_keys_drive_the_joints() -> None:
    state = LOOP.knowing(inverse=False, measured=(-1.0, -1.0, -1.0), measured_at=0.0)
    _, effects = press(state, TRIPOD, KeyPress("plus"), 0.0)
    assert not any(isinstance(effect, Tilt) for effect in effects)


def test_the_display_says_what_the_keys_turn() -> None:
    shown = "\n".join(render(View(TRIPOD, LOOP.state, LOOP.keys, "", 0.0, "/tripod"), 100, 40))
    assert "tilt reference deg: x 2.9 y 0.0   + and - turn y" in shown
    assert "tilt about x" in shown
    assert "goal +x" not in shown
