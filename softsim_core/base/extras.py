"""Installation command of optional parts of the suite for the running Python."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path


def install_command(extra: str) -> str:
    """Return the command that installs an extra of the distribution where it is missing.

    In the environment of a checkout, such as that of `./softsim`, plain pip would install into another
    Python.

    Args:
        extra: Its name in pyproject.toml, such as "study".
    """
    root = Path(__file__).resolve().parents[2]
    constraints = root / "constraints.txt"
    if sys.prefix == sys.base_prefix or not constraints.is_file():
        return f"pip install 'softsim[{extra}]'"
    pip = str(Path(sys.executable).with_name("pip"))
    words = [pip, "install", "-c", str(constraints), "-e", f"{root}[{extra}]"]
    return shlex.join(words)
