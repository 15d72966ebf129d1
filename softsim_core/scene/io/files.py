"""Files of robots and scenes: search paths, values that name files, and generated text."""

from __future__ import annotations

import importlib
import os
import sys
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from softsim_core.base import ConfigError, SceneName, known_names, listing, on_one_line
from softsim_core.physics.actuation import ActuatorDescription, described_kinds
from softsim_core.physics.sensing import SimulatedSensorDescription, sensor_kind, sensor_kinds
from softsim_core.scene import RobotDescription, TendonArmDescription, hints_of, is_absent, is_beside
from softsim_core.scene.arm import ArmDescription

Kind: TypeAlias = Literal["robots", "scenes"]
KINDS: tuple[Kind, ...] = ("robots", "scenes")
SUFFIXES = (".yaml", ".yml", ".py")
"""File types of scenes, in order of preference."""


def config_roots() -> list[Path]:
    """Return existing `configs` folders, best first: $SOFTSIM_CONFIG_PATH, then `installed_roots`."""
    own = [root for root in _paths_of("SOFTSIM_CONFIG_PATH") if root.is_dir()]
    return list(dict.fromkeys([*own, *installed_roots()]))


def installed_roots() -> list[Path]:
    """Return existing `configs` folders of the installation, best first.

    `configs/` beside the package (a checkout, also through symlinked packages);
    `share/softsim_bringup/configs` under every prefix of $AMENT_PREFIX_PATH;
    `<sys.prefix>/share/softsim/configs`.
    """
    checkout = Path(__file__).resolve().parents[3] / "configs"
    candidates = [checkout] if (checkout / "robots").is_dir() else []
    prefixes = _paths_of("AMENT_PREFIX_PATH")
    candidates += [prefix / "share" / "softsim_bringup" / "configs" for prefix in prefixes]
    candidates.append(Path(sys.prefix) / "share" / "softsim" / "configs")
    return list(dict.fromkeys(root for root in candidates if root.is_dir()))


def config_file(relative: str | os.PathLike[str]) -> Path:
    """Return a file below one of the config roots, such as `meshes/tripod_low.vtk`.

    Raises:
        ConfigError: no root contains it.
    """
    roots = config_roots()
    for root in roots:
        if (root / relative).is_file():
            return root / relative
    problem = f"no such file; looked in {listing(roots)}; set SOFTSIM_CONFIG_PATH to your configs"
    raise ConfigError(relative, "", problem)


def known_scenes(kind: Kind | None = None) -> dict[str, Path]:
    """Return names and files of the robots and scenes that can be loaded by name, sorted by name.

    Args:
        kind: Only robots or only scenes; None lists both (a robot hides a scene of the same name).
    """
    files_by_name: dict[str, Path] = {}
    for each in KINDS if kind is None else (kind,):
        for root in config_roots():
            folder = root / each
            for suffix in SUFFIXES:
                for path in folder.rglob(f"*{suffix}"):
                    if not path.name.startswith("_"):
                        files_by_name.setdefault(path.relative_to(folder).with_suffix("").as_posix(), path)
    return dict(sorted(files_by_name.items()))


def find_config(name_or_path: str | os.PathLike[str], kind: Kind | None = None) -> Path:
    """Return the file of a robot or scene.

    Args:
        name_or_path: A path to a .yaml, .yml or .py file, or a name ("tripod", "parts/servo").
        kind: Kind of file to which a name refers; None: robots, then scenes.

    Returns:
        Absolute path of an existing file.

    Raises:
        ConfigError: nothing found, or a path that is not a scene file; lists the known names.
    """
    text = os.fspath(name_or_path)
    try:
        path = Path(text).expanduser()
        is_file = path.is_file()
    except (OSError, RuntimeError, ValueError) as error:  # too long, no such user, a null byte
        raise ConfigError(f"{text:.60}", "", f"is neither a name nor a path ({error!s:.100})") from error
    if path.suffix in SUFFIXES and is_file:
        return path.absolute()
    if is_file and (path.is_absolute() or path.suffix or len(path.parts) > 1):
        raise ConfigError(text, "", f"a scene file ends in {listing(SUFFIXES)}, not in {path.suffix!r}")
    files_by_name = known_scenes(kind)
    name = path.with_suffix("").as_posix() if path.suffix in SUFFIXES else text
    if name in files_by_name and (path.suffix in ("", files_by_name[name].suffix) or name == text):
        return files_by_name[name].absolute()
    what = "robot" if kind == "robots" else "scene" if kind == "scenes" else "robot or scene"
    near = known_names(name, files_by_name, lists_all="softsim scenes")
    raise ConfigError(text, "", f"no such file, and no {what} of that name; {near}")


def _paths_of(variable: str) -> list[Path]:
    return [Path(entry).expanduser() for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


KEYS_OF_FILES: dict[str, Any] = {
    "extends": SceneName,
    "arm": ArmDescription,
    "tendon_arm": TendonArmDescription,
}
"""Top-level keys of a scene's file that are no field of its description, with their types."""


def file_names(data: Any, kind: Any = RobotDescription) -> Iterator[str]:
    """Yield the texts that name files in the data of a description.

    Args:
        data: Plain data, whole or a part; data that do not fit the type are ignored here.
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
    """Return every file that a description names: all paths in it, at any depth."""
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
    """Yield the keys of a description in a file, each with its type, or with several possible types."""
    if kind is RobotDescription:
        yield from KEYS_OF_FILES.items()
    if kind is SimulatedSensorDescription:
        for name in sensor_kinds():
            yield from _keys(sensor_kind(name).description)
    hints = hints_of(kind)
    for each in fields(kind):
        if is_absent(each):
            continue
        hint = hints[each.name]
        if is_beside(each):
            yield from _keys(hint)
        elif ActuatorDescription in typing.get_args(hint):
            yield from described_kinds().items()
        else:
            yield each.name, hint


LONGEST: Final = 500
"""Largest number of characters in a comment line."""


def comment(*lines: str) -> str:
    """Return the lines of a comment in YAML, Python or CSV files; the texts may contain anything."""
    return "".join(f"# {on_one_line(line)[:LONGEST]}\n" for line in lines)


def scalar(text: str) -> str:
    """Return text quoted for YAML as a value or a key on one line."""
    yaml = importlib.import_module("yaml")
    style = None if text.isprintable() else '"'
    dumped: str = yaml.safe_dump([text], default_flow_style=True, default_style=style, width=float("inf"))
    return dumped.strip()[1:-1]
