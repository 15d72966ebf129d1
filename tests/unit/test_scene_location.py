"""Where a part of a scene is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from softsim_core.scene import find_config
from softsim_core.scene.io import Item, Steps, place_of, places_of


def locate(file: Path, steps: Steps) -> tuple[Path, int]:
    found = place_of(places_of(file), steps)
    assert found is not None  # the scene itself is always found
    return Path(found[0]), found[1]


@pytest.mark.parametrize(
    ("scene", "steps", "file", "line"),
    [
        ("tripod", ("joints", Item("servo_1")), "tripod.yaml", "servo_1"),
        ("tripod", ("joints", Item("servo_1"), "base"), "tripod.yaml", "base"),
        ("tripod", ("joints", Item("servo_1"), "limits", "no_such_key"), "tripod.yaml", "limits"),
        ("tripod_maze", ("joints", Item("servo_0")), "tripod.yaml", "servo_0"),
        ("tripod_maze", ("rigid_bodies", Item("ball")), "tripod_maze.yaml", "ball"),
        ("tripod_step_8_3", ("contact",), "tripod_maze.yaml", "contact"),
        ("cable_gripper_reference", ("joints", Item("finger_2_cable")), "cable_gripper_reference.yaml", "<<"),
        ("tripod_step_4_3", ("joints", Item("servo_0")), "tripod_step_4_3.py", "def create_scene"),
    ],
)
def test_a_part_is_found_in_the_file_that_says_most_of_it(
    scene: str, steps: tuple[str | Item, ...], file: str, line: str
) -> None:
    found, number = locate(find_config(scene), steps)
    assert found.name == file
    assert line in found.read_text().splitlines()[number - 1]


def test_what_cannot_be_read_is_at_its_first_line(tmp_path: Path) -> None:
    for name, text in (
        ("a.yaml", "a: [1"),
        ("b.py", "def f(:"),
        ("c.yaml", "extends: c.yaml\n"),
        ("d.yaml", ""),
    ):
        (tmp_path / name).write_text(text)
        assert locate(tmp_path / name, ("joints", Item("a"))) == (tmp_path / name, 1)
    assert locate(tmp_path / "gone.yaml", ()) == (tmp_path / "gone.yaml", 1)
