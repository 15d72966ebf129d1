"""The decorator of the actuators' kernels, compiled or plain as `Compiler` says."""

from __future__ import annotations

from pathlib import Path

from softsim_core.physics.kernels import Compiler

compiler = Compiler(Path(__file__).parent)
kernel = compiler.kernel
