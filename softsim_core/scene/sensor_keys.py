"""Sensors in scene files: the key `kind` says whose keys the others are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from softsim_core.errors import SceneError
from softsim_core.scene.yaml_source import SourcedMapping
from softsim_core.sensing.registry import sensor_kind, sensor_kinds
from softsim_core.values import FieldError
from softsim_core.wrong_names import one_of

KIND = "kind"


def sensor_structure(structure: Callable[[Any, type], Any]) -> Callable[[Any, type], Any]:
    """How the description of a sensor is made of plain data.

    Args:
        structure: Makes a description of a type of plain data.
    """

    def made(value: Any, base: type) -> Any:
        if not isinstance(value, Mapping):
            return structure(value, sensor_kind(sensor_kinds()[0]).description)
        kind = value.get(KIND)
        try:
            description = sensor_kind(str(kind)).description
        except SceneError:
            given = "absent" if kind is None else repr(kind)
            raise FieldError("sensor", KIND, given, one_of(kind, sensor_kinds())) from None
        own = SourcedMapping({key: each for key, each in value.items() if key != KIND}, None)
        for key in own:
            own.put(key, own[key], value.file_of(key) if isinstance(value, SourcedMapping) else None)
        return structure(own, description)

    return made
