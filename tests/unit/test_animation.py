"""Factors of animations: exact, in every mode, and over when they have reached their end."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings, strategies as st

from softsim_core.base import SceneError
from softsim_core.physics.actuation import check_animation, factor_at, is_over

RISE = [step / 20 for step in range(21)]


def factors(
    count: int, duration: float, mode: str = "once", dt: float = 0.01, start: float = 0.0
) -> list[float]:
    """Factors of the first `count` steps of an animation that starts at a time in [s]."""
    return [factor_at(start + step * dt - start, duration, mode) for step in range(count)]  # type: ignore[arg-type]


def test_once_rises_in_exact_steps_and_stays() -> None:
    assert factors(50, 0.2) == RISE + 29 * [1.0]
    assert [is_over(step * 0.01, 0.2) for step in (0, 19, 20, 21)] == [False, False, True, True]


def test_a_summed_clock_gives_the_same_factors() -> None:
    time, seen = 1234.56, []
    for _ in range(21):
        seen.append(factor_at(time - 1234.56, 0.2))
        time += 0.01
    assert seen == RISE


def test_the_last_factor_is_1_when_the_duration_is_no_multiple_of_dt() -> None:
    seen = factors(5, 0.1, dt=0.03)
    assert seen == pytest.approx([0.0, 0.3, 0.6, 0.9, 1.0])
    assert seen[-1] == 1.0


def test_loop_and_pingpong_go_on() -> None:
    assert factors(61, 0.2, "loop") == RISE + RISE[1:] * 2
    assert factors(61, 0.2, "pingpong") == RISE + RISE[-2::-1] + RISE[1:]
    assert not is_over(100.0, 0.2, "loop")
    assert not is_over(100.0, 0.2, "pingpong")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0.0, "once"), "duration must be > 0 s, not 0.0"),
        ((math.nan, "once"), "duration"),
        ((math.inf, "once"), "duration"),
        ((1.0, "twice"), "unknown animation mode 'twice'; known modes: once, loop, pingpong"),
        ((1.0, "once", -1.0), "delay must be >= 0 s"),
    ],
)
def test_wrong_arguments(arguments: tuple[float, str, float], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        check_animation(*arguments)


modes = st.sampled_from(["once", "loop", "pingpong"])


@settings(max_examples=200, deadline=None, derandomize=True)
@given(modes, st.integers(1, 1000), st.floats(0.0, 1.0e4), st.sampled_from([0.001, 0.01, 0.02, 1 / 60]))
@pytest.mark.slow
def test_a_rise_ends_with_1_at_its_last_step_from_any_start(
    mode: str, steps: int, start: float, dt: float
) -> None:
    seen = factors(2 * steps + 5, steps * dt, mode, dt, start)
    assert all(0.0 <= factor <= 1.0 for factor in seen)
    assert seen[0] == 0.0
    assert seen[steps] == 1.0
    assert seen[: steps + 1] == sorted(seen[: steps + 1])
