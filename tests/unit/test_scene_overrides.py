"""Changes that are laid over a scene's file."""

from __future__ import annotations

import pytest

from softsim_core.base import ConfigError
from softsim_core.scene import MaterialDescription, load_scene
from softsim_core.scene.io import Item, laid_over, override_at, read_overrides, write_overrides

BASE = ("joints", Item("servo_0"), "base")


def test_a_field_of_a_part_is_found_by_its_steps() -> None:
    moved = override_at(BASE, {"translation": [0.1, 0.0, 0.0]})
    assert moved == {"joints": [{"name": "servo_0", "base": {"translation": [0.1, 0.0, 0.0]}}]}
    before, after = load_scene("tripod").joints, load_scene("tripod", moved).joints
    assert after[0].base.translation == (0.1, 0.0, 0.0)
    assert after[0].base.rotation_deg == before[0].base.rotation_deg
    assert after[1:] == before[1:]
    assert override_at((), {"gravity": [0, 0, 0]}) == {"gravity": [0, 0, 0]}


def test_overrides_are_text_and_lie_over_each_other() -> None:
    first = override_at(BASE, {"translation": (0.1, 0.0, 0.0)})
    second = override_at(("joints", Item("servo_1")), {"rest": 0.1})
    third = override_at(BASE, {"rotation_deg": [0.0, 0.0, 5.0]})
    both = laid_over(laid_over(first, second), third)
    assert both["joints"] == [
        {"name": "servo_0", "base": {"translation": [0.1, 0.0, 0.0], "rotation_deg": [0.0, 0.0, 5.0]}},
        {"name": "servo_1", "rest": 0.1},
    ]
    assert read_overrides(write_overrides(both)) == both
    assert write_overrides({}) == ""
    assert read_overrides("") == {}
    assert read_overrides('{"gravity": [0, 0, -1.5]}') == {"gravity": [0, 0, -1.5]}


@pytest.mark.parametrize("text", ["[1, 2]", "a: b: c", "{", "3: 4", "no mapping", "2026-13-45"])
def test_what_is_no_mapping_is_refused_in_a_sentence(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^overrides: ") as caught:
        read_overrides(text)
    assert "\n" not in str(caught.value)


def material_with(name: str, **parameters: object) -> MaterialDescription:
    """The material of a scene's first body with parameters laid over it."""
    over = override_at(("bodies", Item(load_scene(name).scene.bodies[0].name)), {"material": parameters})
    return load_scene(name, over).scene.bodies[0].material


def test_null_removes_a_parameter_of_the_material_below() -> None:
    own = load_scene("cable_finger").scene.bodies[0].material
    assert set(own.values) >= {"young_modulus", "poisson_ratio"}
    rubber = material_with("cable_finger", law="yeoh", c1=3.0e4, c2=None, young_modulus=None)
    assert rubber == MaterialDescription(law="yeoh", c1=3.0e4, poisson_ratio=own.poisson_ratio)
    text = write_overrides({"material": {"young_modulus": None}})
    assert read_overrides(text) == {"material": {"young_modulus": None}}  # as text, too
    first = {"material": {"young_modulus": 1.0e5, "poisson_ratio": 0.3}}
    assert laid_over(first, read_overrides(text))["material"] == {"young_modulus": None, "poisson_ratio": 0.3}


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"young_modulus": None}, r"material\.young_modulus: is missing; it has no default"),
        ({"law": "yeoh", "c1": 3.0e4}, r"material\.young_modulus: is no parameter of the law yeoh"),
        ({"yuong_modulus": None}, r"yuong_modulus"),
    ],
)
def test_a_removed_parameter_must_have_been_one_and_be_dispensable(
    parameters: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        material_with("cable_finger", **parameters)
