"""Writing files: whole or not at all, and never through a link."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softsim_core import load_scene
from softsim_core.base import (
    ConfigError,
    make_folder,
    open_in_place,
    put_in_place,
    refuse_links,
    sync_tree,
    write_file,
)
from softsim_core.control.inverse import ClosedLoopLog
from softsim_core.lab.identification import write_table
from softsim_core.physics.mesh import SurfaceMesh, TetMesh, write_surface, write_tets

CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
TET = TetMesh(points=CORNERS, tets=np.array([[0, 1, 2, 3]]))
SURFACE = SurfaceMesh(points=CORNERS, triangles=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))


@pytest.fixture
def precious(tmp_path: Path) -> Path:
    """A file of the user outside the folder in which is written."""
    file = tmp_path / "precious"
    file.write_bytes(b"mine")
    (tmp_path / "folder").mkdir()
    return file


def test_a_file_is_replaced_whole_with_its_permissions(tmp_path: Path) -> None:
    file = tmp_path / "file"
    assert write_file(file, "line\r\nä\n") == file
    assert file.read_bytes() == "line\r\nä\n".encode()
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(file.stat().st_mode) == 0o666 & ~umask
    file.chmod(0o606)
    write_file(file, b"second")
    assert (file.read_bytes(), stat.S_IMODE(file.stat().st_mode)) == (b"second", 0o606)
    write_file(file, b"third", mode=0o600)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    with pytest.raises(FileExistsError):
        write_file(file, b"fourth", replaces=False)
    assert file.read_bytes() == b"third"
    assert list(tmp_path.iterdir()) == [file]


def test_what_fails_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_file(tmp_path / "file", b"old")

    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_file(file, b"new")
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]


def test_data_are_on_the_disk_before_they_are_in_their_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, events, fsync, replace = tmp_path / "file", list[str](), os.fsync, Path.replace
    monkeypatch.setattr(
        os,
        "fsync",
        lambda n: (events.append("folder" if stat.S_ISDIR(os.fstat(n).st_mode) else "file"), fsync(n)),
    )
    monkeypatch.setattr(Path, "replace", lambda a, b: (events.append("replace"), replace(a, b))[1])
    write_file(file, b"data")
    assert events == ["file", "replace", "folder"]
    events.clear()
    (tmp_path / "new").write_bytes(b"other")
    put_in_place(tmp_path / "new", file)
    assert events == ["file", "replace", "folder"]
    assert file.read_bytes() == b"other"


@pytest.mark.parametrize("place", ["pipe", "folder", "to_device", "to_stream"])
def test_what_is_no_ordinary_file_is_left_alone(tmp_path: Path, place: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "to_device").symlink_to(os.devnull)
    (tmp_path / "to_stream").symlink_to("/proc/self/fd/1")
    with pytest.raises(OSError, match="not an ordinary file"):
        write_file(tmp_path / place, b"data")
    with pytest.raises(OSError, match=r"not an ordinary file|No such device|is a link|Is a directory"):
        open_in_place(tmp_path / place, "a")


@pytest.mark.parametrize("mode", ["a", "w", "r+b"])
def test_nothing_is_opened_through_a_link(precious: Path, mode: Any) -> None:
    link = precious.parent / "folder" / "link"
    for target in (precious, precious.parent / "none"):
        link.symlink_to(target)
        with pytest.raises(OSError, match="link is a link, and nothing is written through links; remove it"):
            open_in_place(link, mode)
        link.unlink()
    assert precious.read_bytes() == b"mine"
    assert not (precious.parent / "none").exists()


def test_a_journal_grows_and_a_log_begins_anew(tmp_path: Path) -> None:
    for mode, text in (("a", "one\n"), ("a", "two\n")):
        with open_in_place(tmp_path / "file", mode, encoding="utf-8") as stream:  # type: ignore[arg-type]
            stream.write(text)
    assert (tmp_path / "file").read_text() == "one\ntwo\n"
    with open_in_place(tmp_path / "file", "w") as stream:
        stream.write("anew")
    assert (tmp_path / "file").read_text() == "anew"


def test_folders_with_links_are_refused(precious: Path) -> None:
    folder = precious.parent / "folder"
    make_folder(folder / "deep" / "er")
    refuse_links(folder)
    sync_tree(folder)
    (folder / "deep" / "er" / "link").symlink_to(precious)
    with pytest.raises(OSError, match="link is a link"):
        refuse_links(folder)
    (folder / "out").symlink_to(precious.parent, target_is_directory=True)
    with pytest.raises(OSError, match="out is a link"):
        make_folder(folder / "out")


def _log(file: Path) -> None:
    with ClosedLoopLog(file) as log:
        log.write(0.0, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))


def _calibration(file: Path) -> None:
    from servo_bridge.driver import save_calibration

    board = load_scene("tripod").board
    assert board is not None
    save_calibration(file, "tripod", board.hobby_servos)


def _figure(file: Path) -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    from softsim_ros import save_figure

    save_figure(Figure(), file)


def _urdf(file: Path) -> None:
    from softsim_ros.description import write_folder

    write_folder(load_scene("cable_finger"), file.parent, "finger")


WRITERS: dict[str, Callable[[Path], object]] = {
    "mesh.vtk": lambda file: write_tets(file, TET),
    "mesh.msh": lambda file: write_tets(file, TET),
    "surface.stl": lambda file: write_surface(file, SURFACE),
    "table.csv": lambda file: write_table(file, {"a": np.zeros(2)}),
    "log.csv": _log,
    "calibration.yaml": _calibration,
    "picture.png": _figure,
    "cable_finger.urdf": _urdf,
}


@pytest.mark.parametrize("name", WRITERS)
def test_no_writer_changes_what_a_link_in_a_downloaded_folder_leads_to(precious: Path, name: str) -> None:
    link = precious.parent / "folder" / name
    link.symlink_to(precious)
    with pytest.raises(ConfigError, match="is a link") if name == "log.csv" else nullcontext():
        WRITERS[name](link)
        assert link.is_file()
        assert not link.is_symlink()
    assert precious.read_bytes() == b"mine"
