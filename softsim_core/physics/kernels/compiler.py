"""Compiling the kernels of a package with Numba, cached under a hash of the package's sources."""

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

_FLAGS = {"contract", "reassoc", "nsz", "arcp"}  # sums may be re-ordered; NaN and infinity keep their meaning


def why_plain() -> str | None:
    """Why kernels stay plain Python, and what to do; None: Numba compiles them."""
    try:
        numba = _numba()
    except ImportError:
        return "numba is not installed: pip install numba"
    if numba.config.DISABLE_JIT:
        return "NUMBA_DISABLE_JIT is set, as for a debugger: unset it"
    return None


def _numba() -> Any:
    """Return Numba, set by the environment alone.

    Numba also reads `.numba_config.yaml` in the current folder, which could name a cache of anybody's code.
    """
    import numba
    from numba.core import config

    if config._config_fname:
        config._config_fname = ""
        config.reload_config()  # type: ignore[no-untyped-call]
    return numba


def _is_own(folder: Path) -> bool:
    """Whether a folder belongs to this user, who may write into it as not everybody may.

    Systems without users of POSIX tell only whether it can be written.
    """
    if not os.access(folder, os.W_OK):
        return False
    seen = folder.stat()
    return not hasattr(os, "geteuid") or (seen.st_uid == os.geteuid() and not seen.st_mode & stat.S_IWOTH)


def _folder_of_the_user() -> Path:
    """Return the folder for caches of this user; where he has none, the one of his running programs."""
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "softsim"
        folder.mkdir(parents=True, exist_ok=True)
        if _is_own(folder):
            return folder
    except (OSError, RuntimeError):  # a service without a home
        pass
    return runtime_folder()


class OneSignature:
    """A kernel that is called with arguments of the same types every time: they are looked at once only.

    With forty arrays that saves 25 us per call. Arguments of other types later on are not noticed.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function: Any = function
        self._code: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """Call it; the first call compiles it for these arguments, or takes that from the cache."""
        if self._code is None:
            self._code = self._function
            if hasattr(self._function, "for_python"):
                from numba import typeof

                type_of: Callable[[Any], Any] = typeof
                self._code = self._function.for_python.compile(tuple(type_of(each) for each in arguments))
        return self._code(*arguments)


class Compiler:
    """Compiles the kernels in the files of one folder; they stay plain Python for `why_plain`'s reasons.

    The cache lies in a folder named after all sources of the package: Numba misses a change in a kernel that
    another one calls. It lies beside the sources; where those are not the user's own, in a folder that is.

    Args:
        folder: The package; its sub-packages belong to it.
        uses: Compilers of the packages whose kernels are called here.
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
        """The folder of the cache; None where nothing is compiled."""
        return None if self._numba is None else Path(self._cache)

    def kernel(self, function: F) -> F:
        """Compile with cache, without the GIL; kernels live at module level, where the cache serves them.

        Called by another kernel it has no wrapper for Python, and called by Python none of its own kernels
        has one: with forty arrays in its arguments that wrapper takes as long to compile as the kernel. None
        has one for callers in C.
        """
        if self._numba is None:
            return function
        from softsim_core.physics.kernels.dispatchers import ForPython, Inside

        inside = self._compiled(function, Inside, Path(self._cache), no_cpython_wrapper=True)
        folder = Path(self._cache) / "for_python"
        inside.with_wrapper = partial(self._compiled, function, ForPython, folder)
        return cast(F, inside)

    def _compiled(self, function: F, kind: type, folder: Path, **options: bool) -> Any:
        compiled = self._numba.njit(
            nogil=True, fastmath=_FLAGS, error_model="numpy", no_cfunc_wrapper=True, **options
        )(function)
        compiled.__class__ = kind
        compiled.cache_in(folder, self.name)
        return compiled

    def forget_old_kernels(self) -> None:
        """Remove what earlier versions of the kernels left beside the present cache."""
        for folder in self._beside.glob("kernels-*"):
            if folder.name != self.name:
                shutil.rmtree(folder, ignore_errors=True)
