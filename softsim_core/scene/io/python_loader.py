"""A scene from a Python file with a function `create_scene(scene)`."""

from __future__ import annotations

import functools
import linecache
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from softsim_core import MOVED
from softsim_core.base.errors import ConfigError, SceneError, SoftSimError
from softsim_core.scene.io.portable import sourced, unstructure_scene
from softsim_core.scene.io.programs import ANY_PROGRAM, allowed_program, limited_to
from softsim_core.scene.io.structure import structure_scene
from softsim_core.scene.io.yaml_source import merge
from softsim_core.scene.robot import Controller, RobotDescription
from softsim_core.scene.scene import Scene

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
"""Modules that cannot be imported by their former names any more, and where they are."""


def new_place(error: ImportError) -> str | None:
    """One sentence for a person whose import failed because something has moved; None: nothing has."""
    wanted = re.search(r"cannot import name '(\w+)' from '([\w.]+)'", str(error))
    name, module = wanted.groups() if wanted else ("", error.name or "")
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
    """The scene that a Python file builds.

    Args:
        file: A file that defines `create_scene(scene)`; it gets a `Scene` to add to. It may import modules
            that lie beside it. Relative mesh paths are relative to the file.
        overrides: Laid over the result by the rules of `load_yaml`, before validation.
        arguments: Passed to `create_scene` by name; its further parameters need defaults.

    Returns:
        Validated description with absolute mesh paths; `source` is the file.

    Raises:
        ConfigError: an error in the file (with its line), or a scene that does not validate. Ctrl-C passes.
    """
    path = Path(file).expanduser().absolute()
    scene = Scene(name=path.stem)
    program = allowed_program(path)
    with _beside(path), _errors_of(path), limited_to(ANY_PROGRAM):  # it runs, so it may do all
        create_scene = _module(path, program).__dict__.get("create_scene")
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
        data = merge(data, sourced(overrides, Path(f"overrides of {path.name}")))
    return replace(
        structure_scene(data, path),
        source=path,
        controllers=tuple(_guarded(each, path) for each in draft.controllers),
    )


def _module(path: Path, program: Path) -> ModuleType:
    """The module of a scene's file, whose code is read from the program that was allowed."""
    try:
        source = program.read_bytes()
    except OSError as error:
        raise ConfigError(path, "", f"cannot be read ({error.strerror or error})") from error
    linecache.checkcache(str(path))  # tracebacks show the file as it is now
    module = ModuleType(f"softsim_scene_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses and pickle look their module up
    exec(compile(source, str(path), "exec"), module.__dict__)  # a scene file is a program
    return module


@contextmanager
def _beside(path: Path) -> Iterator[None]:
    """What lies beside the file can be imported, as it is now.

    Python keeps what it compiled by whole seconds: a module saved twice in one would be taken as it was.
    """
    folder = str(path.parent)
    sys.path.insert(0, folder)
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield
    finally:
        sys.dont_write_bytecode = kept
        if folder in sys.path:
            sys.path.remove(folder)


@contextmanager
def _errors_of(path: Path) -> Iterator[None]:
    """Any failure inside becomes one ConfigError that names the last line of `path` that was running."""
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
    except SceneError as error:
        raise ConfigError(path, _line_of(error, path), str(error)) from error
    except (Exception, SystemExit) as error:
        raise ConfigError(path, _line_of(error, path), _told(error)) from error


def _guarded(controller: Controller, path: Path) -> Controller:
    """The controller; a failure becomes one SceneError with file and line, the suite's errors pass."""

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
                raise SceneError(f"{where}: controller failed: {_told(error)}") from error

        return call

    return Controller(
        on_begin=guard(controller.on_begin), on_end=guard(controller.on_end), on_key=guard(controller.on_key)
    )


def _told(error: BaseException) -> str:
    """What went wrong, for a person: where something that was imported is now, else the error itself."""
    moved = new_place(error) if isinstance(error, ImportError) else None
    return moved or f"{type(error).__name__}: {str(error) or 'no message'}"


def _line_of(error: BaseException, path: Path) -> str:
    lines = [
        number
        for frame, number in traceback.walk_tb(error.__traceback__)
        if frame.f_code.co_filename == str(path)
    ]
    return f"line {lines[-1]}" if lines else ""
