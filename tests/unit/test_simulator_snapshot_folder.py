"""Snapshots by name: where they are, that they are whole, and that nothing else is touched."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from softsim_core import load_scene
from softsim_core.base import SnapshotError
from softsim_ros.nodes.simulator import SnapshotFolder, default_folder, default_name


def test_the_default_folder_follows_xdg() -> None:
    assert default_folder({"XDG_STATE_HOME": "/state"}) == Path("/state/softsim")
    assert default_folder({"HOME": "/home/me"}) == Path("/home/me/.local/state/softsim")


def test_a_snapshot_reads_back_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    folder = SnapshotFolder(tmp_path / "new" / "states")
    for data in (b"first", b"second"):
        file = folder.write("robot", data)
        assert folder.read("robot") == data
    assert list(file.parent.iterdir()) == [tmp_path / "new" / "states" / "robot.snapshot"]


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../robot", "/etc/passwd", "a/b", "~nobody/x", ".hidden", "a\0b", "a\nb", "n" * 65, "é"],
)
def test_only_names_are_taken(tmp_path: Path, name: str) -> None:
    folder = SnapshotFolder(tmp_path / "states")
    for action in (lambda: folder.write(name, b"data"), lambda: folder.read(name)):
        with pytest.raises(SnapshotError, match=r"snapshot name .* is refused; allowed are"):
            action()
    assert list(tmp_path.iterdir()) == []


def test_links_and_devices_are_left_alone(tmp_path: Path) -> None:
    folder, precious = SnapshotFolder(tmp_path), tmp_path / "precious"
    precious.write_bytes(b"mine")
    (tmp_path / "link.snapshot").symlink_to(precious)
    (tmp_path / "dangling.snapshot").symlink_to(tmp_path / "none")
    os.mkfifo(tmp_path / "pipe.snapshot")
    (tmp_path / "folder.snapshot").mkdir()
    for name in ("link", "dangling", "pipe", "folder"):
        with pytest.raises(SnapshotError, match="is a link, a device or a folder"):
            folder.write(name, b"data")
        with pytest.raises(SnapshotError, match="is a link, a device or a folder"):
            folder.read(name)
    assert precious.read_bytes() == b"mine"
    assert not (tmp_path / "none").exists()


def test_what_cannot_be_read_or_written_is_said(tmp_path: Path) -> None:
    with pytest.raises(SnapshotError, match="does not exist; save one first"):
        SnapshotFolder(tmp_path).read("none")
    with pytest.raises(SnapshotError, match="does not exist; save one first"):
        SnapshotFolder(tmp_path / "none").read("none")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(SnapshotError, match="not written"):
        SnapshotFolder(tmp_path / "file").write("robot", b"data")


@pytest.mark.parametrize(
    ("namespace", "name"),
    [
        ("/tripod", "tripod"),
        ("/", "tripod"),
        ("/left", "left.tripod"),
        ("/lab/left", "lab.left.tripod"),
        ("/_hidden", "hidden.tripod"),
        ("/" + 200 * "a", 57 * "a" + ".tripod"),
    ],
)
def test_robots_of_one_kind_in_two_namespaces_have_two_snapshots(
    tmp_path: Path, namespace: str, name: str
) -> None:
    assert default_name(load_scene("tripod"), namespace) == name
    SnapshotFolder(tmp_path).write(name, b"data")
