"""The section `view` of a scene: what a page shows when the scene begins."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from softsim_core.base import ConfigError, SceneError
from softsim_core.scene import LAYERS, Camera, Scene, ViewSettings, load_scene, load_yaml


def refusal(path: Path, text: str) -> ConfigError:
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_yaml(path)
    assert "\n" not in str(caught.value)
    return caught.value


def test_layers_are_the_switches() -> None:
    assert set(LAYERS) > {"bodies", "boxes", "collisions", "search_boxes"}
    assert all(isinstance(getattr(ViewSettings(), name), bool) for name in LAYERS)


def test_a_scene_says_what_is_shown_and_one_that_extends_it_says_more(tmp_path: Path) -> None:
    base, child = tmp_path / "base.yaml", tmp_path / "child.yaml"
    base.write_text(
        "name: base\njoints: [{name: a}]\n"
        "view: {boxes: true, stress_top: 5.0e+3, hidden: [joints/a],"
        " camera: {position: [0.2, 0, 0.1], target: [0, 0, 0]}}\n"
    )
    child.write_text("extends: base.yaml\nview: {labels: false, camera: null}\n")
    view = load_yaml(base).view
    assert (view.boxes, view.labels, view.stress_top, view.hidden) == (True, True, 5.0e3, ("joints/a",))
    assert view.camera == Camera(position=(0.2, 0.0, 0.1), target=(0.0, 0.0, 0.0))
    view = load_yaml(child).view
    assert (view.boxes, view.labels, view.camera) == (True, False, None)
    assert load_scene("held_centre").robot_alone().view == ViewSettings()


@pytest.mark.parametrize(
    ("section", "key", "words"),
    [
        ("{box: true}", "view.box", "did you mean boxes"),
        ("{boxes: 1}", "view.boxes", "true or false"),
        ("{stress_top: 0}", "view.stress_top", "> 0 Pa"),
        ("{node_size: -1.0}", "view.node_size", "> 0 m"),
        ("{camera: {position: [0, 0, 1]}}", "view.camera.target", "is missing"),
        ("{camera: {position: [0, 0, 1], target: [0, 0, .inf]}}", "view.camera.target", "finite"),
        ("{camera: {position: [0, 0, 1], target: [0, 0, 1]}}", "view.camera", "same point"),
        ("{hidden: [joints/a, joints/a]}", "view.hidden", "without repetition"),
        ("{hidden: [a]}", "", "known: joints/a"),
    ],
)
def test_every_mistake_is_one_sentence_with_its_key(
    tmp_path: Path, section: str, key: str, words: str
) -> None:
    error = refusal(tmp_path / "scene.yaml", f"name: wrong\njoints: [{{name: a}}]\nview: {section}\n")
    assert error.key == key
    assert words in str(error)


def test_python_scenes_have_a_view_too() -> None:
    scene = Scene(name="seen", view=ViewSettings(frames=True))
    assert scene.describe().view.frames
    with pytest.raises(SceneError, match="target must be finite"):
        Camera(position=(0.0, 0.0, 1.0), target=(math.nan, 0.0, 0.0))
