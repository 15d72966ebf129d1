"""A package of three small kernels, one of which calls another."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

SOURCE = """
from pathlib import Path

from softsim_core.physics.kernels import Compiler

compiler = Compiler(Path(__file__).parent)
kernel = compiler.kernel


@kernel
def twice(values):
    for i in range(len(values)):
        values[i] *= 2.0


@kernel
def first(values):
    return values[0]


@kernel
def four_times(values):
    twice(values)
    twice(values)
"""


def loaded(folder: Path) -> ModuleType:
    """The package in a folder, as a process loads it; others do not find it, and it is compiled here."""
    spec = importlib.util.spec_from_file_location("kernels_here", folder / "kernels_here.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
