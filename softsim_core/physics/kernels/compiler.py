"""Compilation of a package's kernels with Numba, cached under a hash of the package's sources."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

from softsim_core.base import runtime_folder

F = TypeVar("F", bound=Callable[..., Any])

_FLAGS = {"contract", "reassoc", "nsz", "arcp"}  # sums may be re-ordered; NaN and infinity stay exact


def why_plain() -> str | None:
    """Return why kernels stay plain Python, and the remedy; None: Numba compiles them."""
    try:
        numba = _numba()
    except ImportError:
        return "numba is not installed: pip install numba"
    if numba.config.DISABLE_JIT:
        return "NUMBA_DISABLE_JIT is set, as for a debugger: unset it"
    return None


def _numba() -> Any:
    """Return Numba, configured by the environment alone.

    Numba also reads `.numba_config.yaml` in the current folder, which could name a cache with foreign code.
    """
    import numba
    from numba.core import config

    if config._config_fname:
        config._config_fname = ""
        config.reload_config()  # type: ignore[no-untyped-call]
    return numba


def _is_own(folder: Path) -> bool:
    """Return whether a folder belongs to this user and only this user may write into it.

    On systems without POSIX users the check is only whether it is writable.
    """
    if not os.access(folder, os.W_OK):
        return False
    status = folder.stat()
    return not hasattr(os, "geteuid") or (status.st_uid == os.geteuid() and not status.st_mode & stat.S_IWOTH)


def _folder_of_the_user() -> Path:
    """Return the folder for caches of this user; without one, the folder of the user's running programs."""
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "softsim"
        folder.mkdir(parents=True, exist_ok=True)
        if _is_own(folder):
            return folder
    except (OSError, RuntimeError):  # a service without a home
        pass
    return runtime_folder()


class OneSignature:
    """A kernel whose argument types are always the same, so that they are checked only once.

    With forty arrays this saves 25 us per call. Later calls do not detect arguments of other types.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function: Any = function
        self._code: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel; the first call compiles it for these arguments, or loads it from the cache."""
        if self._code is None:
            self._code = self._function
            if hasattr(self._function, "for_python"):
                from numba import typeof

                type_of: Callable[[Any], Any] = typeof
                self._code = self._function.for_python.compile(tuple(type_of(each) for each in arguments))
        return self._code(*arguments)


class Compiler:
    """Compiler of the kernels in one folder; they stay plain Python for the reasons of `why_plain`.

    The cache is in a folder named after all sources of the package, since Numba misses a change in a kernel
    that another one calls. It is beside the sources or, if the user does not own them, in a folder of the
    user.

    Args:
        folder: The package; its sub-packages belong to it.
        uses: Compilers of the packages with kernels that are called here.
    """

    def __init__(self, folder: Path, uses: Sequence[Compiler] = ()) -> None:
        self._beside = folder / "__pycache__"
        digest = hashlib.sha256(Path(__file__).read_bytes())
        for used in uses:
            digest.update(used.name.encode())
        for source in sorted(folder.rglob("*.py")):
            digest.update(source.read_bytes())
        self.name: str = f"kernels-{digest.hexdigest()[:16]}"
        self._numba: Any = None
        if why_plain():
            return
        self._numba = _numba()
        if self._numba.config.CACHE_DIR:
            base = Path(self._numba.config.CACHE_DIR)
        elif _is_own(self._beside if self._beside.is_dir() else folder):
            base = self._beside
        else:
            base = _folder_of_the_user()
        self._cache = str(base / self.name)

    @property
    def cache(self) -> Path | None:
        """The folder of the cache; None if nothing is compiled."""
        return None if self._numba is None else Path(self._cache)

    def kernel(self, function: F) -> F:
        """Compile with cache, without the GIL; kernels are at module level, where the cache works.

        A kernel that another kernel calls has no wrapper for Python, and the kernels inside one that Python
        calls have none either: with forty arrays in its arguments the wrapper takes as long to compile as the
        kernel. No kernel has a wrapper for callers in C.
        """
        if self._numba is None:
            return function
        from softsim_core.physics.kernels.dispatchers import ForPython, Inside

        inside = self._compile(function, Inside, Path(self._cache), no_cpython_wrapper=True)
        folder = Path(self._cache) / "for_python"
        inside.with_wrapper = partial(self._compile, function, ForPython, folder)
        return cast(F, inside)

    def part(self, function: F) -> F:
        """Compile a function that is copied into the kernels that call it, so that it needs no cache."""
        if self._numba is None:
            return function
        options = {"nogil": True, "fastmath": _FLAGS, "error_model": "numpy", "forceinline": True}
        options |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": True}
        return cast(F, self._numba.njit(**options)(function))

    def _compile(self, function: F, kind: type, folder: Path, **options: bool) -> Any:
        compiled = self._numba.njit(
            nogil=True, fastmath=_FLAGS, error_model="numpy", no_cfunc_wrapper=True, **options
        )(function)
        compiled.__class__ = kind
        compiled.cache_in(folder, self.name)
        return compiled

    def forget_old_kernels(self) -> None:
        """Remove files of earlier versions of the kernels beside the present cache."""
        for folder in self._beside.glob("kernels-*"):
            if folder.name != self.name:
                shutil.rmtree(folder, ignore_errors=True)
