"""Numba settings of all compiled kernels, and where their cache lives."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import config, njit
from numba.extending import intrinsic as numba_intrinsic

F = TypeVar("F", bound=Callable[..., Any])
_settings: Any = config


def _cache_directory() -> Path:
    """A folder named after the kernels' sources: Numba misses a change in a kernel that another one calls."""
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for source in sorted(here.glob("*.py")):
        digest.update(source.read_bytes())
    beside = here / "__pycache__"
    if _settings.CACHE_DIR:
        base = Path(_settings.CACHE_DIR)
    elif os.access(beside if beside.is_dir() else here, os.W_OK):
        base = beside
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "softsim"
    return base / f"kernels-{digest.hexdigest()[:16]}"


_CACHE = str(_cache_directory())


def forget_old_kernels() -> None:
    """Remove what earlier versions of the kernels left beside the present cache."""
    for folder in (Path(__file__).parent / "__pycache__").glob("kernels-*"):
        if folder != Path(_CACHE):
            shutil.rmtree(folder, ignore_errors=True)


def kernel(function: F) -> F:
    """Compile with cache, without the GIL; sums may be re-ordered, NaN and infinity keep their meaning.

    Kernels live at module level: only there does Numba's cache serve every process.
    """
    flags = {"contract", "reassoc", "nsz", "arcp"}
    before, _settings.CACHE_DIR = _settings.CACHE_DIR, _CACHE  # read when the function is decorated
    try:
        return cast(F, njit(cache=True, nogil=True, fastmath=flags, error_model="numpy")(function))
    finally:
        _settings.CACHE_DIR = before


def inlined(function: F) -> F:
    """Part of a kernel, copied into its callers: handing over whole groups of arrays is not free."""
    return cast(F, njit(inline="always")(function))


def intrinsic(function: Callable[..., Any]) -> Any:
    """A function that writes its own machine code (LLVM); kernels call it without the typing context."""
    return numba_intrinsic(function)
