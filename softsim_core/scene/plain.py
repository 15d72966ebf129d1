"""Descriptions as plain data, in the form of the YAML files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.mesh.types import TetMesh
from softsim_core.scene.file_keys import is_absent, is_beside
from softsim_core.scene.joint import JointDescription
from softsim_core.scene.material import MaterialDescription
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.sensor_keys import KIND
from softsim_core.scene.yaml_source import SourcedMapping
from softsim_core.sensing.description import SimulatedSensorDescription


def unstructure_scene(
    robot: RobotDescription, file: Path | None = None, *, given_only: bool = False
) -> SourcedMapping:
    """A robot and its scene as plain data, in the form of the YAML files (without controllers and source).

    Args:
        robot: Any robot; meshes given as arrays stay arrays.
        file: The file that relative paths are relative to.
        given_only: Leave out what is as by default.
    """
    data = _plain(robot, file, given_only)
    assert isinstance(data, SourcedMapping)
    return data


def sourced(value: Any, file: Path | None) -> Any:
    """Plain data with its mappings marked as coming from `file`."""
    return _plain(value, file)


def _plain(value: Any, file: Path | None, given_only: bool = False) -> Any:
    if isinstance(value, TetMesh):
        return value
    if isinstance(value, MaterialDescription):
        return SourcedMapping(value.plain(), file)
    if is_dataclass(value) and not isinstance(value, type):
        data = SourcedMapping({}, file)
        for each in fields(value):
            held = getattr(value, each.name)
            if not is_absent(each) and not (given_only and _is_default(each, held)):
                plain = _plain(held, file, given_only)
                data.update(plain if is_beside(each) else {each.name: plain})
        if isinstance(value, JointDescription):
            actuator = data.pop("actuator", None)
            if value.actuator is not None:
                data[value.actuator.kind] = actuator
        if isinstance(value, SimulatedSensorDescription):
            data[KIND] = value.kind
        return data
    if isinstance(value, Mapping):
        return SourcedMapping({key: _plain(item, file, given_only) for key, item in value.items()}, file)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item, file, given_only) for item in value]
    return str(value) if isinstance(value, Path) else value


def _is_default(field: Field[Any], value: Any) -> bool:
    usual = field.default_factory() if field.default_factory is not MISSING else field.default
    return bool(usual is not MISSING and value == usual)
