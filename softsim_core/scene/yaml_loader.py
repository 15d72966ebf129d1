"""A robot or scene from a YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from softsim_core.errors import ConfigError, SceneError
from softsim_core.scene.arm.description import ArmDescription, ToolDescription
from softsim_core.scene.arm.mounting import arm_with_tools
from softsim_core.scene.files import find_config
from softsim_core.scene.plain import sourced, unstructure_scene
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.structure import structure_scene, structured
from softsim_core.scene.yaml_source import (
    SourcedMapping,
    extended,
    merge,
    parse_yaml,
    read_extended,
    relative_to_file,
)


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
