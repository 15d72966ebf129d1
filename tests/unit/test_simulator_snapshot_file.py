"""Snapshot files: where they are, and that they are whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from softsim_core.errors import SnapshotError
from softsim_ros.simulator.snapshot_file import default_snapshot_file, read_snapshot, write_snapshot


def test_the_default_file_follows_xdg() -> None:
    assert default_snapshot_file("tripod", {"XDG_STATE_HOME": "/state"}) == Path(
        "/state/softsim/tripod.snapshot"
    )
    assert default_snapshot_file("tripod", {"HOME": "/home/me"}) == Path(
        "/home/me/.local/state/softsim/tripod.snapshot"
    )


def test_a_snapshot_reads_back_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    file = tmp_path / "new" / "robot.snapshot"
    for data in (b"first", b"second"):
        write_snapshot(file, data)
        assert read_snapshot(file) == data
    assert list(file.parent.iterdir()) == [file]


def test_what_cannot_be_read_or_written_is_said(tmp_path: Path) -> None:
    with pytest.raises(SnapshotError, match="does not exist; save one first"):
        read_snapshot(tmp_path / "none")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(SnapshotError, match="not written"):
        write_snapshot(tmp_path / "file" / "robot.snapshot", b"data")
    with pytest.raises(SnapshotError, match="not read"):
        read_snapshot(tmp_path)
