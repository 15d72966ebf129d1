"""What may be written of an edited scene, and what a message of edits may be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from softsim_core import load_scene
from softsim_core.base import CommandError, ConfigError
from softsim_core.scene.editing import Put, Remove, rebase_paths
from softsim_core.scene.io import Item, config_file, named_files, write_description
from softsim_ros.messages import (
    ChosenPoints,
    Proposal,
    read_edits,
    read_proposal,
    write_edits,
    write_proposal,
)
from softsim_ros.nodes.simulator import SceneWriter, files_of

TEXT = "# mine\nname: mine\nbodies: []\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(TEXT)
    path.chmod(0o640)
    return path


def test_the_named_file_is_written_whole_with_its_rights(file: Path) -> None:
    writer = SceneWriter([file], file.parent)
    assert writer.refusal(file) == ""
    writer.write(file, "name: mine\n", TEXT)
    assert file.read_text() == "name: mine\n"
    assert file.stat().st_mode & 0o777 == 0o640
    assert [each.name for each in file.parent.iterdir()] == ["mine.yaml"]


def test_what_somebody_else_changed_is_not_overwritten(file: Path) -> None:
    writer = SceneWriter([file], file.parent)
    file.write_text(TEXT + "# and this\n")
    with pytest.raises(ConfigError, match="changed on the disk"):
        writer.write(file, "name: mine\n", TEXT)
    assert file.read_text() == TEXT + "# and this\n"


def test_links_other_files_and_shipped_scenes_are_not_written(file: Path, tmp_path: Path) -> None:
    link = tmp_path / "link.yaml"
    link.symlink_to(file)
    shipped = config_file("scenes/cable_finger.yaml")
    writer = SceneWriter([link, shipped], tmp_path)
    for path, words in ((link, "is a link"), (file, "was not named"), (shipped, "came with softsim")):
        before = path.read_text()
        assert words in writer.refusal(path)
        with pytest.raises(ConfigError, match="not saved: "):
            writer.write(path, "name: x\n", before)
        assert path.read_text() == before
    assert link.is_symlink()


@pytest.mark.parametrize("data", [b"\xff\xfe", b"name: a\r\n", b"#" * 4_000_001])
def test_files_that_could_not_be_given_back_as_they_were_are_not_edited(file: Path, data: bytes) -> None:
    file.write_bytes(data)
    with pytest.raises(ConfigError):
        SceneWriter([file], file.parent).read(file)


def test_programs_are_edited_by_hand(tmp_path: Path) -> None:
    program = tmp_path / "scene.py"
    program.write_text("def create_scene(scene): pass\n")
    with pytest.raises(ConfigError, match="is a program"):
        SceneWriter([program], tmp_path).read(program)


def test_a_copy_is_a_new_file_and_may_be_written_again(tmp_path: Path) -> None:
    writer = SceneWriter([], tmp_path)
    copy = writer.copy("mine", TEXT)
    assert (copy, copy.read_text()) == (tmp_path / "mine.yaml", TEXT)
    with pytest.raises(ConfigError, match="there is a file of this name"):
        writer.copy("mine", "other")
    (tmp_path / "away.yaml").symlink_to(tmp_path / "nowhere")
    with pytest.raises(ConfigError, match="there is a file of this name"):
        writer.copy("away", "other")
    assert not (tmp_path / "nowhere").exists()
    writer.write(copy, "name: mine\n", TEXT)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["away.yaml", "mine.yaml"]
    assert copy.stat().st_nlink == 1


@pytest.mark.parametrize("name", ["cable_finger", "cable_finger_quadratic", "tripod"])
def test_a_copy_elsewhere_is_the_same_scene(name: str, tmp_path: Path) -> None:
    robot = load_scene(name)
    assert robot.source is not None
    known = {*files_of(robot), *named_files(robot)} - {robot.source}
    text = rebase_paths(robot.source.read_text(), robot.source, known)
    copy = tmp_path / "copy.yaml"
    copy.write_text(text)
    assert load_scene(copy).scene == robot.scene
    kept = [line for line in robot.source.read_text().splitlines() if line.startswith("#")]
    assert [line for line in kept if line not in text] == []


def test_edits_come_through_as_they_are() -> None:
    edits = (
        Put(("bodies", Item("a"), "density"), 1.5),
        Remove(("effector",)),
        Put(("gravity",), [0, 0, -1.0]),
    )
    assert read_edits(write_edits(edits, "drag 3")) == (edits, "drag 3")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        "{",
        "[" * 50_000,
        "x" * 200_000,
        '{"edits": 3}',
        '{"edits": [{"at": ["dt"]}]}',
        '{"edits": [{"at": ["dt"], "remove": 1}]}',
        '{"edits": [{"at": ["dt", 3], "put": 1}]}',
        '{"edits": [{"at": [{"name": 3}], "put": 1}]}',
        '{"edits": [{"at": "dt", "put": 1, "more": 2}]}',
        '{"edits": [], "stroke": 3}',
        '{"edits": [], "file": "/etc/passwd"}',
        json.dumps({"edits": [{"at": ["dt"], "put": 1}] * 201}),
    ],
)
def test_what_is_no_edit_is_refused(text: str) -> None:
    with pytest.raises(CommandError, match="edit refused"):
        read_edits(text)


def proposal(**changes: Any) -> str:
    robot = load_scene("cable_finger")
    chosen = (ChosenPoints("attachments/base", 2, np.ones((2, 3)), "too small"),)
    told = Proposal(
        7, robot, "/x.yaml", "why", 1, 2, True, False, "done", chosen, {"cable": np.zeros((4, 3))}
    )
    return json.dumps({**json.loads(write_proposal(told, write_description(robot))), **changes})


def test_a_proposal_comes_through_as_it_is() -> None:
    told = read_proposal(proposal())
    assert (told.revision, told.file, told.unsaved, told.undoable, told.redoable) == (
        7,
        "/x.yaml",
        "why",
        1,
        2,
    )
    assert (told.is_changed, told.is_applied, told.message) == (True, False, "done")
    assert told.robot is not None
    assert told.robot.scene.attachments == load_scene("cable_finger").scene.attachments
    assert told.problems == ("attachments/base: too small",)
    assert told.routes["cable"].shape == (4, 3)


@pytest.mark.parametrize(
    "changes",
    [
        {"revision": -1},
        {"description": 3},
        {"chosen": [{"part": "x"}]},
        {"chosen": [{"part": "x", "count": 1, "points": [[0, 0, float("nan")]], "problem": ""}]},
        {"chosen": [{"part": "x", "count": 1, "points": [[0.0] * 3] * 2001, "problem": ""}]},
        {"routes": {"cable": [[0]]}},
        {"routes": 3},
        {"sentence": None},
    ],
)
def test_what_is_no_proposal_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(CommandError, match="proposal refused"):
        read_proposal(proposal(**changes))
