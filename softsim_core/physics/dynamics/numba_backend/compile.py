"""Numba settings of the kernels of the time step."""

from __future__ import annotations

from pathlib import Path

from softsim_core.physics.actuation.compiled.compile import compiler as actuation_compiler
from softsim_core.physics.kernels import Compiler
from softsim_core.physics.linalg.compile import compiler as linalg_compiler

compiler = Compiler(Path(__file__).parent, uses=(linalg_compiler, actuation_compiler))
kernel = compiler.kernel
