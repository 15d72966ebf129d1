"""Strict conversion of plain data to typed descriptions; every error names the path of its key.

It is imported on first use: the core works without it.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

from softsim_core.base import (
    ConfigError,
    FieldError,
    MeshFile,
    SceneError,
    SceneName,
    Vector,
    listing,
    one_of,
)
from softsim_core.physics.actuation import ActuatorDescription, described_kinds
from softsim_core.physics.mesh import TetMesh
from softsim_core.physics.sensing import SimulatedSensorDescription, sensor_kind, sensor_kinds
from softsim_core.scene import (
    BusServo,
    JointDescription,
    MaterialDescription,
    RobotDescription,
    ServoCalibration,
    Threads,
    beside,
    hints_of,
    is_absent,
    keys_of,
    need_namespace,
)
from softsim_core.scene.io.keys import (
    KIND,
    RefusedValue,
    as_boolean,
    as_material,
    as_number,
    as_one_of,
    as_path,
    as_text,
    as_threads,
    as_whole_number,
    format_value,
    refuse_unknown,
)
from softsim_core.scene.io.yaml_source import KeyPath, Place, SourcedMapping, key_path, relative_to_file

_SINGLE: Mapping[Any, Callable[[Any], Any]] = {
    float: as_number,
    int: as_whole_number,
    bool: as_boolean,
    str: as_text,
    SceneName: as_text,
    Path: as_path,
    MaterialDescription: as_material,
    Threads: as_threads,
}
"""Conversion of values of one type that has no parts here."""


class _Converter:
    """Converter of plain data to values of a type; `find_files`: named files are searched.

    It raises RefusedValue for the first problem, in the order of the fields.
    """

    def __init__(self, find_files: bool) -> None:
        self._find_files = find_files

    def convert(self, value: Any, kind: Any) -> Any:
        """Return `value` as a value of the type `kind`."""
        if kind is Any:
            return value
        if kind in _SINGLE:
            return _SINGLE[kind](value)
        if kind is JointDescription and isinstance(value, Mapping):
            return self._joint(value)
        if kind is SimulatedSensorDescription:
            return self._sensor(value)
        if is_dataclass(kind):
            return self._description(value, kind)
        origin, args = typing.get_origin(kind), typing.get_args(kind)
        if origin is Literal:
            return as_one_of(value, args)
        if origin is tuple:
            return self._tuple(value, args)
        if origin is dict:
            if not isinstance(value, Mapping):
                raise RefusedValue(f"must be a mapping of `name: value`, not {format_value(value)}")
            return {key: self._below(each, args[1], key) for key, each in value.items()}
        assert origin in (typing.Union, types.UnionType), kind
        return self._one_of_types(value, {*args})

    def _below(self, value: Any, kind: Any, *steps: str | int) -> Any:
        """Convert a part; a refusal gets the steps to it."""
        try:
            return self.convert(value, kind)
        except Exception as error:
            refused = _refusal_of(error)
            raise RefusedValue(refused.problem, (*steps, *refused.below)) from None

    def _one_of_types(self, value: Any, kinds: set[Any]) -> Any:
        if value is None and type(None) in kinds:
            return None
        kinds = kinds - {type(None)}
        if TetMesh in kinds:
            return value if isinstance(value, TetMesh) else self.convert(value, MeshFile)
        if BusServo in kinds:  # a servo with an id is on a bus
            on_bus = isinstance(value, Mapping) and "id" in value
            return self.convert(value, BusServo if on_bus else ServoCalibration)
        if kinds == {float, tuple[float, ...]}:  # one number for all, or one for each
            return self.convert(value, tuple[float, ...] if isinstance(value, list | tuple) else float)
        if Path in kinds and len(kinds) > 1:
            return self.convert(value, Path if isinstance(value, str | Path) else tuple[Vector, ...])
        (kind,) = kinds
        return self.convert(value, kind)

    def _tuple(self, value: Any, args: tuple[Any, ...]) -> tuple[Any, ...]:
        length = None if args[-1] is Ellipsis else len(args)
        if not isinstance(value, list | tuple) or length not in (None, len(value)):
            noun = "numbers" if args[0] in (float, int) else "items"
            what = "a list" if length is None else f"a list of {length} {noun}"
            raise RefusedValue(f"must be {what}, not {format_value(value)}")
        kinds = [args[0]] * len(value) if length is None else args
        return tuple(
            self._below(each, kind, k) for k, (each, kind) in enumerate(zip(value, kinds, strict=True))
        )

    def _description(self, value: Any, cls: Any) -> Any:
        keys = keys_of(cls)
        if not isinstance(value, Mapping):
            raise RefusedValue(
                f"must be a mapping with keys among {listing(keys)}, not {format_value(value)}"
            )
        refuse_unknown(value, list(keys), ("extends", "arm", "tendon_arm") if cls is RobotDescription else ())
        return self._build(value, cls)

    def _joint(self, value: Mapping[str, Any]) -> JointDescription:
        """Build a joint; the description of its actuator is under the key named after its kind."""
        described = described_kinds()
        keys = [each.name for each in fields(JointDescription) if each.name != "actuator"]
        refuse_unknown(value, [*keys, *described])
        actuator = None
        for kind, description in described.items():
            if value.get(kind) is not None:
                actuator = self._below(value[kind], description, kind)
        joint: JointDescription = self._build(value, JointDescription, actuator=actuator)
        return joint

    def _sensor(self, value: Any) -> Any:
        """Build a sensor; its key `kind` chooses the description of the other keys."""
        if not isinstance(value, Mapping):
            return self._description(value, sensor_kind(sensor_kinds()[0]).description)
        kind = value.get(KIND)
        try:
            description: Any = sensor_kind(str(kind)).description
        except SceneError:
            shown = "absent" if kind is None else repr(kind)
            raise FieldError("sensor", KIND, shown, one_of(kind, sensor_kinds())) from None
        refuse_unknown({key: each for key, each in value.items() if key != KIND}, list(keys_of(description)))
        return self._build(value, description)

    def _build(self, value: Mapping[str, Any], cls: Any, **built: Any) -> Any:
        """Build a description from a mapping of known keys, and from fields that are built already."""
        hints, inner = hints_of(cls), beside(cls)
        for each in fields(cls):
            if each.name in inner:
                part = {key: value[key] for key in keys_of(inner[each.name]) if key in value}
                built[each.name] = self._below(part, inner[each.name])
            elif each.name in value and not is_absent(each):
                built[each.name] = self._below(value[each.name], hints[each.name], each.name)
            elif each.name not in built and each.default is MISSING and each.default_factory is MISSING:
                raise RefusedValue("is missing; it has no default", (each.name,))
        description = cls(**built)
        paths = [name for name in built if isinstance(getattr(description, name), Path)]
        if not (self._find_files and paths):
            return description
        owner = f"{cls.kind} " if issubclass(cls, ActuatorDescription) else ""
        what = {name: "mesh file" if cls is MeshFile else f"file of {owner}{name}" for name in paths}
        return replace(
            description, **{name: _locate_file(built[name], name, value, what[name]) for name in paths}
        )


def _refusal_of(error: Exception) -> RefusedValue:
    """Return the refusal of a value by any error of its conversion."""
    if isinstance(error, RefusedValue):
        return error
    if isinstance(error, FieldError):
        return RefusedValue(f"must be {error.allowed}, not {error.value}", tuple(error.field.split(".")))
    return RefusedValue(str(error) if isinstance(error, SceneError) else f"{type(error).__name__}: {error}")


def _locate_file(path: Path, key: str, data: Mapping[str, Any], what: str) -> Path:
    """Return the absolute path of an existing file that `key` of a mapping names."""
    origin = data.file_of(key) if isinstance(data, SourcedMapping) else None
    file = relative_to_file(path, origin)
    if not file.is_file():
        note = "" if path.is_absolute() else f" ({path} is relative to {origin or 'the working directory'})"
        raise RefusedValue(f"no such {what} {file}{note}", (key,))
    return file


T = typing.TypeVar("T")


def structure_scene(data: SourcedMapping, file: str | Path, *, find_files: bool = True) -> RobotDescription:
    """Build a typed robot and its scene from the data of a file; see `structure_description`."""
    return structure_description(data, RobotDescription, file, find_files)


def structure_description(
    data: SourcedMapping, cls: type[T], file: str | Path, find_files: bool = True, at: str | None = None
) -> T:
    """Build a typed description from the data of a file.

    Args:
        data: Mapping as read from YAML, or `unstructure_scene`'s.
        cls: Dataclass of the description.
        file: Named in messages if a value does not know its own file.
        find_files: Search the named files; otherwise their paths stay as written.
        at: Key of the file that contains the data; None: they are the whole file.

    Raises:
        ConfigError: the first problem: file, key path, value and what is allowed.
    """
    try:
        description: T = _Converter(find_files).convert(data, cls)
        if isinstance(description, RobotDescription):
            need_namespace(description.name)
    except Exception as error:
        refused = _refusal_of(error)
        origin, place = _origin(data, refused.below)
        where = key_path(refused.below if at is None else (at, *refused.below))
        raise ConfigError(origin or file, where, refused.problem, place) from None
    return description


def _origin(data: SourcedMapping, path: KeyPath) -> tuple[Path | None, Place | None]:
    """Return the file that wrote a key, and its location or that of the nearest key above with one."""
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
