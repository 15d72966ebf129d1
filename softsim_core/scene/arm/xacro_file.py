"""Xacro files, expanded to URDF by ROS's own xacro."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from softsim_core.errors import ConfigError
from softsim_core.extras import install_command
from softsim_core.scene.arm.packages import not_found, package_folders
from softsim_core.scene.programs import allowed_program, may_hold_programs


def expanded(file: Path, arguments: Mapping[str, str], most_bytes: int) -> bytes:
    """The URDF of a xacro file.

    Xacro computes what stands in `${...}` as Python does: such a file is a program, and runs only where
    `scene.programs` allows it. `$(find PACKAGE)` is the first of its `package_folders`; beside the folders
    above the file only where programs may run, since xacro runs what it includes.

    Args:
        file: The file.
        arguments: Values of its arguments (`xacro:arg`), by name.
        most_bytes: A longer file is refused.

    Raises:
        ConfigError: it may not run, xacro is not installed, or the file is too long or cannot be expanded.
        OSError: there is no such file.
    """
    program = allowed_program(file)
    if program.stat().st_size > most_bytes:
        raise ConfigError(file, "", f"is longer than {most_bytes} bytes; make it shorter")
    try:
        xacro: Any = importlib.import_module("xacro")
        substitution: Any = importlib.import_module("xacro.substitution_args")
    except ImportError as error:
        problem = f"is a xacro file, which xacro expands: {install_command('arm')} (or apt install "
        raise ConfigError(file, "", f"{problem}ros-jazzy-xacro)") from error
    with _finding(substitution, file):
        try:
            document = xacro.process_file(str(program), mappings=dict(arguments), verbosity=0)
            return bytes(document.toprettyxml(indent=" ", encoding="utf-8"))
        except Exception as error:  # the library's own kinds, and whatever an expression raises
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:1000]
            raise ConfigError(file, "", f"xacro cannot expand it ({reason})") from error


@contextmanager
def _finding(substitution: Any, file: Path) -> Iterator[None]:
    """While it lasts, xacro looks for packages as meshes of a URDF file are looked for."""

    def find(package: str) -> str:
        folder = next(package_folders(package, file, may_hold_programs), None)
        if folder is None:
            raise LookupError(not_found(package, file))
        return str(folder)

    before = substitution._eval_find
    substitution._eval_find = find
    try:
        yield
    finally:
        substitution._eval_find = before
