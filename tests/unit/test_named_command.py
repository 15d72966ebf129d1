"""Commands by joint name: any order, some joints, NaN for none; and how old one may be."""

from __future__ import annotations

import math

import pytest

from softsim_core.base import CommandError
from softsim_core.physics.mechanics import check_age, check_named_command, check_positions_only

JOINTS = ("servo_0", "servo_1", "servo_2")


def test_some_joints_in_any_order() -> None:
    command = check_named_command(["servo_2", "servo_0"], [-0.2, -0.1], JOINTS)
    assert command == {"servo_2": -0.2, "servo_0": -0.1}
    assert check_named_command(["servo_1", "servo_0"], [math.nan, -1.0], JOINTS) == {"servo_0": -1.0}
    assert check_named_command(JOINTS, [math.nan] * 3, JOINTS) == {}


@pytest.mark.parametrize(
    ("names", "positions", "words"),
    [
        (["arm"], [0.0], "unknown joints arm; known joints: servo_0, servo_1, servo_2"),
        (["servo_0", "servo_0"], [0.0, 0.0], "names servo_0 twice"),
        (["servo_0"], [], "0 positions for 1 names"),
        (["servo_0"], [math.inf], "inf for joint servo_0 is not finite"),
        (["a"] * 4, [0.0] * 4, "names 4 joints of 3"),
        (["x" * 100_000], [0.0], "unknown joints x{40};"),
    ],
)
def test_what_is_wrong_is_refused_whole(names: list[str], positions: list[float], words: str) -> None:
    with pytest.raises(CommandError, match=f"joint command refused: .*{words}.*nothing was moved") as caught:
        check_named_command(names, positions, JOINTS)
    assert len(str(caught.value)) <= 300


def test_velocities_are_not_passed_over_in_silence() -> None:
    check_positions_only([], [])
    check_positions_only([math.nan, 0.0], [math.nan, math.nan])  # which say nothing
    check_positions_only([1e-12, -1e-12], [1e-15, 0.0])  # a planner's round-off at the end of its motion
    for velocities, efforts in (([1.0], []), ([], [1.0]), ([1e-6], []), ([math.inf], [])):
        with pytest.raises(CommandError, match="only positions are taken"):
            check_positions_only(velocities, efforts)


@pytest.mark.parametrize(("given", "words"), [(97.9, "2.1 s ago"), (1.7e9, "ahead, .*one clock")])
def test_a_stale_command_and_one_of_another_clock_are_refused(given: float, words: str) -> None:
    check_age(0.0, 100.0)
    check_age(99.8, 100.0)
    with pytest.raises(CommandError, match=words):
        check_age(given, 100.0)
