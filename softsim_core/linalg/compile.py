"""Compiling what only works with Numba: the kernels of linear algebra, and how kernels are called."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit, typeof
from numba.extending import intrinsic as numba_intrinsic

from softsim_core.kernels import Compiler

F = TypeVar("F", bound=Callable[..., Any])
compiler = Compiler(Path(__file__).parent)
kernel = compiler.kernel


def inlined(function: F) -> F:
    """Part of a kernel, copied into its callers: handing over whole groups of arrays is not free."""
    return cast(F, njit(inline="always")(function))


def intrinsic(function: Callable[..., Any]) -> Any:
    """A function that writes its own machine code (LLVM); kernels call it without the typing context."""
    return numba_intrinsic(function)


class OneSignature:
    """A kernel that is called with arguments of the same types every time: they are looked at once only.

    With a hundred arrays that saves 10 us a call. Arguments of other types later on are not noticed.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function: Any = function
        self._code: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """Call it; the first call compiles it for these arguments, or takes that from the cache."""
        if self._code is None:
            type_of: Callable[[Any], Any] = typeof
            self._code = self._function.compile(tuple(type_of(each) for each in arguments))
        return self._code(*arguments)
