"""Scenes: typed description, files, builder, ready-made parts."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any

from softsim_core.scene.description import SceneDescription
from softsim_core.scene.io.catalog import SceneCatalog
from softsim_core.scene.io.files import Kind, find_config, known_scenes
from softsim_core.scene.io.python_loader import load_python
from softsim_core.scene.io.yaml_loader import load_yaml
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.scene import Part, Scene

__all__ = [
    "Part",
    "RobotDescription",
    "Scene",
    "SceneCatalog",
    "SceneDescription",
    "find_config",
    "known_scenes",
    "load_python",
    "load_scene",
    "load_yaml",
]


def load_scene(
    name_or_path: str | PathLike[str], overrides: Mapping[str, Any] | None = None, kind: Kind | None = None
) -> RobotDescription:
    """A robot or scene, from a YAML file or from a Python file with `create_scene(scene)`.

    Args:
        name_or_path: A name ("tripod", "tripod_step_3", "parts/servo") or a path.
        overrides: Values laid over the file's before validation, such as {"solver": {"backend": "scipy"}}:
            mappings merge, lists of named items merge by `name`, everything else is replaced.
        kind: Look a name up among "robots" or "scenes" only.

    Returns:
        Validated description; mesh paths are absolute, `source` is the file.

    Raises:
        ConfigError: nothing of that name, or any problem in the file, in one sentence.
    """
    file = find_config(name_or_path, kind)
    return load_python(file, overrides) if file.suffix == ".py" else load_yaml(file, overrides)
