"""The decorator of the contact kernels; without Numba they run as plain Python."""

from __future__ import annotations

from pathlib import Path

from softsim_core.kernels import Compiler

_compiler = Compiler(Path(__file__).parent)
kernel = _compiler.kernel
forget_old_kernels = _compiler.forget_old_kernels
