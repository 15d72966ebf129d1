"""What others send, or a folder holds, opens no file that the start command did not name; no code runs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml
from foreign_files import Watch, bait, references, watch
from study_files import LOAD

from softsim_core import load_scene
from softsim_core.base import ConfigError, MjcfError, SoftSimError
from softsim_core.lab.study import prepare_study
from softsim_core.mjcf import read_source
from softsim_core.physics.actuation import ActuatorDescription, register_actuator, registry
from softsim_core.scene import SceneCatalog
from softsim_core.scene.editing import Put, SceneDocument
from softsim_core.scene.io import Item, find_config

COUNT = 500
"""References in all, spread over what may hold one."""
__all__ = ["bait", "watch"]  # fixtures


@dataclass(frozen=True, slots=True, kw_only=True)
class Pages:
    """Files that are named further down."""

    pages: tuple[Path, ...] = ()
    by_name: dict[str, Path] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayDescription(ActuatorDescription):
    """An actuator that plays what its files hold."""

    kind: ClassVar[str] = "replay"
    log: Path | None = None
    book: Pages | None = None


def test_the_watch_sees_what_is_opened_and_run(watch: Watch, bait: Path) -> None:
    with watch.on(bait) as seen:
        load_scene(bait / "link_program.py")
    assert {"open program.py", "exec program.py"} <= set(seen)


WHERE: dict[str, Callable[[str], Any]] = {
    "extends": lambda name: {"extends": name},
    "arm": lambda name: {"arm": {"urdf": name}},
    "tool": lambda name: {"arm": {"urdf": str(find_config("tripod")), "tools": [{"robot": name, "on": "x"}]}},
    "mesh": lambda name: {"bodies": [{"name": "finger", "mesh": {"file": name}}]},
    "surface": lambda name: {"bodies": [{"name": "finger", "surface": {"file": name}}]},
    "collision": lambda name: {"collisions": [{"name": "c", "body": "finger", "surface": {"file": name}}]},
    "shape": lambda name: {"rigid_bodies": [{"name": "r", "shape": {"mesh": {"file": name}}}]},
    "points": lambda name: {"joints": [{"name": "cable", "cable": {"points": name}}]},
    "materials": lambda name: {"bodies": [{"name": "finger", "material": name}]},
}


@pytest.mark.parametrize("where", WHERE)
def test_no_override_opens_a_file(where: str, watch: Watch, bait: Path) -> None:
    from softsim_ros.nodes.simulator import SceneFiles

    pytest.importorskip("rclpy")
    files = SceneFiles(load_scene("cable_finger"))
    for name in references(bait, 1, COUNT // (2 * len(WHERE))):
        with watch.on(bait) as seen, pytest.raises(SoftSimError) as refused:
            files.try_overrides(yaml.safe_dump(WHERE[where](name)))
        assert seen == [], (where, name)
        assert "\n" not in str(refused.value)


def test_overrides_and_edits_do_not_tell_whether_a_file_is_there(bait: Path) -> None:
    pytest.importorskip("rclpy")
    from softsim_ros.nodes.simulator import SceneFiles

    files = SceneFiles(load_scene("cable_finger"))
    for where in set(WHERE) - {"materials"}:
        said = []
        for name in (str(bait / "part.stl"), str(bait / "gone.stl")):
            with pytest.raises(ConfigError) as refused:
                files.try_overrides(yaml.safe_dump(WHERE[where](name)))
            said.append(str(refused.value).replace(name, ""))
        assert said[0] == said[1], where


def test_a_file_that_a_new_key_names_is_found_by_its_type(
    watch: Watch, bait: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kind of actuators that others register has keys that nobody here knows."""
    pytest.importorskip("rclpy")
    from softsim_ros.nodes.simulator import SceneFiles

    monkeypatch.setitem(registry._kinds, "replay", None)
    register_actuator(ReplayDescription, lambda *_: None)  # type: ignore[arg-type, return-value]
    files = SceneFiles(load_scene("cable_finger"))
    file = str(bait / "part.stl")
    for key, value in (("log", file), ("book", {"pages": [file]}), ("book", {"by_name": {"a": file}})):
        joint = {"name": "cable", "kind": "replay", "replay": {key: value}}
        with watch.on(bait) as seen, pytest.raises(ConfigError, match="name other files"):
            files.try_overrides(yaml.safe_dump({"joints": [joint]}))
        assert seen == []


def test_no_edit_opens_a_file(watch: Watch, bait: Path, tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("ruamel.yaml")
    from softsim_ros.nodes.simulator import SceneFiles

    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: {find_config('cable_finger')}\n")
    files = SceneFiles(load_scene(file))
    document = SceneDocument(file, file.read_text())
    places = (
        ("bodies", Item("finger"), "mesh", "file"),
        ("bodies", Item("finger"), "surface", "file"),
        ("joints", Item("cable"), "cable", "points"),
        ("rigid_bodies", Item("r"), "shape", "mesh", "file"),
        ("arm", "urdf"),
        ("extends",),
    )
    for steps in places:
        for name in references(bait, 2, COUNT // (10 * len(places))):
            with watch.on(bait) as seen, pytest.raises(ConfigError):
                files.propose(document, (Put(steps, name),))
            assert seen == [], (steps, name)


def test_no_name_of_a_scene_leads_into_the_start_folder(watch: Watch, bait: Path) -> None:
    """As for the parameter `robot`, the page's list, what can be spawned, and the robot of a bag."""
    scenes = SceneCatalog()
    with watch.on(bait) as seen:
        assert not {"nice", "plain", "program"} & set(scenes.names())
        for name in references(bait, 3, COUNT // 10):
            with pytest.raises(ConfigError, match="no known scene has this name"):
                scenes.load(name)
    assert seen == []


def test_a_xacro_file_runs_where_a_python_scene_does(
    watch: Watch, bait: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacro")
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "foreign.yaml").write_text(f"name: foreign\narm: {{urdf: {bait}/parts.xacro}}\n")
    monkeypatch.setenv("SOFTSIM_CONFIG_PATH", str(tmp_path))
    with watch.on(bait) as seen, pytest.raises(ConfigError, match="is code that would run"):
        SceneCatalog().load("foreign")
    assert seen == []
    for allowed in (
        SceneCatalog({"nice": bait / "nice.yaml"}),
        SceneCatalog(code_folders=[bait]),
    ):
        with watch.on(bait) as seen:
            assert allowed.load("nice").name == "nice"
        assert "open parts.xacro" in seen


def test_no_study_runs_code_that_was_not_allowed(watch: Watch, bait: Path, tmp_path: Path) -> None:
    """Neither by `..` behind a known folder, nor by links, nor by a scene whose arm is a xacro file."""
    pytest.importorskip("xacro")
    file = tmp_path / "study.yaml"
    programs = ("exec ", "open parts.xacro")
    for name in references(bait, 4, COUNT // 10):
        measure = [{"name": "told", "of": "python", "function": f"{name.removesuffix('.py')}.py:told"}]
        for changes in ({"scene": name}, {"measure": measure}):
            file.write_text(yaml.safe_dump({**LOAD, **changes}))
            with watch.on(bait) as seen, suppress(SoftSimError):
                work = prepare_study(file).work
                work.load_unchanged()
                work.function(work.study.measure[0])
            assert not [each for each in seen if each.startswith(programs)], (changes, seen)
    file.write_text(yaml.safe_dump({**LOAD, "scene": str(bait / "nice.yaml")}))
    with pytest.raises(ConfigError, match="--allow-code"):
        prepare_study(file).work.load_unchanged()
    assert prepare_study(file, [bait]).work.load_unchanged().name == "nice"


def test_what_was_checked_is_what_runs(bait: Path, tmp_path: Path) -> None:
    """A link that is exchanged after the check leads nowhere else."""
    allowed = tmp_path / "allowed"
    allowed.mkdir()
    (allowed / "mine.py").write_text("def told(simulation): return 1.0\n")
    link = allowed / "functions.py"
    link.symlink_to(allowed / "mine.py")
    measure = [{"name": "told", "of": "python", "function": "functions.py:told"}]
    file = allowed / "study.yaml"
    file.write_text(yaml.safe_dump({**LOAD, "measure": measure}))
    work = prepare_study(file, [allowed]).work
    assert work.function(work.study.measure[0]) is not None
    link.unlink()
    link.symlink_to(bait / "program.py")
    function = work.function(work.study.measure[0])
    assert function is not None
    assert function.__code__.co_filename == str(allowed / "mine.py")  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match="is code that would run"):
        prepare_study(file, [allowed])


def test_no_model_of_mujoco_opens_a_file_outside_its_folder(watch: Watch, bait: Path, tmp_path: Path) -> None:
    folder = tmp_path / "model"
    (folder / "meshes").mkdir(parents=True)
    (folder / "ball.stl").write_text("solid ball\nendsolid ball\n")
    (folder / "meshes" / "ball.stl").symlink_to(bait / "part.stl")
    (folder / "inner.xml").write_text(f'<mujoco><asset><mesh file="{bait}/part.stl"/></asset></mujoco>')
    model = folder / "model.xml"
    texts = [
        '<mujoco><compiler meshdir="meshes"/><asset><mesh file="ball.stl"/></asset></mujoco>',
        '<mujoco><asset><model name="i" file="inner.xml"/></asset></mujoco>',
    ]
    for name in references(bait, 5, COUNT // 10):
        if "\0" not in name and (folder / name).resolve().is_relative_to(bait):
            texts += [
                f'<mujoco><include file="{name}"/></mujoco>',
                f'<mujoco><asset><mesh file="{name}"/></asset></mujoco>',
            ]
    for text in texts:
        model.write_text(text)
        with watch.on(bait) as seen, pytest.raises(MjcfError, match=r"outside|no path of a file"):
            read_source(model)
        assert seen == [], text


def test_no_snapshot_lies_outside_its_folder(watch: Watch, bait: Path, tmp_path: Path) -> None:
    from softsim_ros.nodes.simulator import SnapshotFolder

    snapshots = SnapshotFolder(tmp_path / "snapshots")
    snapshots.write("state", b"mine")
    (tmp_path / "snapshots" / "link.snapshot").symlink_to(bait / "state.snapshot")
    for name in ("link", *references(bait, 6, COUNT // 10)):
        with watch.on(bait) as seen, suppress(SoftSimError):
            snapshots.read(name)
        assert seen == [], name
