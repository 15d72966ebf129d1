"""Plain data to typed descriptions and back: strict, and every refusal names its key path.

cattrs does the dispatch over the dataclasses' types; it is imported on first use: the core works without it.
"""

from __future__ import annotations

import functools
import importlib
import math
import numbers
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from softsim_core.actuation.building import ActuatorDescription
from softsim_core.actuation.registry import described_kinds
from softsim_core.errors import ConfigError, SceneError, listing
from softsim_core.fem.materials import material, material_names
from softsim_core.fem.materials.elastomers import DEFAULT_FIT, elastomer
from softsim_core.mesh.types import TetMesh
from softsim_core.scene.board import BusServo, ServoCalibration
from softsim_core.scene.description import JointDescription, Threads
from softsim_core.scene.file_keys import beside, is_absent, is_beside, keys_of
from softsim_core.scene.material import DEFAULT_LAW, MaterialDescription, law_parameters
from softsim_core.scene.robot import RobotDescription, need_namespace
from softsim_core.scene.sensor_keys import KIND, sensor_structure
from softsim_core.scene.yaml_source import KeyPath, SourcedMapping, key_path, relative_to_file
from softsim_core.sensing.description import SimulatedSensorDescription
from softsim_core.values import FieldError, MeshFile, Vector
from softsim_core.wrong_names import known_names, one_of

Hook = Callable[[Any, Any], Any]
T = typing.TypeVar("T")


class _RefusedError(Exception):
    """A value that does not fit its key; `below` is the rest of the key path."""

    def __init__(self, problem: str, below: KeyPath = ()) -> None:
        self.problem, self.below = problem, below
        super().__init__(problem)


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
        converter = _converter(find_files)
    except ImportError as error:
        problem = "loading scenes needs cattrs >= 23.2: pip install cattrs (or apt install python3-cattr)"
        raise ConfigError(file, "", problem) from error
    try:
        description: T = converter.structure(data, cls)
        check(description)
    except Exception as error:
        path, problem = _first_problem(error)
        where = key_path(path if at is None else (at, *path))
        raise ConfigError(_file_of(data, path) or file, where, problem) from None
    return description


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
    if isinstance(error, _RefusedError):
        return (*path, *error.below), error.problem
    if isinstance(error, FieldError):
        return (*path, error.field), f"must be {error.allowed}, not {error.value}"
    if isinstance(error, KeyError) and error.args == (last,):
        return tuple(path), "is missing; it has no default"
    if isinstance(error, SceneError):
        return tuple(path), str(error)
    return tuple(path), f"{type(error).__name__}: {error}"


def _file_of(data: SourcedMapping, path: KeyPath) -> Path | None:
    file, node = data.file, typing.cast(Any, data)
    for step in path:
        if isinstance(node, SourcedMapping) and isinstance(step, str):
            file = node.file_of(step)
            node = node.get(step)
        elif isinstance(node, list) and isinstance(step, int) and step < len(node):
            node = node[step]
        else:
            break
    return file


def _shown(value: Any) -> str:
    if value is None:
        return "empty"
    if isinstance(value, Mapping):
        return "a mapping"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _number(value: Any, _: Any) -> float:
    if isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_):
        try:
            number = float(value)
        except OverflowError:
            number = math.nan
        if not math.isnan(number):
            return number
    raise _RefusedError(f"must be a number, not {_shown(value)}{_number_hint(value)}")


def _number_hint(value: Any) -> str:
    if not isinstance(value, str):
        return ""
    try:
        number = float(value)
    except ValueError:
        return ""
    mantissa, _, exponent = repr(number).partition("e")
    if exponent:  # YAML 1.1 wants a point and a signed exponent
        mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
        exponent = f"e{exponent}" if exponent[0] in "+-" else f"e+{exponent}"
    return f", which YAML reads as text; write {mantissa}{exponent}"


def _integer(value: Any, _: Any) -> int:
    if isinstance(value, numbers.Integral) and not isinstance(value, bool | np.bool_):
        return int(value)
    raise _RefusedError(f"must be a whole number, not {_shown(value)}")


def _boolean(value: Any, _: Any) -> bool:
    if isinstance(value, bool):
        return value
    raise _RefusedError(f"must be true or false, not {_shown(value)}")


def _text(value: Any, _: Any) -> str:
    if isinstance(value, str):
        return value
    raise _RefusedError(f"must be text, not {_shown(value)}" + ("" if value is None else "; quote it"))


def _path(value: Any, _: Any) -> Path:
    if isinstance(value, str | Path) and str(value):
        return Path(value)
    raise _RefusedError(f"must be a file path, not {_shown(value)}")


def _instance(value: Any, cls: type) -> Any:
    if isinstance(value, cls):
        return value
    raise _RefusedError(f"comes from Python scenes only, not {_shown(value)}")


def _material(value: Any, _: Any) -> MaterialDescription:
    """A material from the keys of its law, or from the name of a preset and what differs from it."""
    if isinstance(value, str):
        value = {"preset": value}
    if not isinstance(value, Mapping):
        raise _RefusedError(f"must be the name of a preset or a mapping of parameters, not {_shown(value)}")
    law, preset = value.get("law"), value.get("preset")
    if preset is not None:
        law = _preset_law(preset, law)
    try:
        parameters = law_parameters(law)
    except FieldError as error:
        raise _RefusedError(f"must be {error.allowed}, not {_shown(law)}", ("law",)) from None
    except SceneError as error:
        raise _RefusedError(str(error), ("law",)) from None
    known = ["law", "preset", "prony", *(each.name for each in parameters)]
    for key in value:
        if key not in known and (laws := [each for each in material_names() if key in material(each).names]):
            problem = f"is no parameter of the law {law or DEFAULT_LAW}, but of {listing(laws)}; set `law`"
            raise _RefusedError(problem, (str(key),))
    _refuse_unknown(value, known)
    values = {}
    for parameter in parameters:
        name = parameter.name
        if name not in value:
            if parameter.default is None and preset is None:
                raise _RefusedError("is missing; it has no default", (name,))
            continue
        try:
            values[name] = _number(value[name], float)
        except _RefusedError as error:
            raise _RefusedError(error.problem, (name,)) from None
    return MaterialDescription(law=law, preset=preset, prony=_prony(value.get("prony", ())), **values)


def _prony(value: Any) -> tuple[tuple[float, float], ...]:
    """Shares and times of Prony terms."""
    if not isinstance(value, list | tuple):
        raise _RefusedError(f"must be a list of terms with share and time, not {_shown(value)}", ("prony",))
    terms = []
    for i, term in enumerate(value):
        where = ("prony", i)
        if not isinstance(term, Mapping) or set(term) != {"share", "time"}:
            raise _RefusedError(f"must have share and time and nothing else, not {_shown(term)}", where)
        numbers = {}
        for name in ("share", "time"):
            try:
                numbers[name] = _number(term[name], float)
            except _RefusedError as error:
                raise _RefusedError(error.problem, (*where, name)) from None
        terms.append((numbers["share"], numbers["time"]))
    return tuple(terms)


def _preset_law(preset: Any, law: Any) -> str:
    """The law of a preset's constants."""
    if not isinstance(preset, str):
        raise _RefusedError(f"must be the name of a material, not {_shown(preset)}", ("preset",))
    if law is not None and not isinstance(law, str):
        raise _RefusedError(f"must be the name of a material law, not {_shown(law)}", ("law",))
    try:
        elastomer(preset)
    except SceneError as error:
        raise _RefusedError(str(error)) from None
    try:
        elastomer(preset).fit(law or DEFAULT_FIT)
    except SceneError as error:
        raise _RefusedError(str(error), ("law",)) from None
    return law or DEFAULT_FIT


def _one_of(literal: Any) -> Hook:
    allowed = typing.get_args(literal)

    def structure(value: Any, _: Any) -> Any:
        for each in allowed:
            if type(value) is type(each) and value == each:
                return each
        raise _RefusedError(f"must be {one_of(value, allowed)}, not {_shown(value)}")

    return structure


@functools.lru_cache(maxsize=2)
def _converter(find_files: bool) -> Any:
    cattrs = importlib.import_module("cattrs")
    gen = importlib.import_module("cattrs.gen")
    converter = cattrs.Converter(detailed_validation=True)

    def collected(pairs: list[tuple[str | int, Any, Any]], owner: Any) -> list[Any]:
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
                raise _RefusedError(f"must be {kind}, not {_shown(value)}")
            items = [args[0]] * len(value) if length is None else args
            return tuple(
                collected([(i, v, t) for i, (v, t) in enumerate(zip(value, items, strict=True))], owner)
            )

        return structure

    def dict_hook(owner: Any) -> Hook:
        item_type = typing.get_args(owner)[1]

        def structure(value: Any, _: Any) -> dict[str, Any]:
            if not isinstance(value, Mapping):
                raise _RefusedError(f"must be a mapping of `name: value`, not {_shown(value)}")
            items = collected([(key, item, item_type) for key, item in value.items()], owner)
            return dict(zip(value, items, strict=True))

        return structure

    def dataclass_hook(cls: Any) -> Hook:
        known, inner = keys_of(cls), beside(cls)
        omitted = {each.name: gen.override(omit=True) for each in fields(cls) if is_absent(each)}
        build = gen.make_dict_structure_fn(cls, converter, **omitted)

        def structure(value: Any, _: Any) -> Any:
            if not isinstance(value, Mapping):
                raise _RefusedError(
                    f"must be a mapping with keys among {listing(known)}, not {_shown(value)}"
                )
            _refuse_unknown(value, list(known))
            given = dict(value)
            for name, part in inner.items():
                given[name] = {key: given.pop(key) for key in keys_of(part) if key in given}
            built = build(given, cls)
            if not find_files:
                return built
            if cls is MeshFile:
                return replace(built, file=_located(built.file, "file", value, "mesh file"))
            if issubclass(cls, ActuatorDescription):
                paths = [each.name for each in fields(cls) if isinstance(getattr(built, each.name), Path)]
                what = {name: f"file of {cls.kind} {name}" for name in paths}
                located = {name: _located(getattr(built, name), name, value, what[name]) for name in paths}
                return replace(built, **located)
            return built

        return structure

    def joint_hook(cls: Any) -> Hook:
        """A joint; the description of its actuator stands under the key named after its kind."""
        plain = dataclass_hook(cls)

        def structure(value: Any, _: Any) -> Any:
            described = described_kinds()
            if not isinstance(value, Mapping):
                return plain(value, cls)
            keys = [*(each.name for each in fields(cls) if each.name != "actuator"), *described]
            _refuse_unknown(value, keys)
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

    for cls, hook in ((float, _number), (int, _integer), (bool, _boolean), (str, _text), (Path, _path)):
        converter.register_structure_hook(cls, hook)
    converter.register_structure_hook_factory(is_dataclass, dataclass_hook)
    converter.register_structure_hook_factory(lambda cls: cls is JointDescription, joint_hook)
    converter.register_structure_hook_func(
        lambda cls: cls is SimulatedSensorDescription, sensor_structure(converter.structure)
    )
    converter.register_structure_hook_func(
        lambda t: _members(t) == {ActuatorDescription, type(None)}, lambda value, _: value
    )
    converter.register_structure_hook(TetMesh, _instance)
    converter.register_structure_hook(MaterialDescription, _material)
    for origin, factory in ((tuple, tuple_hook), (dict, dict_hook), (Literal, _one_of)):
        converter.register_structure_hook_factory(functools.partial(_has_origin, origin), factory)

    def mesh_or_file(value: Any, _: Any) -> Any:
        return value if value is None or isinstance(value, TetMesh) else converter.structure(value, MeshFile)

    def points_or_file(value: Any, _: Any) -> Any:
        return converter.structure(value, Path if isinstance(value, str | Path) else tuple[Vector, ...])

    def servo(value: Any, _: Any) -> Any:
        """A servo with an id is on a bus."""
        on_bus = isinstance(value, Mapping) and "id" in value
        return converter.structure(value, BusServo if on_bus else ServoCalibration)

    converter.register_structure_hook_func(lambda t: t == Threads, _threads)
    converter.register_structure_hook_func(lambda t: _members(t) == {ServoCalibration, BusServo}, servo)
    converter.register_structure_hook_func(
        lambda t: _members(t) == {MeshFile, TetMesh, type(None)}, mesh_or_file
    )
    converter.register_structure_hook_func(
        lambda t: _members(t) == {tuple[Vector, ...], Path}, points_or_file
    )
    return converter


def _threads(value: Any, _: Any) -> Any:
    if value != "auto" and (isinstance(value, bool) or not isinstance(value, int)):
        raise _RefusedError(f"must be auto or a whole number, not {value!r}")
    return value


def _refuse_unknown(value: Mapping[Any, Any], known: list[str]) -> None:
    """Refuse a mapping with a key that is not known."""
    for key in value:
        if key not in known:
            allowed = known_names(key, known, "known keys:", whole=True)
            raise _RefusedError(f"unknown key; {allowed}", (str(key),))


def _has_origin(origin: Any, annotation: Any) -> bool:
    return typing.get_origin(annotation) is origin


def _members(union: Any) -> set[Any]:
    return (
        set(typing.get_args(union)) if typing.get_origin(union) in (typing.Union, types.UnionType) else set()
    )


def _noun(item_type: Any) -> str:
    return "numbers" if item_type in (float, int) else "items"


def _located(path: Path, key: str, data: Mapping[str, Any], what: str) -> Path:
    """Absolute path of an existing file that `key` of a mapping names."""
    origin = data.file_of(key) if isinstance(data, SourcedMapping) else None
    file = relative_to_file(path, origin)
    if not file.is_file():
        note = "" if path.is_absolute() else f" ({path} is relative to {origin or 'the working directory'})"
        raise _RefusedError(f"no such {what} {file}{note}", (key,))
    return file
