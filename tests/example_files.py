"""The files in examples/, as modules and as programs."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
MOST_LINES = 80
"""Of an example that a reader takes in at once."""


def example(name: str) -> ModuleType:
    """The module of examples/NAME.py."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def output_of_example(name: str) -> str:
    """Return what examples/NAME.py prints when a person starts it in the checkout."""
    run = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py")],
        cwd=EXAMPLES.parent,
        env={**os.environ, "PYTHONSAFEPATH": ""},  # the folder of the file may be imported from, as usual
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def lines_of_example(name: str) -> int:
    """Return the number of lines of examples/NAME.py."""
    return len((EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines())
