"""Which values of a scene name files: by the types of its descriptions, so that no key can be forgotten."""

from __future__ import annotations

import functools
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from softsim_core.actuation.building import ActuatorDescription
from softsim_core.actuation.registry import described_kinds
from softsim_core.scene.arm.description import ArmDescription
from softsim_core.scene.file_keys import is_absent, is_beside
from softsim_core.scene.robot import RobotDescription
from softsim_core.sensing.description import SimulatedSensorDescription
from softsim_core.sensing.registry import sensor_kind, sensor_kinds
from softsim_core.values import SceneName

KEYS_OF_FILES: dict[str, Any] = {"extends": SceneName, "arm": ArmDescription}
"""Keys at the top of a scene's file that are no field of its description, with their types."""


def file_names(data: Any, kind: Any = RobotDescription) -> Iterator[str]:
    """Texts that name files in what a file gives for a description.

    Args:
        data: Plain data, whole or a part; what does not fit its type is left to who makes descriptions of it.
        kind: Type of the description.
    """
    if kind in (Path, SceneName):
        if isinstance(data, str | Path):
            yield str(data)
    elif isinstance(kind, type) and is_dataclass(kind):
        for key, each in _keys(kind) if isinstance(data, Mapping) else ():
            if key in data:
                yield from file_names(data[key], each)
    elif typing.get_origin(kind) in (typing.Union, types.UnionType):
        for each in typing.get_args(kind):
            yield from file_names(data, each)
    elif typing.get_args(kind):
        items = data.values() if isinstance(data, Mapping) else data if isinstance(data, list | tuple) else ()
        for item in items:
            for each in typing.get_args(kind):
                yield from file_names(item, each)


def named_files(value: Any) -> set[Path]:
    """Every file that a description names: all paths in it, wherever they stand."""
    if isinstance(value, Path):
        return {value}
    if is_dataclass(value) and not isinstance(value, type):
        parts = [getattr(value, each.name) for each in fields(value) if not is_absent(each)]
    elif isinstance(value, Mapping):
        parts = list(value.values())
    elif isinstance(value, tuple | list):
        parts = list(value)
    else:
        return set()
    return {file for part in parts for file in named_files(part)}


def _keys(kind: type) -> Iterator[tuple[str, Any]]:
    """Keys of a description in a file, each with its type, or with several where it is of several kinds."""
    if kind is RobotDescription:
        yield from KEYS_OF_FILES.items()
    if kind is SimulatedSensorDescription:
        for name in sensor_kinds():
            yield from _keys(sensor_kind(name).description)
    hints = _hints(kind)
    for each in fields(kind):
        if is_absent(each):
            continue
        held = hints[each.name]
        if is_beside(each):
            yield from _keys(held)
        elif ActuatorDescription in typing.get_args(held):
            yield from described_kinds().items()
        else:
            yield each.name, held


_hints = functools.cache(typing.get_type_hints)
