"""Compilation of the kernels of linear algebra, which need Numba."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.extending import intrinsic as numba_intrinsic

from softsim_core.physics.kernels import Compiler

F = TypeVar("F", bound=Callable[..., Any])
compiler = Compiler(Path(__file__).parent)
kernel, part = compiler.kernel, compiler.part


def inline(function: F) -> F:
    """Return a part of a kernel that is copied into its callers.

    Passing whole tuples of arrays to a function is not free.
    """
    return cast(F, njit(inline="always")(function))


def intrinsic(function: Callable[..., Any]) -> Any:
    """Return a function that generates its own machine code (LLVM).

    Kernels call it without the typing context.
    """
    return numba_intrinsic(function)
