"""The key `inverse` of a robot's file."""

from __future__ import annotations

import math
from typing import Any

import pytest

from softsim_core import load_scene
from softsim_core.base import ConfigError, SceneError
from softsim_core.scene import InverseSettings
from softsim_core.scene.io import structure_scene, unstructure_scene


def test_the_tripod_has_its_own() -> None:
    settings = load_scene("tripod", kind="robots").inverse
    assert settings.task == "position"
    assert settings.backend == "analytic"
    assert settings.max_shift == 0.030


def test_every_value_survives_a_round_trip() -> None:
    changes = {"task": "pose", "orientation_weights": [1.0, 1.0, 0.0], "torque_limit": 0.2, "posture": "mid"}
    scene = load_scene("tripod", {"inverse": changes}, kind="robots")
    assert structure_scene(unstructure_scene(scene), "x").inverse == scene.inverse
    assert scene.inverse.orientation_weights == (1.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"task": "dance"}, "inverse.task: must be one of position, orientation, height_tilt, pose"),
        ({"gain": 0.0}, "inverse.gain: must be > 0 and <= 1, not 0.0"),
        ({"gain": 1.5}, "inverse.gain: must be > 0 and <= 1, not 1.5"),
        ({"max_shift": -0.1}, "inverse.max_shift: must be > 0 m, not -0.1"),
        ({"torque_limit": 0.0}, "inverse.torque_limit: must be > 0"),
        ({"effort_weight": -1.0}, "inverse.effort_weight: must be >= 0"),
        ({"position_weights": [1.0, -1.0, 1.0]}, "inverse.position_weights: must be three numbers >= 0"),
        ({"lower": 1.0, "upper": -1.0}, "inverse.lower: must be <= upper = -1.0, not 1.0"),
        ({"maximum_shift": 0.1}, "did you mean max_shift"),
        ({"posture": "nowhere"}, "unknown pose 'nowhere'; known: start, mid, high"),
    ],
)
def test_what_is_wrong_is_one_sentence(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load_scene("tripod", {"inverse": changes}, kind="robots")
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["lever", "speed", "feedback_gain", "max_correction", "lower", "upper"])
def test_no_value_may_be_nan(name: str) -> None:
    with pytest.raises(SceneError, match=name):
        InverseSettings(**{name: math.nan})
