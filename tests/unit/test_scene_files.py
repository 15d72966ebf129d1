"""Robots and scenes are found by name or path from any working directory."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from softsim_core.base import ConfigError
from softsim_core.scene import find_config, known_scenes, load_scene
from softsim_core.scene.io import config_file, config_roots

SCENE = "name: own\n"


@pytest.fixture
def no_checkout(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The package stands alone, as installed: no configs beside it, none in the environment."""
    installed = tmp_path / "site-packages" / "softsim_core" / "scene" / "io" / "files.py"
    installed.parent.mkdir(parents=True)
    installed.touch()
    monkeypatch.setattr("softsim_core.scene.io.files.__file__", str(installed))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))
    monkeypatch.delenv("SOFTSIM_CONFIG_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    return tmp_path


def put(root: Path, name: str, text: str = SCENE) -> Path:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_by_name_from_any_directory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_config("tripod").parts[-2:] == ("robots", "tripod.yaml")
    assert find_config("tripod", "robots") == find_config("tripod")
    assert find_config("held_centre").parts[-2:] == ("scenes", "held_centre.yaml")
    assert find_config("parts/servo").parts[-2:] == ("parts", "servo.py")
    assert find_config("tripod.yaml") == find_config("tripod")
    assert config_file("robots/tripod.yaml") == find_config("tripod")


def test_by_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = put(tmp_path, "mine/robot.yaml")
    monkeypatch.chdir(tmp_path)
    assert find_config("mine/robot.yaml") == path
    assert find_config(path) == path
    monkeypatch.setenv("HOME", str(tmp_path))
    assert find_config("~/mine/robot.yaml") == path
    assert load_scene(path).name == "own"


def test_a_file_of_another_type_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"ends in \.yaml, \.yml, \.py, not in '\.json'"):
        find_config(put(tmp_path, "robot.json"))


def test_unknown_names_are_refused_with_what_is_known() -> None:
    with pytest.raises(ConfigError, match=r"did you mean tripod\?.* \(all: softsim scenes\)$"):
        find_config("tripdo")
    with pytest.raises(ConfigError, match=r"known: cable_finger, .* and \d+ more \(all: softsim scenes\)$"):
        find_config("quadruped")
    with pytest.raises(ConfigError, match="no robot of that name"):
        find_config("held_centre", "robots")
    with pytest.raises(ConfigError, match="no such file"):
        find_config("tripod.py")


def test_all_places_in_order(no_checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert config_roots() == []
    with pytest.raises(ConfigError, match="known: none"):
        find_config("own")
    prefix = put(no_checkout, "prefix/share/softsim/configs/robots/own.yaml")
    assert find_config("own") == prefix
    ament = put(no_checkout, "underlay/share/softsim_bringup/configs/scenes/own.py")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{no_checkout / 'overlay'}:{no_checkout / 'underlay'}")
    assert find_config("own", "scenes") == ament
    assert find_config("own") == prefix  # robots first
    ament_robot = put(no_checkout, "underlay/share/softsim_bringup/configs/robots/own.yml")
    assert find_config("own") == ament_robot
    beside = put(no_checkout, "site-packages/configs/robots/own.yaml")
    assert find_config("own") == beside
    mine = put(no_checkout, "mine/robots/own.yaml")
    monkeypatch.setenv("SOFTSIM_CONFIG_PATH", str(no_checkout / "mine"))
    assert find_config("own") == mine
    assert list(known_scenes()) == ["own"]


def test_a_foreign_configs_folder_beside_the_package_is_not_ours(no_checkout: Path) -> None:
    put(no_checkout, "site-packages/configs/own.yaml")
    assert config_roots() == []


def test_a_symlinked_package_finds_the_checkout(no_checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkout = no_checkout / "checkout"
    real = put(checkout, "softsim_core/scene/io/files.py", "")
    robot = put(checkout, "configs/robots/own.yaml")
    link = no_checkout / "ros2_ws" / "softsim_core"
    link.parent.mkdir()
    link.symlink_to(checkout / "softsim_core")
    monkeypatch.setattr("softsim_core.scene.io.files.__file__", str(link / "scene" / "io" / "files.py"))
    assert real.exists()
    assert find_config("own") == robot


def test_meshes_of_symlinked_configs_are_found(tmp_path: Path) -> None:
    put(tmp_path, "checkout/configs/meshes/a.vtk", "")
    real = put(
        tmp_path,
        "checkout/configs/robots/own.yaml",
        "name: own\nbodies: [{name: b, mesh: {file: ../meshes/a.vtk}, total_mass: 1, "
        "material: {young_modulus: 1, poisson_ratio: 0}}]\n",
    )
    link = tmp_path / "install" / "robots" / "own.yaml"
    link.parent.mkdir(parents=True)
    link.symlink_to(real)
    mesh = load_scene(link).scene.bodies[0].mesh
    assert mesh.file == tmp_path / "checkout" / "configs" / "meshes" / "a.vtk"  # type: ignore[union-attr]


@pytest.mark.parametrize("name", sorted(known_scenes()))
def test_every_scene_of_the_product_loads(name: str) -> None:
    scene = load_scene(name)
    assert scene.source == known_scenes()[name]
    assert scene.scene.body_names or scene.joints
