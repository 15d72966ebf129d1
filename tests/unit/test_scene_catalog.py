"""What others may have loaded: known names only, and no code but that of the suite and of who started it."""

from __future__ import annotations

from pathlib import Path

import pytest

from softsim_core import find_config
from softsim_core.base import ConfigError
from softsim_core.scene import SceneCatalog

YAML = "name: mine\nbodies: []\n"
PYTHON = (
    "from pathlib import Path\nPath(__file__).with_name('ran').touch()\ndef create_scene(scene):\n    pass\n"
)


@pytest.fixture
def start_folder(tmp_path: Path) -> Path:
    """A folder with a YAML scene, a Python scene, and other files."""
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "mine.yaml").write_text(YAML)
    (folder / "program.py").write_text(PYTHON)
    (folder / "compose.yaml").write_text("services: {}\n")
    (folder / "setup.py").write_text("raise SystemExit\n")
    return folder


@pytest.mark.parametrize(
    "name",
    ["/etc/passwd", "~nobody/x", "../configs/robots/tripod.yaml", "a" * 5000, "x\0y", "", ".", "tripod.yaml"],
)
def test_nothing_but_names_is_taken(start_folder: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="no known scene has this name") as caught:
        SceneCatalog(start_folder=start_folder).load(name)
    assert len(str(caught.value)) < 600


def test_a_path_is_refused_even_where_the_scene_is_known(start_folder: Path) -> None:
    catalog = SceneCatalog({"mine": start_folder / "mine.yaml"}, start_folder=start_folder)
    assert catalog.load("mine").source == start_folder / "mine.yaml"
    for path in (start_folder / "mine.yaml", find_config("tripod")):
        with pytest.raises(ConfigError, match="no known scene has this name"):
            catalog.load(str(path))


def test_the_scenes_of_the_suite_and_of_allowed_folders_are_known(
    start_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    catalog = SceneCatalog(code_folders=[start_folder])
    assert catalog.find("tripod") == find_config("tripod")
    assert {"tripod", "parts/servo", "mine", "program"} <= set(catalog.names())
    assert not {"compose", "setup"} & set(catalog.names())
    (start_folder / "tripod.yaml").write_text(YAML)
    assert catalog.find("tripod") == find_config("tripod")
    monkeypatch.chdir(start_folder)
    assert not {"mine", "program"} & set(SceneCatalog().names())


def test_code_runs_only_where_it_was_allowed(start_folder: Path) -> None:
    program, ran = start_folder / "program.py", start_folder / "ran"
    with pytest.raises(ConfigError, match="no known scene has this name"):
        SceneCatalog(start_folder=start_folder).load("program")
    assert not ran.exists()
    for allowed in (
        SceneCatalog({"program": program}, start_folder=start_folder),
        SceneCatalog(code_folders=[start_folder], start_folder=start_folder.parent),
    ):
        assert "program" in allowed.names()
        assert allowed.load("program").source == program
        ran.unlink()


def test_python_scenes_of_a_config_path_are_known_but_do_not_run(
    start_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (start_folder / "scenes").mkdir()
    (start_folder / "scenes" / "foreign.py").write_text(PYTHON)
    monkeypatch.setenv("SOFTSIM_CONFIG_PATH", str(start_folder))
    with pytest.raises(ConfigError, match=r"is a Python scene, which runs code; .* \(--allow-code DIR"):
        SceneCatalog(start_folder=start_folder.parent).load("foreign")


def test_a_refusal_has_the_near_name_or_the_first_five(start_folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"did you mean tripod\?; another file") as caught:
        SceneCatalog(start_folder=start_folder).load("tripdo")
    assert str(caught.value).count(",") == 0
    with pytest.raises(ConfigError, match=r"known are .* and \d+ more; another file") as caught:
        SceneCatalog(start_folder=start_folder).load("quadruped")
    assert str(caught.value).count(",") == 4


def test_a_start_folder_that_is_gone_holds_no_scenes(
    start_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = start_folder / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    before = SceneCatalog()
    gone.rmdir()
    assert "tripod" in before.names()
    assert "tripod" in SceneCatalog().names()


def test_a_folder_whose_code_is_allowed_is_there(start_folder: Path) -> None:
    for folder in (start_folder / "none", "~nobody/x", "x\0"):
        with pytest.raises(ConfigError, match="is no folder"):
            SceneCatalog(code_folders=[folder])
