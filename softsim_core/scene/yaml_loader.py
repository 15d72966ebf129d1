"""A robot or scene from a YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.structure import sourced, structure_scene
from softsim_core.scene.yaml_source import merge, read_extended


def load_yaml(file: str | Path, overrides: Mapping[str, Any] | None = None) -> RobotDescription:
    """The robot or scene of a YAML file.

    Args:
        file: The file. Its key `extends` may name another one to lay this one over: mappings merge, lists
            of items with a `name` merge by that name, other values replace. Mesh files are relative to the
            file that names them.
        overrides: Laid over the result by the same rules, before validation.

    Returns:
        Validated description with absolute mesh paths; `source` is the file.

    Raises:
        ConfigError: any problem, in one sentence: file, key path, value, what is allowed.
    """
    path = Path(file).expanduser().absolute()
    data = read_extended(path)
    if overrides:
        data = merge(data, sourced(overrides, Path(f"overrides of {path.name}")))
    return replace(structure_scene(data, path), source=path)
