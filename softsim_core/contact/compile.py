"""The decorator of the contact kernels; without Numba they run as plain Python."""

from __future__ import annotations

from pathlib import Path

from softsim_core.kernels import Compiler

compiler = Compiler(Path(__file__).parent)
kernel = compiler.kernel
