"""`softsim bench`: run the measurements in the folder benchmarks/ of a checkout; wheels do not contain it."""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path
from types import ModuleType

from softsim_core.base import SoftSimError


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments.

    Raises:
        SoftSimError: there is no checkout around this package.
    """
    _benchmarks().configure(parser)


def run(arguments: argparse.Namespace) -> int:
    """Measure, print, write; return the exit code."""
    return int(_benchmarks().run(arguments))


def _benchmarks() -> ModuleType:
    root = Path(__file__).resolve().parents[3]
    if not (root / "benchmarks" / "command.py").is_file():
        raise SoftSimError(
            f"the measurements of softsim bench are not installed: {root} has no folder benchmarks; "
            "run ./softsim bench in a checkout"
        )
    if str(root) not in sys.path:
        sys.path.append(str(root))
    return importlib.import_module("benchmarks.command")
