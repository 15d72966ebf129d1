"""Compiling what only works with Numba: the kernels of linear algebra."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.extending import intrinsic as numba_intrinsic

from softsim_core.physics.kernels import Compiler

F = TypeVar("F", bound=Callable[..., Any])
compiler = Compiler(Path(__file__).parent)
kernel = compiler.kernel


def inlined(function: F) -> F:
    """Part of a kernel, copied into its callers: handing over whole groups of arrays is not free."""
    return cast(F, njit(inline="always")(function))


def intrinsic(function: Callable[..., Any]) -> Any:
    """A function that writes its own machine code (LLVM); kernels call it without the typing context."""
    return numba_intrinsic(function)
