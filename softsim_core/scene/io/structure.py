"""Strict conversion of plain data to typed descriptions; every error names the path of its key.

It is imported on first use: the core works without it.
"""

from __future__ import annotations

import functools
import importlib
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

from softsim_core.base import ConfigError, FieldError, MeshFile, SceneError, Vector, listing
from softsim_core.physics.actuation import ActuatorDescription, described_kinds
from softsim_core.physics.mesh import TetMesh
from softsim_core.physics.sensing import SimulatedSensorDescription
from softsim_core.scene import (
    BusServo,
    JointDescription,
    MaterialDescription,
    RobotDescription,
    ServoCalibration,
    Threads,
    beside,
    is_absent,
    keys_of,
    need_namespace,
)
from softsim_core.scene.io.keys import (
    Hook,
    RefusedValue,
    as_boolean,
    as_instance,
    as_number,
    as_one_of,
    as_path,
    as_text,
    as_threads,
    as_whole_number,
    format_value,
    material_structure,
    refuse_unknown,
    sensor_structure,
)
from softsim_core.scene.io.yaml_source import KeyPath, Place, SourcedMapping, key_path, relative_to_file


@functools.lru_cache(maxsize=2)
def scene_converter(find_files: bool) -> Any:
    """Return the converter of cattrs.

    Args:
        find_files: Search the named files; otherwise their paths stay as written.

    Raises:
        ImportError: there is no cattrs, or an old one.
    """
    cattrs = importlib.import_module("cattrs")
    gen = importlib.import_module("cattrs.gen")
    converter = cattrs.Converter(detailed_validation=True)

    def collect_items(pairs: list[tuple[str | int, Any, Any]], owner: Any) -> list[Any]:
        results = []
        for index, value, item_type in pairs:
            try:
                results.append(converter.structure(value, item_type))
            except Exception as error:
                note = cattrs.IterableValidationNote(f"item {index}", index, item_type)
                error.__notes__ = [*getattr(error, "__notes__", []), note]
                raise cattrs.IterableValidationError(f"item {index}", [error], owner) from None
        return results

    def tuple_hook(owner: Any) -> Hook:
        args = typing.get_args(owner)
        length = None if args[-1] is Ellipsis else len(args)

        def structure(value: Any, _: Any) -> tuple[Any, ...]:
            if not isinstance(value, list | tuple) or length not in (None, len(value)):
                kind = "a list" if length is None else f"a list of {length} {_noun(args[0])}"
                raise RefusedValue(f"must be {kind}, not {format_value(value)}")
            items = [args[0]] * len(value) if length is None else args
            return tuple(
                collect_items([(i, v, t) for i, (v, t) in enumerate(zip(value, items, strict=True))], owner)
            )

        return structure

    def dict_hook(owner: Any) -> Hook:
        item_type = typing.get_args(owner)[1]

        def structure(value: Any, _: Any) -> dict[str, Any]:
            if not isinstance(value, Mapping):
                raise RefusedValue(f"must be a mapping of `name: value`, not {format_value(value)}")
            items = collect_items([(key, item, item_type) for key, item in value.items()], owner)
            return dict(zip(value, items, strict=True))

        return structure

    def dataclass_hook(cls: Any) -> Hook:
        keys, inner = keys_of(cls), beside(cls)
        omitted = {each.name: gen.override(omit=True) for each in fields(cls) if is_absent(each)}
        build = gen.make_dict_structure_fn(cls, converter, **omitted)

        def structure(value: Any, _: Any) -> Any:
            if not isinstance(value, Mapping):
                raise RefusedValue(
                    f"must be a mapping with keys among {listing(keys)}, not {format_value(value)}"
                )
            refuse_unknown(value, list(keys), ("extends", "arm") if cls is RobotDescription else ())
            data = dict(value)
            for name, part in inner.items():
                data[name] = {key: data.pop(key) for key in keys_of(part) if key in data}
            built = build(data, cls)
            paths = [each.name for each in fields(cls) if isinstance(getattr(built, each.name), Path)]
            if not (find_files and paths):
                return built
            owner = f"{cls.kind} " if issubclass(cls, ActuatorDescription) else ""
            what = {name: "mesh file" if cls is MeshFile else f"file of {owner}{name}" for name in paths}
            located = {name: _locate_file(getattr(built, name), name, value, what[name]) for name in paths}
            return replace(built, **located)

        return structure

    def joint_hook(cls: Any) -> Hook:
        """Build a joint; the description of its actuator is under the key named after its kind."""
        plain = dataclass_hook(cls)

        def structure(value: Any, _: Any) -> Any:
            described = described_kinds()
            if not isinstance(value, Mapping):
                return plain(value, cls)
            keys = [*(each.name for each in fields(cls) if each.name != "actuator"), *described]
            refuse_unknown(value, keys)
            data = SourcedMapping({key: each for key, each in value.items() if key not in described}, None)
            for key in data:
                data.put(key, data[key], value.file_of(key) if isinstance(value, SourcedMapping) else None)
            for kind, description in described.items():
                if value.get(kind) is not None:
                    try:
                        data["actuator"] = converter.structure(value[kind], description)
                    except Exception as error:
                        note = cattrs.AttributeValidationNote(f"key {kind}", kind, description)
                        error.__notes__ = [*getattr(error, "__notes__", []), note]
                        raise cattrs.ClassValidationError(f"key {kind}", [error], cls) from None
            return plain(data, cls)

        return structure

    for cls, hook in (
        (float, as_number),
        (int, as_whole_number),
        (bool, as_boolean),
        (str, as_text),
        (Path, as_path),
    ):
        converter.register_structure_hook(cls, hook)
    converter.register_structure_hook_factory(is_dataclass, dataclass_hook)
    converter.register_structure_hook_factory(lambda cls: cls is JointDescription, joint_hook)
    converter.register_structure_hook_func(
        lambda cls: cls is SimulatedSensorDescription, sensor_structure(converter.structure)
    )
    converter.register_structure_hook_func(
        lambda t: _members(t) == {ActuatorDescription, type(None)}, lambda value, _: value
    )
    converter.register_structure_hook(TetMesh, as_instance)
    converter.register_structure_hook(MaterialDescription, material_structure)
    for origin, factory in ((tuple, tuple_hook), (dict, dict_hook), (Literal, as_one_of)):
        converter.register_structure_hook_factory(functools.partial(_has_origin, origin), factory)

    def mesh_or_file(value: Any, _: Any) -> Any:
        return value if value is None or isinstance(value, TetMesh) else converter.structure(value, MeshFile)

    def points_or_file(value: Any, _: Any) -> Any:
        return converter.structure(value, Path if isinstance(value, str | Path) else tuple[Vector, ...])

    def servo(value: Any, _: Any) -> Any:
        """Build a servo; one with an id is on a bus."""
        on_bus = isinstance(value, Mapping) and "id" in value
        return converter.structure(value, BusServo if on_bus else ServoCalibration)

    converter.register_structure_hook_func(lambda t: t == Threads, as_threads)
    converter.register_structure_hook_func(lambda t: _members(t) == {ServoCalibration, BusServo}, servo)
    converter.register_structure_hook_func(
        lambda t: _members(t) == {MeshFile, TetMesh, type(None)}, mesh_or_file
    )
    converter.register_structure_hook_func(
        lambda t: _members(t) == {tuple[Vector, ...], Path}, points_or_file
    )
    return converter


def _has_origin(origin: Any, annotation: Any) -> bool:
    return typing.get_origin(annotation) is origin


def _members(union: Any) -> set[Any]:
    return (
        set(typing.get_args(union)) if typing.get_origin(union) in (typing.Union, types.UnionType) else set()
    )


def _noun(item_type: Any) -> str:
    return "numbers" if item_type in (float, int) else "items"


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
    """Build a typed robot and its scene from the data of a file.

    Args:
        data: Mapping as read from YAML, or `unstructure_scene`'s.
        file: Named in messages if a value does not know its own file.
        find_files: Search the named files; otherwise their paths stay as written.

    Raises:
        ConfigError: the first problem: file, key path, value and what is allowed.
    """
    return structure_description(
        data, RobotDescription, file, lambda robot: need_namespace(robot.name), find_files
    )


def structure_description(
    data: SourcedMapping,
    cls: type[T],
    file: str | Path,
    check: Callable[[T], None] = lambda _: None,
    find_files: bool = True,
    at: str | None = None,
) -> T:
    """Build a typed description from the data of a file.

    Args:
        data: Mapping as read from YAML.
        cls: Dataclass of the description.
        file: Named in messages if a value does not know its own file.
        check: Additional check of the description, which raises an error.
        find_files: Search the named files; otherwise their paths stay as written.
        at: Key of the file that contains the data; None: they are the whole file.

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
