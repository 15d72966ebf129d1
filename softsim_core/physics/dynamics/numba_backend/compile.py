"""Numba settings of the kernels of the time step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from softsim_core.physics.actuation.compiled import compiler as actuation_compiler
from softsim_core.physics.kernels import Compiler
from softsim_core.physics.linalg import compiler as linalg_compiler

compiler = Compiler(Path(__file__).parent, uses=(linalg_compiler, actuation_compiler))
F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile a kernel of the time step, see `Compiler.kernel`."""
    return compiler.kernel(function)
