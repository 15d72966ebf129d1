"""Lock files, and the folder for what processes of one user share while they run."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO

from softsim_core.errors import SoftSimError


class RuntimeFolderError(SoftSimError, RuntimeError):
    """There is no folder that only this user can write; carries the one that was refused."""

    def __init__(self, folder: Path, problem: str) -> None:
        self.folder = folder
        super().__init__(
            f"{folder} {problem}, so another user could mislead this program; remove it, or set "
            "XDG_RUNTIME_DIR to a folder of your own (chmod 700)"
        )


class LockError(SoftSimError, OSError):
    """A lock file cannot be opened; carries the file."""

    def __init__(self, file: Path, reason: str) -> None:
        self.file = file
        super().__init__(f"{file} cannot be opened as a lock file ({reason}); remove it")


def runtime_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return a folder of this user alone for locks, links and logs of running programs.

    It is XDG_RUNTIME_DIR where that is private, else `softsim-UID` in the folder for temporary files.

    Raises:
        RuntimeFolderError: somebody else has made that folder, or others may use it.
    """
    given = environment.get("XDG_RUNTIME_DIR")
    if given and Path(given).is_absolute() and not _problem(Path(given)):
        return Path(given)
    folder = Path(tempfile.gettempdir()) / f"softsim-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    if problem := _problem(folder):
        raise RuntimeFolderError(folder, problem)
    return folder


def open_lock(file: Path) -> IO[str]:
    """Open a lock file for reading and writing; it is made where it is missing, and nothing in it changes.

    Raises:
        LockError: it is a link, or cannot be opened.
    """
    try:
        number = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        raise LockError(file, error.strerror or str(error)) from error
    return open(number, "r+", encoding="utf-8", errors="replace")  # noqa: PTH123


def _problem(folder: Path) -> str:
    """Why a folder is not private, or nothing."""
    try:
        seen = folder.lstat()
    except OSError as error:
        return f"cannot be used ({error.strerror})"
    if not stat.S_ISDIR(seen.st_mode):
        return "is no folder" if not stat.S_ISLNK(seen.st_mode) else "is a link"
    if seen.st_uid != os.getuid():
        return f"belongs to the user {seen.st_uid}"
    if seen.st_mode & 0o077:
        return f"can be used by others (mode {stat.S_IMODE(seen.st_mode):o})"
    return ""
