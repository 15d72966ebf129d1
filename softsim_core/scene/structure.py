"""Plain data to typed descriptions: strict, and every refusal names its key path."""

from __future__ import annotations

import importlib
import typing
from collections.abc import Callable
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

from softsim_core.errors import ConfigError, SceneError
from softsim_core.scene.converter import scene_converter
from softsim_core.scene.file_keys import beside
from softsim_core.scene.robot import RobotDescription, need_namespace
from softsim_core.scene.values_of_keys import RefusedValue
from softsim_core.scene.yaml_source import KeyPath, Place, SourcedMapping, key_path
from softsim_core.values import FieldError

T = typing.TypeVar("T")


def structure_scene(data: SourcedMapping, file: str | Path, *, find_files: bool = True) -> RobotDescription:
    """A typed robot and its scene from the data of a file.

    Args:
        data: Mapping as read from YAML, or `unstructure_scene`'s.
        file: Named in messages where a value does not know its own file.
        find_files: Look for the files that are named; else their paths stay as they are written.

    Raises:
        ConfigError: the first problem: file, key path, value and what is allowed.
    """
    return structured(data, RobotDescription, file, lambda robot: need_namespace(robot.name), find_files)


def structured(
    data: SourcedMapping,
    cls: type[T],
    file: str | Path,
    check: Callable[[T], None] = lambda _: None,
    find_files: bool = True,
    at: str | None = None,
) -> T:
    """A typed description from the data of a file.

    Args:
        data: Mapping as read from YAML.
        cls: Dataclass of the description.
        file: Named in messages where a value does not know its own file.
        check: What the description must hold besides; it raises what is wrong.
        find_files: Look for the files that are named; else their paths stay as they are written.
        at: Key of the file under which the data stand; None: they are the whole file.

    Raises:
        ConfigError: the first problem: file, key path, value and what is allowed.
    """
    try:
        converter = scene_converter(find_files)
    except ImportError as error:
        problem = "loading scenes needs cattrs >= 23.2: pip install cattrs (or apt install python3-cattr)"
        raise ConfigError(file, "", problem) from error
    try:
        description: T = converter.structure(data, cls)
        check(description)
    except Exception as error:
        path, problem = _first_problem(error)
        where = key_path(path if at is None else (at, *path))
        origin, place = _origin(data, path)
        raise ConfigError(origin or file, where, problem, place) from None
    return description


def _first_problem(error: BaseException) -> tuple[KeyPath, str]:
    cattrs = importlib.import_module("cattrs")
    path: list[str | int] = []
    last: str | int | None = None
    while True:
        if isinstance(error, cattrs.BaseValidationError):
            owner, error = error.cl, error.exceptions[0]
            passed_over = beside(owner) if isinstance(owner, type) and is_dataclass(owner) else {}
            for note in getattr(error, "__notes__", ()):
                last = getattr(note, "name", getattr(note, "index", None))
                if last is not None and last not in passed_over:
                    path.append(last)
            continue
        break
    if isinstance(error, RefusedValue):
        return (*path, *error.below), error.problem
    if isinstance(error, FieldError):
        return (*path, *error.field.split(".")), f"must be {error.allowed}, not {error.value}"
    if isinstance(error, KeyError) and error.args == (last,):
        return tuple(path), "is missing; it has no default"
    if isinstance(error, SceneError):
        return tuple(path), str(error)
    return tuple(path), f"{type(error).__name__}: {error}"


def _origin(data: SourcedMapping, path: KeyPath) -> tuple[Path | None, Place | None]:
    """The file that wrote a key, and the place of it, or of the nearest key above that has one."""
    file, node, place = data.file, typing.cast(Any, data), None
    for step in path:
        if isinstance(node, SourcedMapping) and isinstance(step, str):
            if step in node:
                file, place = node.file_of(step), node.places.get(step, place)
            node = node.get(step)
        elif isinstance(node, list) and isinstance(step, int) and step < len(node):
            node = node[step]
            if isinstance(node, SourcedMapping) and (first := next(iter(node), None)) in node.places:
                file, place = node.file_of(first), node.places[first]
        else:
            break
    return file, place
