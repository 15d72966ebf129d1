"""Descriptions as plain data in the form of YAML files, and a whole scene as one text."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.base import ConfigError, SceneError
from softsim_core.physics.actuation import FRAME_KINDS, described_kinds
from softsim_core.physics.mesh import TetMesh
from softsim_core.physics.sensing import SimulatedSensorDescription
from softsim_core.scene import (
    JointDescription,
    MaterialDescription,
    RobotDescription,
    SceneDescription,
    check_size,
    is_absent,
    is_beside,
)
from softsim_core.scene.io.keys import KIND
from softsim_core.scene.io.structure import structure_scene
from softsim_core.scene.io.yaml_source import SourcedMapping, parse_yaml, plain_copy


def unstructure_scene(
    robot: RobotDescription, file: Path | None = None, *, given_only: bool = False
) -> SourcedMapping:
    """Return a robot and its scene as plain data in the form of YAML files, without controllers and source.

    Args:
        robot: Any robot; meshes given as arrays stay arrays.
        file: The file to which paths are relative.
        given_only: Leave out default values.
    """
    data: SourcedMapping = _plain(robot, file, given_only)
    return data


def mark_source(value: Any, file: Path | None) -> Any:
    """Return plain data with its mappings marked as coming from `file`."""
    return _plain(value, file)


def given_values(description: Any) -> dict[str, Any]:
    """Return any description as plain data in the form of its file, without default values."""
    data: dict[str, Any] = plain_copy(_plain(description, None, given_only=True))
    return data


def _plain(value: Any, file: Path | None, given_only: bool = False) -> Any:
    if isinstance(value, TetMesh):
        return value
    if isinstance(value, MaterialDescription):
        return SourcedMapping(value.plain(), file)
    if is_dataclass(value) and not isinstance(value, type):
        data = SourcedMapping({}, file)
        for each in fields(value):
            content = getattr(value, each.name)
            usual = each.default if each.default_factory is MISSING else each.default_factory()
            if not is_absent(each) and not (given_only and usual is not MISSING and content == usual):
                plain = _plain(content, file, given_only)
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


ORIGIN = Path("scene")
"""Name in messages in place of a file."""

_DRIVEN = ("name", "dt", "joints", "poses", "commands", "start", "keys", "board")
"""Keys that are sufficient to drive a robot."""


def write_description(robot: RobotDescription, *, given_only: bool = False) -> str:
    """Return a robot and its scene as YAML text; meshes made in Python are replaced by their size.

    With `given_only`, default values are left out for readability.
    """
    yaml = importlib.import_module("yaml")
    data = plain_copy(unstructure_scene(robot, given_only=given_only))
    for body in data.get("bodies", ()):
        if isinstance(mesh := body.get("mesh"), TetMesh):
            size = f"{len(mesh.points)} nodes, {len(mesh.tets)} tetrahedra"
            body["mesh"] = {"file": f"made in Python: {size}"}
    return str(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110))


def read_description(text: str) -> RobotDescription:
    """Read the robot and scene of a `write_description` text; no file is searched, no code runs.

    A law or an actuator that only the scene's own code defines is unknown here, and a scene may need more
    memory than allowed (see size). The result is then a robot with only its joints, or with only its name.

    Raises:
        ConfigError: no YAML, or a description without a name.
    """
    data = parse_yaml(text, ORIGIN)
    driven = SourcedMapping({key: data[key] for key in _DRIVEN if key in data}, ORIGIN)
    if isinstance(driven.get("joints"), list):
        driven["joints"] = [_frame_joint(joint) for joint in driven["joints"]]
    for some in (data, driven):
        try:
            robot = structure_scene(some, ORIGIN, find_files=False)
            check_size(robot.scene, read_files=False)
        except (ConfigError, SceneError):
            continue
        return robot
    return structure_scene(SourcedMapping({"name": data.get("name")}, ORIGIN), ORIGIN, find_files=False)


def without_contents(name: str) -> RobotDescription:
    """Return a robot of which only the name is known.

    Raises:
        FieldError: the name cannot be a robot's.
    """
    robot = RobotDescription(scene=SceneDescription(name=name))
    _ = robot.namespace
    return robot


def _frame_joint(joint: Any) -> Any:
    """Return a joint without the actuator that only the scene's own code defines."""
    kinds = {*FRAME_KINDS, *described_kinds()}
    if not isinstance(joint, Mapping) or joint.get("kind", "revolute") in kinds:
        return joint
    others = {key: value for key, value in joint.items() if key != joint["kind"]}
    return SourcedMapping({**others, "kind": "prismatic"}, ORIGIN)
