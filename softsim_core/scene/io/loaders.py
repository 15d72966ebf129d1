"""Scenes and robots from files: YAML files, and Python files with a function `create_scene(scene)`."""

from __future__ import annotations

import functools
import importlib
import linecache
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple, TypeAlias

from softsim_core import MOVED
from softsim_core.base import ConfigError, SceneError, SoftSimError
from softsim_core.scene import Controller, RobotDescription, Scene, TendonArmDescription
from softsim_core.scene.arm import ArmDescription, ToolDescription, arm_with_tools
from softsim_core.scene.io.files import Kind, find_config
from softsim_core.scene.io.portable import mark_source, unstructure_scene
from softsim_core.scene.io.programs import ANY_PROGRAM, allowed_program, limited_to
from softsim_core.scene.io.structure import structure_description, structure_scene
from softsim_core.scene.io.yaml_source import (
    SourcedMapping,
    merge,
    parse_yaml,
    plain_copy,
    read_extended,
    relative_to_file,
    resolve_extends,
)


def load_scene(
    name_or_path: str | PathLike[str], overrides: Mapping[str, Any] | None = None, kind: Kind | None = None
) -> RobotDescription:
    """A robot or scene, from a YAML file or from a Python file with `create_scene(scene)`.

    Args:
        name_or_path: A name ("tripod", "tripod_step_3", "parts/servo") or a path.
        overrides: Values laid over the file's before validation, such as {"solver": {"backend": "scipy"}}:
            mappings merge, lists of named items merge by `name`, everything else is replaced.
        kind: Look a name up among "robots" or "scenes" only.

    Returns:
        Validated description; mesh paths are absolute, `source` is the file.

    Raises:
        ConfigError: nothing of that name, or any problem in the file, in one sentence.
    """
    file = find_config(name_or_path, kind)
    return load_python(file, overrides) if file.suffix == ".py" else load_yaml(file, overrides)


ORIGIN = Path("overrides")
"""Name in messages in place of a file."""


class Item(NamedTuple):
    """A step from a list to its item of this name."""

    name: str


Steps: TypeAlias = "tuple[str | Item, ...]"
"""Steps from the scene to one of its parts: ("joints", Item("servo_0"), "base")."""


def override_at(steps: Sequence[str | Item], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return overrides of one part's fields, as `load_scene` takes them."""
    data: Any = dict(values)
    for step in reversed(steps):
        data = [{"name": step.name, **data}] if isinstance(step, Item) else {step: data}
    return dict(data)


def read_overrides(text: str) -> dict[str, Any]:
    """Read overrides from YAML text; empty text means none.

    Raises:
        ConfigError: no YAML, or no mapping.
    """
    return parse_yaml(text, ORIGIN) if text.strip() else {}


def write_overrides(overrides: Mapping[str, Any]) -> str:
    """Return overrides as YAML text for `read_overrides` or a scene's file; "" for none."""
    if not overrides:
        return ""
    yaml = importlib.import_module("yaml")
    return str(yaml.safe_dump(plain_copy(overrides), sort_keys=False, default_flow_style=None, width=100))


def laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return `above` merged over `below` by the rules of scenes: mappings and lists of named items merge."""
    merged: dict[str, Any] = plain_copy(merge(mark_source(below, ORIGIN), mark_source(above, ORIGIN)))
    return merged


def load_yaml(
    file: str | Path, overrides: Mapping[str, Any] | None = None, text: str | None = None
) -> RobotDescription:
    """Load the robot or scene of a YAML file.

    A key `arm` stands for the robot of a URDF file with tools of the suite on its links. The rest of the file
    is merged over it; see scene.arm.

    Args:
        file: The file. Its key `extends` may name another one over which this one is merged: mappings merge,
            lists of items with a `name` merge by that name, other values replace. Mesh files are relative to
            the file that names them.
        overrides: Merged over the result by the same rules, before validation.
        text: Used in place of the file's content, which is then not read; None: the file is read.

    Returns:
        Validated description with absolute mesh paths; `source` is the file.

    Raises:
        ConfigError: any problem, as one message: file, key path, value, what is allowed.
    """
    path = Path(file).expanduser().absolute()
    data = read_extended(path) if text is None else resolve_extends(parse_yaml(text, path), path)
    return _build_scene(path, data, overrides)


def _build_scene(
    path: Path, data: SourcedMapping, overrides: Mapping[str, Any] | None = None, below: tuple[Path, ...] = ()
) -> RobotDescription:
    """Build the scene of a file with content `data`; `below` are the files of arms that carry it."""
    if overrides:
        data = merge(data, mark_source(overrides, Path(f"overrides of {path.name}")))
    if "arm" in data:
        data = _over_arm(data, path, (*below, path))
    if "tendon_arm" in data:
        data = _over_tendon_arm(data, path)
    return replace(structure_scene(data, path), source=path)


def _over_arm(data: SourcedMapping, path: Path, chain: tuple[Path, ...]) -> SourcedMapping:
    """Return the data of a file merged over the arm that it describes."""
    file, place, described = data.file_of("arm") or path, data.places.get("arm"), data.pop("arm")
    if not isinstance(described, SourcedMapping):
        raise ConfigError(file, "arm", "must be a mapping of urdf and others", place)
    arm = structure_description(described, ArmDescription, file, at="arm", find_files=False)
    arm = replace(arm, urdf=relative_to_file(arm.urdf, file))

    def tool(hung: ToolDescription) -> RobotDescription:
        named = relative_to_file(hung.robot, file)
        found = find_config(named if named.is_file() else hung.robot)
        if found.suffix == ".py" or found.resolve() in {each.resolve() for each in chain}:
            why = "runs code; name a YAML file" if found.suffix == ".py" else "carries itself"
            raise ConfigError(file, "arm.tools", f"{hung.robot} {why}")
        return _build_scene(found, read_extended(found), None, chain)

    try:
        robot = arm_with_tools(str(data.get("name", path.stem)), arm, tool)
    except SceneError as error:
        raise ConfigError(file, "arm", str(error).removeprefix("arm: ")) from error
    return merge(unstructure_scene(robot), data)


def _over_tendon_arm(data: SourcedMapping, path: Path) -> SourcedMapping:
    """Return the data of a file merged over the tendon arm that it describes."""
    key = "tendon_arm"
    file, place, described = data.file_of(key) or path, data.places.get(key), data.pop(key)
    if not isinstance(described, SourcedMapping):
        raise ConfigError(file, key, "must be a mapping of segments, backbone and others", place)
    arm = structure_description(described, TendonArmDescription, file, at=key)
    scene = Scene(name=str(data.get("name", path.stem)))
    try:
        scene.add(arm.part())
        return merge(unstructure_scene(scene.describe()), data)
    except SceneError as error:
        raise ConfigError(file, key, str(error).removeprefix(f"tendon arm {arm.name}: "), place) from error


MODULES: Final = {
    "softsim_core.actuation.limits": "softsim_core.physics.mechanics.limits",
    "softsim_core.dynamics.bases": "softsim_core.simulation.drive",
    "softsim_core.dynamics.drive": "softsim_core.simulation.drive",
    "softsim_core.dynamics.scene_state": "softsim_core.simulation.scene_state",
    "softsim_core.dynamics.simulation": "softsim_core.simulation",
    "softsim_core.dynamics.warmup": "softsim_core.simulation.warmup",
    "softsim_core.mesh.finger_mesh": "softsim_core.robots.finger_mesh",
    "softsim_core.mesh.maze_mesh": "softsim_core.robots.maze_mesh",
    "softsim_core.mesh.tripod_mesh": "softsim_core.robots.tripod_mesh",
    "softsim_core.scene.gripper_parts": "softsim_core.robots.gripper_parts",
    "softsim_core.scene.parts": "softsim_core.robots.parts",
    "softsim_core.scene.values": "softsim_core.base.values",
}
"""Former names of modules that cannot be imported any more, with their present names."""


def new_place(error: ImportError) -> str | None:
    """Return a message for a failed import of something that has moved; None: nothing has moved."""
    match = re.search(r"cannot import name '(\w+)' from '([\w.]+)'", str(error))
    name, module = match.groups() if match else ("", error.name or "")
    full = f"{module}.{name}" if name else module
    if full in MODULES:
        return f"the module {full} has moved; import {MODULES[full]} in its place"
    if folder := next((old for old in MOVED if full.startswith(f"{old}.")), None):
        return f"the module {full} has moved into another one below {MOVED[folder]}; see docs/library.md"
    package = module.partition(".")[0]
    if name and package == __name__.partition(".")[0] and name in import_module(package).__all__:
        return f"{name} is not in {module} any more; write `from {package} import {name}`"
    return None


def load_python(
    file: str | Path, overrides: Mapping[str, Any] | None = None, arguments: Mapping[str, Any] | None = None
) -> RobotDescription:
    """Load the scene that a Python file builds.

    Args:
        file: A file that defines `create_scene(scene)`; it gets a `Scene` to add to. It may import modules
            in its own folder. Relative mesh paths are relative to the file.
        overrides: Merged over the result by the rules of `load_yaml`, before validation.
        arguments: Passed to `create_scene` by name; its further parameters need defaults.

    Returns:
        Validated description with absolute mesh paths; `source` is the file.

    Raises:
        ConfigError: an error in the file (with its line), or an invalid scene. KeyboardInterrupt passes.
    """
    path = Path(file).expanduser().absolute()
    scene = Scene(name=path.stem)
    program = allowed_program(path)
    with _beside(path), _errors_of(path), limited_to(ANY_PROGRAM):  # it runs, so it may do all
        try:
            code = program.read_bytes()
        except OSError as error:
            raise ConfigError(path, "", f"cannot be read ({error.strerror or error})") from error
        linecache.checkcache(str(path))  # tracebacks show the file as it is now
        module = ModuleType(f"softsim_scene_{path.stem}")
        module.__file__ = str(path)
        sys.modules[module.__name__] = module  # dataclasses and pickle look their module up
        exec(compile(code, str(path), "exec"), module.__dict__)  # a scene file is a program
        create_scene = module.__dict__.get("create_scene")
        if not callable(create_scene):
            raise ConfigError(path, "", "must define a function create_scene(scene)")
        create_scene(scene, **(arguments or {}))
    try:
        draft = scene.describe()
        data = unstructure_scene(draft, path)
    except SceneError as error:
        raise ConfigError(path, "", str(error)) from error
    except (TypeError, ValueError, AttributeError) as error:
        raise ConfigError(path, "", f"the scene holds a value of a wrong type ({error})") from error
    if overrides:
        data = merge(data, mark_source(overrides, Path(f"overrides of {path.name}")))
    return replace(
        structure_scene(data, path),
        source=path,
        controllers=tuple(_guard_controller(each, path) for each in draft.controllers),
    )


@contextmanager
def _beside(path: Path) -> Iterator[None]:
    """Within the `with` block, let modules beside the file be imported in their present version.

    Python compares whole seconds to detect changes: a module saved twice within one second would not be
    compiled again.
    """
    folder = str(path.parent)
    sys.path.insert(0, folder)
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield
    finally:
        sys.dont_write_bytecode = before
        if folder in sys.path:
            sys.path.remove(folder)


@contextmanager
def _errors_of(path: Path) -> Iterator[None]:
    """Convert any failure inside to one ConfigError that names the last executed line of `path`."""
    try:
        yield
    except ConfigError as error:
        if error.file == str(path):
            raise
        raise ConfigError(path, _line_of(error, path), str(error)) from error
    except SyntaxError as error:
        inside = error.filename in (None, str(path))
        line = f"line {error.lineno}" if inside and error.lineno else _line_of(error, path)
        where = "" if inside else f" in {error.filename}, line {error.lineno}"
        raise ConfigError(path, line, f"Python syntax: {error.msg}{where}") from error
    except (Exception, SystemExit) as error:
        problem = str(error) if isinstance(error, SceneError) else _describe_error(error)
        raise ConfigError(path, _line_of(error, path), problem) from error


def _guard_controller(controller: Controller, path: Path) -> Controller:
    """Wrap a controller so that a foreign error becomes one SceneError with file and line."""

    def guard(hook: Callable[..., None] | None) -> Callable[..., None] | None:
        if hook is None:
            return None

        @functools.wraps(hook)
        def call(*arguments: Any) -> None:
            try:
                hook(*arguments)
            except SoftSimError:
                raise
            except Exception as error:
                where = ": ".join(part for part in (str(path), _line_of(error, path)) if part)
                raise SceneError(f"{where}: controller failed: {_describe_error(error)}") from error

        return call

    return Controller(
        on_begin=guard(controller.on_begin), on_end=guard(controller.on_end), on_key=guard(controller.on_key)
    )


def _describe_error(error: BaseException) -> str:
    """Return a message for an error: the new place of an import that has moved, else the error itself."""
    moved = new_place(error) if isinstance(error, ImportError) else None
    return moved or f"{type(error).__name__}: {str(error) or 'no message'}"


def _line_of(error: BaseException, path: Path) -> str:
    lines = [
        number
        for frame, number in traceback.walk_tb(error.__traceback__)
        if frame.f_code.co_filename == str(path)
    ]
    return f"line {lines[-1]}" if lines else ""
