"""Atomic file writes, lock files, and the runtime folder that processes of one user share.

A downloaded folder may contain a link where a file is expected. The product writes all files through this
module, so that such a link is replaced or refused, and its target is never changed.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, BinaryIO, Final, Literal, TextIO, overload

from softsim_core.base.errors import SoftSimError

_NO_LINKS: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Open flags of every written file; a pipe in its place fails instead of blocking."""


def write_file(file: Path, data: bytes | str, *, mode: int | None = None, replaces: bool = True) -> Path:
    """Write a file atomically: write a new file beside it, flush it to the disk, then rename it.

    Args:
        file: The file; a link there is replaced, not followed.
        data: The content; text is written as UTF-8 with its line ends unchanged.
        mode: Permissions; None: those of the replaced file, else the default of new files.
        replaces: Whether an existing file is replaced.

    Returns:
        The file.

    Raises:
        FileExistsError: the file exists and must not be replaced.
        OSError: it cannot be written, or its place is taken by something that is no ordinary file; the
            existing content is not changed.
    """
    if replaces:
        found = _permissions(file)
        mode = found if mode is None else mode
    new = file.with_name(f".softsim.{secrets.token_hex(8)}")
    number = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NO_LINKS, 0o666 if mode is None else mode)
    try:
        with os.fdopen(number, "wb") as stream:
            stream.write(data.encode() if isinstance(data, str) else data)
            stream.flush()
            os.fsync(stream.fileno())
            if mode is not None:
                new.chmod(mode)
        if replaces:
            new.replace(file)
        else:
            file.hardlink_to(new)
            new.unlink()
    except BaseException:
        with suppress(OSError):
            new.unlink()
        raise
    sync(file.parent)
    return file


def put_in_place(new: Path, file: Path) -> None:
    """Flush a complete file to the disk, then rename it to replace another one.

    Raises:
        OSError: it cannot be renamed; the existing file is not changed.
    """
    _permissions(file)
    sync(new)
    new.replace(file)
    sync(file.parent)


@overload
def open_in_place(
    file: Path, mode: Literal["a", "w"], *, encoding: str | None = ..., newline: str | None = ...
) -> TextIO: ...


@overload
def open_in_place(file: Path, mode: Literal["r+b"]) -> BinaryIO: ...


def open_in_place(file: Path, mode: str, *, encoding: str | None = None, newline: str | None = None) -> Any:
    """Open a file that is modified in place: a journal, a log, a recording. Links are never opened.

    Raises:
        OSError: it cannot be opened, or is a link or no ordinary file.
    """

    def opener(name: str, flags: int) -> int:
        try:
            number = os.open(name, flags & ~os.O_TRUNC | _NO_LINKS, 0o666)
        except OSError as error:
            raise _link(file) if error.errno == errno.ELOOP else error from None
        if not stat.S_ISREG(os.fstat(number).st_mode):
            os.close(number)
            raise _unusual(file)
        if flags & os.O_TRUNC:
            os.ftruncate(number, 0)
        return number

    return open(file, mode, encoding=encoding, newline=newline, opener=opener)


def make_folder(folder: Path) -> Path:
    """Create a folder of the product unless it exists; return it.

    Raises:
        OSError: it cannot be created, or its place is taken by a link.
    """
    if folder.is_symlink():
        raise _link(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def refuse_links(folder: Path) -> None:
    """Reject a folder that contains links at any depth; the folder itself may be reached through a link.

    For folders whose content another library writes, and which never contain links when they are created
    here.

    Raises:
        OSError: it contains a link, which the error names.
    """
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            if (each := Path(place, name)).is_symlink():
                raise _link(each)


def sync(path: Path) -> None:
    """Flush a file or the entries of a folder to the disk; folders only where the system supports it.

    Raises:
        OSError: the disk fails.
    """
    if path.is_dir() and not hasattr(os, "O_DIRECTORY"):
        return
    number = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR | _NO_LINKS)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def sync_tree(path: Path) -> None:
    """Flush a file, or a folder with all its contents, to the disk; do nothing if it does not exist."""
    for place, _, files in os.walk(path):
        for name in files:
            sync(Path(place, name))
        sync(Path(place))
    if path.is_file():
        sync(path)


def _permissions(file: Path) -> int | None:
    """Return the permissions of the ordinary file at a path; None: there is none, or a link to one.

    Raises:
        OSError: the path or the target of its link is a device, a pipe or a folder.
    """
    try:
        found = file.lstat()
        is_link = stat.S_ISLNK(found.st_mode)
        is_stream = is_link and file.readlink().is_relative_to("/proc")  # /dev/stdout
        if is_stream or not stat.S_ISREG((file.stat() if is_link else found).st_mode):
            raise _unusual(file)
    except FileNotFoundError:
        return None
    return None if is_link else stat.S_IMODE(found.st_mode)


def _link(path: Path) -> OSError:
    return OSError(
        errno.ELOOP, f"{path.name} is a link, and nothing is written through links; remove it", str(path)
    )


def _unusual(path: Path) -> OSError:
    return OSError(
        errno.EINVAL, f"{path.name} is a device, a pipe or a folder, not an ordinary file", str(path)
    )


class RuntimeFolderError(SoftSimError, RuntimeError):
    """There is no folder that only this user can write; carries the refused one."""

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

    It is XDG_RUNTIME_DIR if that is private, else `softsim-UID` in the folder for temporary files.

    Raises:
        RuntimeFolderError: another user has created that folder, or others may use it.
    """
    session_folder = environment.get("XDG_RUNTIME_DIR")
    if session_folder and Path(session_folder).is_absolute() and not _problem(Path(session_folder)):
        return Path(session_folder)
    folder = Path(tempfile.gettempdir()) / f"softsim-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    if problem := _problem(folder):
        raise RuntimeFolderError(folder, problem)
    return folder


def open_lock(file: Path) -> IO[str]:
    """Open a lock file for reading and writing; create it if it is missing, and do not change its content.

    Raises:
        LockError: it is a link, or cannot be opened.
    """
    try:
        number = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        raise LockError(file, error.strerror or str(error)) from error
    return open(number, "r+", encoding="utf-8", errors="replace")  # noqa: PTH123


def _problem(folder: Path) -> str:
    """Return why a folder is not private, or an empty text."""
    try:
        status = folder.lstat()
    except OSError as error:
        return f"cannot be used ({error.strerror})"
    if not stat.S_ISDIR(status.st_mode):
        return "is no folder" if not stat.S_ISLNK(status.st_mode) else "is a link"
    if status.st_uid != os.getuid():
        return f"belongs to the user {status.st_uid}"
    if status.st_mode & 0o077:
        return f"can be used by others (mode {stat.S_IMODE(status.st_mode):o})"
    return ""
