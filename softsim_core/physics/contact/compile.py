"""Decorator of the kernels of contact detection and solver, compiled or interpreted as `Compiler` decides."""

from __future__ import annotations

from pathlib import Path

from softsim_core.physics.kernels import Compiler

compiler = Compiler(Path(__file__).parent)
kernel = compiler.kernel
