"""What makes results comparable: hashes of study, scene and code, and versions of packages."""

from __future__ import annotations

import functools
import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import is_dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.mesh.types import TetMesh
from softsim_core.scene.plain import unstructure_scene
from softsim_core.scene.robot import RobotDescription

PACKAGES = ("softsim", "numpy", "scipy", "numba", "llvmlite")
"""Whose versions may change a bit of a result."""


@functools.cache
def versions() -> dict[str, str]:
    """Versions of Python and of the packages that compute."""
    told = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            told[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            told[name] = "none"
    return told


def scene_hash(robot: RobotDescription, code: tuple[Path, ...] = ()) -> str:
    """SHA-256 of a scene as it is built: every value, and what its files hold, wherever they lie.

    Args:
        robot: The scene.
        code: Python files that act in it.
    """
    digest = hashlib.sha256(json.dumps(_plain(unstructure_scene(robot)), sort_keys=True).encode())
    for file in (*code, *((robot.source,) if robot.source and robot.source.suffix == ".py" else ())):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def text_hash(data: Any) -> str:
    """SHA-256 of plain data, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(_plain(data), sort_keys=True).encode()).hexdigest()


def _plain(data: Any) -> Any:
    """Data as JSON takes them; a file is what it holds."""
    if isinstance(data, Mapping):
        return {str(key): _plain(each) for key, each in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(each) for each in data]
    if isinstance(data, TetMesh):
        return _digest(data.points.tobytes() + data.tets.tobytes())
    if isinstance(data, np.ndarray):
        return _digest(data.tobytes())
    if isinstance(data, str) and data.startswith("/") and Path(data).is_file():
        return _digest(Path(data).read_bytes())
    if is_dataclass(data) or not isinstance(data, str | int | float | bool | None):
        return repr(data)
    return data


def _digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"
