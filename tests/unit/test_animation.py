"""Animations: exact factors, modes, delay, end, state, failing callbacks."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softsim_core.actuation.animation import Animation, AnimationPlayer, factor_at, is_over
from softsim_core.errors import CommandError, SceneError, SnapshotError

RISE = [step / 20 for step in range(21)]


def play(animation: Animation, steps: int, dt: float = 0.01, start: float = 0.0) -> AnimationPlayer:
    player = AnimationPlayer([animation])
    player.play(0, start)
    for step in range(steps):
        player.begin_step(start + step * dt)
    return player


def test_once_gives_exactly_21_calls_from_0_to_1() -> None:
    factors: list[float] = []
    done: list[int] = []
    player = play(Animation(factors.append, 0.2, on_done=lambda: done.append(len(factors))), steps=50)
    assert factors == RISE
    assert done == [21]
    assert player.playing == ()


def test_a_summed_clock_gives_the_same_factors() -> None:
    factors: list[float] = []
    player = AnimationPlayer([Animation(factors.append, 0.2)])
    time = 1234.56
    player.play(0, time)
    for _ in range(50):
        player.begin_step(time)
        time += 0.01
    assert factors == RISE


def test_the_last_call_is_1_when_the_duration_is_no_multiple_of_dt() -> None:
    factors: list[float] = []
    play(Animation(factors.append, 0.1), steps=9, dt=0.03)
    assert factors == pytest.approx([0.0, 0.3, 0.6, 0.9, 1.0])
    assert factors[-1] == 1.0


def test_loop_and_pingpong_go_on() -> None:
    looped: list[float] = []
    done: list[int] = []
    player = play(Animation(looped.append, 0.2, "loop", on_done=lambda: done.append(1)), steps=61)
    assert looped == RISE + RISE[1:] * 2
    assert (player.playing, done) == ((0,), [])
    both_ways: list[float] = []
    play(Animation(both_ways.append, 0.2, "pingpong"), steps=61)
    assert both_ways == RISE + RISE[-2::-1] + RISE[1:]


def test_delay_is_waited_for() -> None:
    calls: list[tuple[int, float]] = []
    step = 0
    player = AnimationPlayer([Animation(lambda factor: calls.append((step, factor)), 0.02, delay=0.07)])
    player.play(0, 5.0)
    for step in range(20):
        player.begin_step(5.0 + step * 0.01)
    assert calls == [(7, 0.0), (8, 0.5), (9, 1.0)]


def test_start_counts_from_the_first_call() -> None:
    factors: list[float] = []
    player = AnimationPlayer([Animation(factors.append, 0.2)])
    player.play(0, 0.0)
    player.begin_step(0.5)
    player.begin_step(0.6)
    assert factors == [0.0, 0.5]


def test_playing_again_starts_anew_also_from_a_callback() -> None:
    factors: list[float] = []
    player = AnimationPlayer()
    index = player.add(Animation(factors.append, 0.02, on_done=lambda: player.play(0, 0.03)))
    player.play(index, 0.0)
    for step in range(5):
        player.begin_step(step * 0.01)
    assert factors == [0.0, 0.5, 1.0, 0.0, 0.5]
    player.play(index, 0.05)
    player.begin_step(0.05)
    assert factors[-1] == 0.0


def test_stop() -> None:
    calls: list[float] = []
    player = AnimationPlayer([Animation(calls.append, 1.0), Animation(calls.append, 1.0)])
    player.play(0, 0.0)
    player.play(1, 0.0)
    player.stop(0)
    assert player.playing == (1,)
    player.stop()
    player.begin_step(0.0)
    assert calls == []


def test_a_callback_may_stop_another_animation() -> None:
    calls: list[float] = []
    player = AnimationPlayer([Animation(lambda _: player.stop(1), 1.0), Animation(calls.append, 1.0)])
    player.play(0, 0.0)
    player.play(1, 0.0)
    player.begin_step(0.0)
    assert calls == []


def test_a_failing_callback_is_one_sentence_and_stops() -> None:
    def fail(factor: float) -> None:
        raise ZeroDivisionError("oops")

    player = AnimationPlayer([Animation(fail, 1.0)])
    player.play(0, 0.0)
    with pytest.raises(
        SceneError, match=r"fail\) failed at t = 0\.250 s and is stopped: ZeroDivisionError: oops"
    ):
        player.begin_step(0.25)
    assert player.playing == ()
    player.begin_step(0.26)


def test_errors_of_the_suite_and_ctrl_c_pass_unchanged() -> None:
    for error in (CommandError("refused"), KeyboardInterrupt()):

        def fail(factor: float, error: BaseException = error) -> None:
            raise error

        player = AnimationPlayer([Animation(fail, 1.0)])
        player.play(0, 0.0)
        with pytest.raises(type(error)):
            player.begin_step(0.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"duration": 0.0}, "duration must be > 0 s, not 0.0"),
        ({"duration": math.nan}, "duration"),
        ({"duration": math.inf}, "duration"),
        (
            {"duration": 1.0, "mode": "twice"},
            "unknown animation mode 'twice'; known modes: once, loop, pingpong",
        ),
        ({"duration": 1.0, "delay": -1.0}, "delay must be >= 0 s"),
    ],
)
def test_wrong_arguments(arguments: dict[str, object], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        Animation(lambda factor: None, **arguments)  # type: ignore[arg-type]


def test_unknown_animation() -> None:
    with pytest.raises(SceneError, match="unknown animation 1; 0 are known"):
        AnimationPlayer().play(1, 0.0)


@pytest.mark.parametrize(
    "state", [[(1.0, 0.0, 0.0)], [(0.5, 0.0, 0.0)], [(0.0, 0.0)], [(-1.0, 0.0, 0.0)], [(math.nan, 0.0, 0.0)]]
)
def test_a_foreign_state_is_refused_whole(state: list[tuple[float, ...]]) -> None:
    player = AnimationPlayer([Animation(lambda factor: None, 1.0)])
    player.play(0, 0.0)
    before = player.state()
    with pytest.raises(SnapshotError, match="does not fit 1 animations"):
        player.restore([before[0], *state])
    assert player.playing == (0,)


modes = st.sampled_from(["once", "loop", "pingpong"])


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    modes,
    st.integers(1, 400),
    st.integers(0, 30),
    st.integers(0, 300),
    st.sampled_from([0.001, 0.01, 1 / 60]),
)
def test_restored_animations_continue_exactly(mode: str, steps: int, delay: int, cut: int, dt: float) -> None:
    """A player restored from its (JSON) state makes the same calls as one that ran on."""
    factors: list[float] = []
    animation = Animation(factors.append, steps * dt, mode, delay * dt)  # type: ignore[arg-type]
    player = AnimationPlayer([animation])
    player.play(0, 0.0)
    for step in range(cut):
        player.begin_step(step * dt)
    state = player.state()
    factors.clear()
    for step in range(cut, cut + 100):
        player.begin_step(step * dt)
    straight = list(factors)
    factors.clear()
    other = AnimationPlayer([animation])
    other.restore(json.loads(json.dumps(state)))
    for step in range(cut, cut + 100):
        other.begin_step(step * dt)
    assert factors == straight


@settings(max_examples=200, deadline=None, derandomize=True)
@given(modes, st.integers(1, 1000), st.floats(0.0, 1.0e4), st.sampled_from([0.001, 0.01, 0.02, 1 / 60]))
def test_once_makes_one_call_more_than_steps_from_any_start(
    mode: str, steps: int, start: float, dt: float
) -> None:
    factors: list[float] = []
    play(Animation(factors.append, steps * dt, mode), steps=2 * steps + 5, dt=dt, start=start)  # type: ignore[arg-type]
    assert all(0.0 <= factor <= 1.0 for factor in factors)
    assert factors[0] == 0.0
    assert factors[steps] == 1.0
    assert factors[: steps + 1] == sorted(factors[: steps + 1])
    if mode == "once":
        assert len(factors) == steps + 1
    elif mode == "pingpong":
        assert factors[2 * steps] == 0.0
    else:
        assert factors[2 * steps] == 1.0


def test_factor_function() -> None:
    assert [factor_at(t, 2.0) for t in (-1.0, 0.0, 0.5, 2.0, 9.0)] == [0.0, 0.0, 0.25, 1.0, 1.0]
    assert [factor_at(t, 2.0, "loop") for t in (0.0, 0.5, 2.0, 2.5, 4.0)] == [0.0, 0.25, 1.0, 0.25, 1.0]
    assert [factor_at(t, 2.0, "pingpong") for t in (0.0, 2.0, 2.5, 4.0, 4.5)] == [0.0, 1.0, 0.75, 0.0, 0.25]
    assert [is_over(t, 2.0) for t in (1.999, 2.0)] == [False, True]
    assert not is_over(9.0, 2.0, "loop")
