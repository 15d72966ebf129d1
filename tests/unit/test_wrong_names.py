"""What is proposed in the place of a wrong name."""

from __future__ import annotations

import re

import pytest

from softsim_core.base import MOST_PROPOSED, did_you_mean, known_names, nearest, one_of
from softsim_core.scene import known_scenes

MANY = [f"scene_{k}" for k in range(35)]


@pytest.mark.parametrize(
    ("given", "best"),
    [
        ("tripood", "tripod"),
        ("Tripod", "tripod"),
        ("tri-pod", "tripod"),
        ("cable grip", "cable_gripper"),
        ("tripod_mdi", "tripod_mid"),
    ],
)
def test_the_best_proposal_comes_first(given: str, best: str) -> None:
    assert nearest(given, known_scenes())[0] == best


def test_names_that_begin_so_and_names_spelt_alike_are_proposed() -> None:
    assert nearest("gripper", ["gripper_free", "gripper_grasp", "griper", "arm"]) == [
        "gripper_free", "gripper_grasp", "griper",
    ]  # fmt: skip
    assert nearest("fly", ["up", "run"]) == nearest("", ["up"]) == nearest("- _", ["up"]) == []


def test_at_most_five_are_proposed() -> None:
    assert len(nearest("scene", MANY)) == MOST_PROPOSED
    assert did_you_mean("upp", ["up", "urdf"]) == "did you mean up?"
    assert re.fullmatch(r"did you mean (\w+, ){3}\w+ or \w+\?", did_you_mean("scene", MANY))


def test_few_names_are_listed_and_of_many_the_first() -> None:
    assert known_names("x", ["a", "b"], "known joints:") == "known joints: a, b"
    assert known_names("x", []) == "known: none"
    assert known_names("servo_9", ["servo_0", "servo_1"]) == "known: servo_0, servo_1"
    assert known_names("servo0", ["servo_0", "a"]) == "did you mean servo_0? known: servo_0, a"
    first = "known: scene_0, scene_1, scene_2, scene_3, scene_4 and 30 more"
    assert known_names("x", MANY) == first
    assert known_names("x", MANY, lists_all="softsim scenes") == f"{first} (all: softsim scenes)"
    assert known_names("scene_344", MANY).startswith("did you mean scene_34")
    assert known_names("x", MANY, whole=True).count(",") == 34


def test_a_word_of_few() -> None:
    assert one_of("scypi", ["scipy", "numba"]) == "one of scipy, numba (did you mean scipy?)"
    assert one_of("x", ["scipy", "numba"]) == "one of scipy, numba"


def test_a_long_name_of_others_costs_nothing() -> None:
    assert nearest("tripod" * 100_000, known_scenes()) == []
