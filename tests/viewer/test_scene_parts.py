"""The parts of a scene on the page: what can be changed, and how it is laid over the scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from softsim_core import load_scene
from softsim_core.base import ConfigError
from softsim_core.scene import Camera, ViewSettings
from softsim_core.scene.io import Item, laid_over, override_at, read_overrides, write_overrides
from softsim_ros.nodes.viewer import field_text, field_value, parts_of, view_file

pytestmark = pytest.mark.ros


def test_parts_tell_where_they_stand_in_the_file() -> None:
    parts = parts_of(load_scene("tripod"))
    base = parts["tripod/joints/servo_0/base"]
    assert base.steps == ("joints", Item("servo_0"), "base")
    assert base.editable["rotation_deg"] == (0.0, 0.0, 0.0)
    assert parts["tripod"].steps == ()
    assert "poses" not in parts["tripod"].editable  # by names, in the file
    assert parts["tripod/board/servos/servo_1"].steps is None
    assert parts["tripod/board/servos/servo_1"].editable == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["tripod", "cable_gripper", "tripod_maze", "tripod_step_4_3", "sensed_finger"]
)
def test_every_field_can_be_laid_over_as_it_is_written(name: str) -> None:
    scene = load_scene(name)
    changes: dict[str, object] = {}
    for part in parts_of(scene).values():
        if part.steps is not None and part.editable:
            values = {key: field_value(key, field_text(value)) for key, value in part.editable.items()}
            changes = laid_over(changes, override_at(part.steps, values))
    again = load_scene(name, read_overrides(write_overrides(changes)))
    assert (again.scene.bodies, again.joints, again.scene.rigid_bodies) == (
        scene.scene.bodies,
        scene.joints,
        scene.scene.rigid_bodies,
    )
    assert (again.scene.contact, again.scene.sensors, again.view, again.inverse) == (
        scene.scene.contact,
        scene.scene.sensors,
        scene.view,
        scene.inverse,
    )


def test_a_saved_view_is_a_scene_that_shows_it(tmp_path: Path) -> None:
    scene = load_scene("tripod_step_3")
    camera = Camera(position=(0.1, -0.2, 0.3), target=(0.0, 0.0, 0.01))
    view = replace(
        scene.view, camera=camera, boxes=False, hidden=("attachments/fixing_box",), stress_top=2.0e3
    )
    file = tmp_path / "seen.yaml"
    file.write_text(view_file(scene, view))
    again = load_scene(file)
    assert again.view == view
    assert replace(again, source=scene.source, view=scene.view) == scene
    assert view_file(load_scene("tripod_step_4_3"), ViewSettings(frames=True)) == "view: {frames: true}\n"


def test_fields_are_written_on_one_line_as_in_a_file() -> None:
    for value, text in (
        (1.0e-6, "1.0e-06"),
        ((0.0, -9.81), "[0.0, -9.81]"),
        (None, "null"),
        (True, "true"),
        ("free", "free"),
        (float("inf"), ".inf"),
    ):
        assert field_text(value) == text
        assert field_value("key", text) == (list(value) if isinstance(value, tuple) else value)
    with pytest.raises(ConfigError, match="YAML syntax"):
        field_value("gravity", "[0, 0")
