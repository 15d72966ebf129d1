"""A robot or scene from a YAML file, with changes laid over it."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from softsim_core.base.errors import ConfigError, SceneError
from softsim_core.scene.arm.description import ArmDescription, ToolDescription
from softsim_core.scene.arm.mounting import arm_with_tools
from softsim_core.scene.io.files import find_config
from softsim_core.scene.io.portable import sourced, unstructure_scene
from softsim_core.scene.io.structure import structure_scene, structured
from softsim_core.scene.io.yaml_source import (
    SourcedMapping,
    extended,
    merge,
    parse_yaml,
    read_extended,
    relative_to_file,
)
from softsim_core.scene.robot import RobotDescription

ORIGIN = Path("overrides")
"""What messages name instead of a file."""


class Item(NamedTuple):
    """A step from a list to its item of this name."""

    name: str


Steps: TypeAlias = "tuple[str | Item, ...]"
"""From the scene to one of its parts: ("joints", Item("servo_0"), "base")."""


def override_at(steps: Sequence[str | Item], values: Mapping[str, Any]) -> dict[str, Any]:
    """Values for the fields of one part, as `load_scene` takes them."""
    data: Any = dict(values)
    for step in reversed(steps):
        data = [{"name": step.name, **data}] if isinstance(step, Item) else {step: data}
    return {**data}


def read_overrides(text: str) -> dict[str, Any]:
    """Overrides from YAML text; empty text is none.

    Raises:
        ConfigError: no YAML, or no mapping.
    """
    return parse_yaml(text, ORIGIN) if text.strip() else {}


def write_overrides(overrides: Mapping[str, Any]) -> str:
    """Overrides as YAML text, which `read_overrides` reads and a scene's file may hold; "" for none."""
    if not overrides:
        return ""
    yaml = importlib.import_module("yaml")
    return str(yaml.safe_dump(_plain(overrides), sort_keys=False, default_flow_style=None, width=100))


def laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """`above` laid over `below` by the rules of scenes: mappings and lists of named items merge."""
    merged: dict[str, Any] = _plain(merge(sourced(below, ORIGIN), sourced(above, ORIGIN)))
    return merged


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def load_yaml(
    file: str | Path, overrides: Mapping[str, Any] | None = None, text: str | None = None
) -> RobotDescription:
    """The robot or scene of a YAML file.

    Args:
        file: The file. Its key `extends` may name another one to lay this one over: mappings merge, lists
            of items with a `name` merge by that name, other values replace. Mesh files are relative to the
            file that names them.
        overrides: Laid over the result by the same rules, before validation.
        text: Stands for what the file itself holds, which is not read then; None: nothing does.

    A key `arm` stands for the robot of a URDF file with tools of the suite on its links, over which the rest
    of the file is laid; see scene.arm.

    Returns:
        Validated description with absolute mesh paths; `source` is the file.

    Raises:
        ConfigError: any problem, in one sentence: file, key path, value, what is allowed.
    """
    path = Path(file).expanduser().absolute()
    return _loaded(
        path, read_extended(path) if text is None else extended(parse_yaml(text, path), path), overrides
    )


def _loaded(
    path: Path, data: SourcedMapping, overrides: Mapping[str, Any] | None = None, below: tuple[Path, ...] = ()
) -> RobotDescription:
    """The scene of a file that holds `data`, as `load_yaml`; `below` are the files of arms that carry it."""
    if overrides:
        data = merge(data, sourced(overrides, Path(f"overrides of {path.name}")))
    if "arm" in data:
        data = _over_arm(data, path, (*below, path))
    return replace(structure_scene(data, path), source=path)


def _over_arm(data: SourcedMapping, path: Path, chain: tuple[Path, ...]) -> SourcedMapping:
    """The data of a file laid over the arm that it describes."""
    file, place, described = data.file_of("arm") or path, data.places.get("arm"), data.pop("arm")
    if not isinstance(described, SourcedMapping):
        raise ConfigError(file, "arm", "must be a mapping of urdf and others", place)
    arm = structured(described, ArmDescription, file, at="arm", find_files=False)
    arm = replace(arm, urdf=relative_to_file(arm.urdf, file))

    def tool(hung: ToolDescription) -> RobotDescription:
        named = relative_to_file(hung.robot, file)
        found = find_config(named if named.is_file() else hung.robot)
        if found.suffix == ".py" or found.resolve() in {each.resolve() for each in chain}:
            why = "runs code; name a YAML file" if found.suffix == ".py" else "carries itself"
            raise ConfigError(file, "arm.tools", f"{hung.robot} {why}")
        return _loaded(found, read_extended(found), None, chain)

    try:
        robot = arm_with_tools(str(data.get("name", path.stem)), arm, tool)
    except ConfigError:
        raise
    except SceneError as error:
        raise ConfigError(file, "arm", str(error).removeprefix("arm: ")) from error
    return merge(unstructure_scene(robot), data)
