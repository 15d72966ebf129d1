"""Numba's cache of compiled kernels on disk: a file is loaded only if it is intact and owned by this user.

Numba unpickles its files and runs the machine code in them, so a damaged or foreign file could do anything.
"""

# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False

from __future__ import annotations

import os
import pickle
import stat
import warnings
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, Final

from numba.core.caching import FunctionCache, IndexDataCacheFile

OTHERS_MAY_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH

_DIGEST: Final = sha256().digest_size
_FILE_MODE: Final = 0o644
"""Mode of new files: not group-writable, whatever the umask is."""


_READING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Flags to read files without blocking, since a pipe in a file's place would wait for a writer."""


class _RefusedFileError(Exception):
    """A cache file is damaged or owned by another user; the text is the reason."""


class CheckedFiles(IndexDataCacheFile):
    """The files of one kernel: each begins with a digest of its content and of its identity."""

    def _load_index(self) -> Any:
        data = self._read(self._index_name)
        return {} if data is None else pickle.loads(data)

    def _save_index(self, overloads: Any) -> None:
        self._write(self._index_name, overloads)

    def _load_data(self, name: str) -> Any:
        data = self._read(name)
        if data is None:
            raise FileNotFoundError(name)  # Numba compiles again
        return pickle.loads(data)

    def _save_data(self, name: str, data: Any) -> None:
        self._write(name, data)

    def _read(self, name: str) -> bytes | None:
        """Return the content of a file.

        None if there is none for this version of Numba and of the sources.
        """
        path = self._data_path(name)
        try:
            data = _whole(_private(path))
        except FileNotFoundError:
            return None
        except (_RefusedFileError, OSError) as error:
            _warn_once(f"a compiled kernel is dropped and compiled again: {path} {error}")
            with suppress(OSError):
                os.unlink(path)  # noqa: PTH108 (Numba's paths are strings)
            return None
        identity = self._identity(name)
        return data[len(identity) :] if data.startswith(identity) else None

    def _write(self, name: str, value: Any) -> None:
        data = self._identity(name) + self._dump(value)
        with self._open_for_write(self._data_path(name)) as file:
            os.chmod(file.fileno(), _FILE_MODE)  # noqa: PTH101 (the open file, whatever its name is now)
            file.write(sha256(data).digest() + data)

    def _identity(self, name: str) -> bytes:
        """Return the identity of a file.

        Files of another Numba, other sources or another kernel are not used.
        """
        return sha256(repr((self._version, self._source_stamp, name)).encode()).digest()


class Place:
    """The folder of a kernel's files, in the form that Numba's caches expect.

    Numba names its own folders after the path of the source, and their content is valid for one time stamp of
    the source. Here both follow from the content: copies of a package share compiled kernels, and a file that
    is rewritten with the same content causes no compilation.

    Args:
        folder: Folder of the files.
        content: Name of the sources by their content.
        function: The kernel.
    """

    def __init__(self, folder: Path, content: str, function: Callable[..., Any]) -> None:
        self._folder, self._content = str(folder), content
        self._py_file = function.__code__.co_filename  # Numba reads it for a warning
        self._line = function.__code__.co_firstlineno

    def from_function(self, function: Callable[..., Any], file: str) -> Place:
        """Return the place of a function: this one, created if possible."""
        with suppress(OSError):
            os.makedirs(self._folder, exist_ok=True)  # noqa: PTH103 (Numba's paths are strings)
        return self

    def get_cache_path(self) -> str:
        """Return the folder."""
        return self._folder

    def ensure_cache_path(self) -> None:
        """Create the folder and check that it is writable.

        Raises:
            OSError: it is not.
        """
        os.makedirs(self._folder, exist_ok=True)  # noqa: PTH103 (Numba's paths are strings)
        TemporaryFile(dir=self._folder).close()

    def get_source_stamp(self) -> str:
        """Return the stamp that all files of these sources share."""
        return self._content

    def get_disambiguator(self) -> str:
        """Return the line of the function: it distinguishes functions of one name in one file."""
        return str(self._line)


class KernelCache(FunctionCache):
    """Numba's cache of one function, in checked files; an unwritable disk is no error.

    Args:
        function: The kernel.
        folder: Folder of its files.
        content: Name of the sources by their content.
    """

    def __init__(self, function: Callable[..., Any], folder: Path, content: str) -> None:
        place = Place(folder, content, function)
        placed: Any = type("_Placed", (FunctionCache._impl_class,), {"_locator_classes": [place]})
        self._impl_class = placed
        super().__init__(function)
        self._cache_file = CheckedFiles(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=content,
        )

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled kernel if possible."""
        with suppress(OSError):
            super().save_overload(sig, data)


def _private(path: str) -> bytes:
    """Return the content of a regular file that only this user, or root, may write.

    Raises:
        _RefusedFileError: it is not such a file.
        OSError: it cannot be read.
    """
    number = os.open(path, _READING)
    with open(number, "rb") as file:  # noqa: PTH123
        status = os.fstat(number)
        if not stat.S_ISREG(status.st_mode):
            raise _RefusedFileError("is no regular file")
        if hasattr(os, "geteuid"):  # else users and permissions are not those of POSIX
            if status.st_uid not in (0, os.geteuid()):
                raise _RefusedFileError(f"belongs to the user {status.st_uid}")
            if status.st_mode & OTHERS_MAY_WRITE:
                raise _RefusedFileError(f"can be written by others (mode {stat.S_IMODE(status.st_mode):o})")
        return file.read()


def _whole(content: bytes) -> bytes:
    """Return the content after the digest.

    Raises:
        _RefusedFileError: the digest does not match it.
    """
    data = content[_DIGEST:]
    if sha256(data).digest() != content[:_DIGEST]:
        raise _RefusedFileError("is damaged")
    return data


_warned = False


def _warn_once(text: str) -> None:
    global _warned
    if not _warned:
        _warned = True
        warnings.warn(f"{text} (up to two minutes)", stacklevel=2)


def be_silent() -> None:
    """Suppress warnings about dropped files: for processes that compile for another one, which has warned."""
    global _warned
    _warned = True
