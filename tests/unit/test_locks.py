"""The folder for locks is private, links are not followed, and nothing in a lock reaches the terminal raw."""

from __future__ import annotations

import fcntl
import os
import re
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from softsim_core.base import LockError, RuntimeFolderError, open_lock, runtime_folder
from softsim_ros.cli.running import AlreadyUpError, lock_file, only_one

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for temporary files of everybody; XDG_RUNTIME_DIR is not set."""
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_without_a_runtime_folder_of_the_system_a_private_one_is_made(shared: Path) -> None:
    before = os.umask(0o000)
    try:
        folder = runtime_folder()
    finally:
        os.umask(before)
    assert folder.parent == shared
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert runtime_folder() == folder
    with only_one("tripod"):
        assert lock_file("tripod").parent == folder


@pytest.mark.parametrize("kind", ["link", "open to others", "a file", "of another user"])
def test_a_folder_that_others_planted_is_refused(shared: Path, kind: str) -> None:
    victim, planted = shared / "victim", shared / f"softsim-{os.getuid()}"
    victim.mkdir(mode=0o700)

    def foreign() -> None:
        if os.geteuid() != 0:
            pytest.skip("only root gives files away")
        planted.mkdir(mode=0o700)
        os.chown(planted, 12345, -1)

    plant: dict[str, Callable[[], object]] = {
        "link": lambda: planted.symlink_to(victim),
        "open to others": lambda: (planted.mkdir(), planted.chmod(0o755)),
        "a file": lambda: planted.touch(mode=0o600),
        "of another user": foreign,
    }
    plant[kind]()
    with pytest.raises(RuntimeFolderError, match="set XDG_RUNTIME_DIR"), only_one("tripod"):
        pass
    assert list(victim.iterdir()) == []


def test_a_runtime_folder_that_is_not_private_is_not_used(
    shared: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(shared / "of the login"))
    (shared / "of the login").mkdir(mode=0o700)
    assert runtime_folder() == shared / "of the login"
    (shared / "of the login").chmod(0o770)
    assert runtime_folder() == shared / f"softsim-{os.getuid()}"


def test_a_lock_follows_no_link(shared: Path) -> None:
    (shared / "kept").write_text("precious")
    lock_file("tripod").symlink_to(shared / "kept")
    with pytest.raises(LockError, match="remove it"), only_one("tripod"):
        pass
    assert (shared / "kept").read_text() == "precious"


@pytest.mark.parametrize(
    "text", [b"\x1b]0;owned\x07", b"\xff\xfe", b"4242\n\x1b[2J", "\u202e12".encode(), b""]
)
def test_what_a_lock_holds_is_a_number_or_not_said(shared: Path, text: bytes) -> None:
    lock_file("tripod").write_bytes(text)
    with open_lock(lock_file("tripod")) as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(AlreadyUpError, match=re.escape("(process unknown)")), only_one("tripod"):
            pass


def test_nothing_else_chooses_a_name_in_a_shared_folder() -> None:
    found = [
        str(file.relative_to(REPOSITORY))
        for package in ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge")
        for file in sorted((REPOSITORY / package).rglob("*.py"))
        if re.search(r"gettempdir|get\(\"XDG_RUNTIME_DIR|[\"']/tmp/", file.read_text())
    ]
    assert found == ["softsim_core/base/files.py"]
