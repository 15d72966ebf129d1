"""Numba's cache of compiled kernels on disk: a file is loaded only if it is whole and of this user.

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
"""Of new files: not group-writable, whatever the umask is."""


_READING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""A pipe in a file's place would wait for a writer."""


class _RefusedFileError(Exception):
    """A file of the cache is damaged, or of others; the text is the reason."""


class CheckedFiles(IndexDataCacheFile):
    """The files of one kernel: each begins with a digest of what follows and of what it is for."""

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
        """Return what a file holds; None where there is none for this version of Numba and of the sources."""
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
        """Return what a file is for; one of another Numba, of other sources or another kernel is not used."""
        return sha256(repr((self._version, self._source_stamp, name)).encode()).digest()


class Place:
    """The folder of a kernel's files, as Numba's caches ask for it.

    Numba names its own folders after the path of the source, and what lies there is valid for one time of the
    source. Here both follow from the content: copies of a package share what is compiled, and a file that is
    written again with the same content compiles nothing.

    Args:
        folder: Where the files lie.
        content: What names the sources by their content.
        function: The kernel.
    """

    def __init__(self, folder: Path, content: str, function: Callable[..., Any]) -> None:
        self._folder, self._content = str(folder), content
        self._py_file = function.__code__.co_filename  # Numba reads it for a warning
        self._line = function.__code__.co_firstlineno

    def from_function(self, function: Callable[..., Any], file: str) -> Place:
        """Return the place of a function: this one, made where that can be done."""
        with suppress(OSError):
            os.makedirs(self._folder, exist_ok=True)  # noqa: PTH103 (Numba's paths are strings)
        return self

    def get_cache_path(self) -> str:
        """Return the folder."""
        return self._folder

    def ensure_cache_path(self) -> None:
        """Make the folder, and see whether it can be written.

        Raises:
            OSError: it cannot.
        """
        os.makedirs(self._folder, exist_ok=True)  # noqa: PTH103 (Numba's paths are strings)
        TemporaryFile(dir=self._folder).close()

    def get_source_stamp(self) -> str:
        """Return what the files of these sources have in common."""
        return self._content

    def get_disambiguator(self) -> str:
        """Return the line of the function: it distinguishes functions of one name in one file."""
        return str(self._line)


class KernelCache(FunctionCache):
    """Numba's cache of one function, in checked files; a disk that takes nothing stops nobody.

    Args:
        function: The kernel.
        folder: Where its files lie.
        content: What names the sources by their content.
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
        """Keep a compiled kernel where that can be done."""
        with suppress(OSError):
            super().save_overload(sig, data)


def _private(path: str) -> bytes:
    """Return the content of a regular file that only this user, or root, may write.

    Raises:
        _RefusedFileError: it is no such file.
        OSError: it cannot be read.
    """
    number = os.open(path, _READING)
    with open(number, "rb") as file:  # noqa: PTH123
        seen = os.fstat(number)
        if not stat.S_ISREG(seen.st_mode):
            raise _RefusedFileError("is no regular file")
        if hasattr(os, "geteuid"):  # else the system has other users, and other rights, than POSIX
            if seen.st_uid not in (0, os.geteuid()):
                raise _RefusedFileError(f"belongs to the user {seen.st_uid}")
            if seen.st_mode & OTHERS_MAY_WRITE:
                raise _RefusedFileError(f"can be written by others (mode {stat.S_IMODE(seen.st_mode):o})")
        return file.read()


def _whole(content: bytes) -> bytes:
    """Return what follows the digest.

    Raises:
        _RefusedFileError: it is not what the digest was made of.
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
    """Warn of no dropped file: for processes that compile for another one, which has warned."""
    global _warned
    _warned = True
