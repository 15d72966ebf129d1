"""A scene as one text, for a process that shows it and must neither read its files nor run its code."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from softsim_core.actuation.registry import FRAME_KINDS, described_kinds
from softsim_core.errors import ConfigError, SceneError
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.plain import unstructure_scene
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.size import check_size
from softsim_core.scene.structure import structure_scene
from softsim_core.scene.yaml_source import SourcedMapping, parse_yaml

ORIGIN = Path("scene")
"""What messages name instead of a file."""

_DRIVEN = ("name", "dt", "joints", "poses", "commands", "start", "keys", "board")
"""Keys that are enough to drive a robot."""


def write_description(robot: RobotDescription, *, given_only: bool = False) -> str:
    """A robot and its scene as YAML text; meshes made in Python are named by their size.

    Args:
        robot: The robot.
        given_only: Leave out values that are as by default, for people; else it holds every value.
    """
    yaml = importlib.import_module("yaml")
    data = _plain(unstructure_scene(robot, given_only=given_only))
    return str(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110))


def read_description(text: str) -> RobotDescription:
    """The robot and scene of `write_description`; no file is looked for, no code runs.

    A law or an actuator that only the scene's own code knows is unknown here, and a scene may take more
    memory than allowed (see size): then it is a robot with its joints alone, or with nothing but its name.

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
    """A robot of which nothing but the name is known.

    Raises:
        FieldError: the name cannot be a robot's.
    """
    robot = RobotDescription(scene=SceneDescription(name=name))
    _ = robot.namespace
    return robot


def _frame_joint(joint: Any) -> Any:
    """A joint without the actuator that only the scene's own code knows."""
    kinds = {*FRAME_KINDS, *described_kinds()}
    if not isinstance(joint, Mapping) or joint.get("kind", "revolute") in kinds:
        return joint
    kept = {key: value for key, value in joint.items() if key != joint["kind"]}
    return SourcedMapping({**kept, "kind": "prismatic"}, ORIGIN)


def _plain(value: Any) -> Any:
    """What YAML can hold."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return {"file": f"made in Python: {len(value.points)} nodes, {len(value.tets)} tetrahedra"}
