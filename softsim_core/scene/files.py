"""Where robots and scenes are found: by name or by path, from any working directory."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Literal, TypeAlias

from softsim_core.errors import ConfigError, listing
from softsim_core.wrong_names import known_names

Kind: TypeAlias = Literal["robots", "scenes"]
KINDS: tuple[Kind, ...] = ("robots", "scenes")
SUFFIXES = (".yaml", ".yml", ".py")
"""File types a scene may have, in order of preference."""


def config_roots() -> list[Path]:
    """Existing `configs` folders, best first: the entries of $SOFTSIM_CONFIG_PATH, then `installed_roots`."""
    own = [root for root in _paths_of("SOFTSIM_CONFIG_PATH") if root.is_dir()]
    return list(dict.fromkeys([*own, *installed_roots()]))


def installed_roots() -> list[Path]:
    """Existing `configs` folders that came with the suite, best first.

    `configs/` beside the package (a checkout, also through symlinked packages);
    `share/softsim_bringup/configs` under every prefix of $AMENT_PREFIX_PATH;
    `<sys.prefix>/share/softsim/configs`.
    """
    checkout = Path(__file__).resolve().parents[2] / "configs"
    candidates = [checkout] if (checkout / "robots").is_dir() else []
    candidates += [
        prefix / "share" / "softsim_bringup" / "configs" for prefix in _paths_of("AMENT_PREFIX_PATH")
    ]
    candidates.append(Path(sys.prefix) / "share" / "softsim" / "configs")
    return list(dict.fromkeys(root for root in candidates if root.is_dir()))


def config_file(relative: str | os.PathLike[str]) -> Path:
    """A file below one of the config roots, such as `meshes/tripod_low.vtk`.

    Raises:
        ConfigError: no root holds it.
    """
    roots = config_roots()
    for root in roots:
        if (root / relative).is_file():
            return root / relative
    raise ConfigError(
        relative, "", f"no such file; looked in {listing(roots)}; set SOFTSIM_CONFIG_PATH to your configs"
    )


def known_scenes(kind: Kind | None = None) -> dict[str, Path]:
    """Names and files of the robots and scenes that can be loaded by name, sorted by name.

    Args:
        kind: Only robots or only scenes; None lists both (a robot hides a scene of the same name).
    """
    known: dict[str, Path] = {}
    for each in KINDS if kind is None else (kind,):
        for root in config_roots():
            folder = root / each
            for suffix in SUFFIXES:
                for path in folder.rglob(f"*{suffix}"):
                    if not path.name.startswith("_"):
                        known.setdefault(path.relative_to(folder).with_suffix("").as_posix(), path)
    return dict(sorted(known.items()))


def find_config(name_or_path: str | os.PathLike[str], kind: Kind | None = None) -> Path:
    """The file of a robot or scene.

    Args:
        name_or_path: A path to a .yaml, .yml or .py file, or a name ("tripod", "parts/servo").
        kind: Where a name is looked up; None: robots, then scenes.

    Returns:
        Absolute path of an existing file.

    Raises:
        ConfigError: nothing found, or a path that is not a scene file; names what is known.
    """
    text = os.fspath(name_or_path)
    try:
        path = Path(text).expanduser()
        is_file = path.is_file()
    except (OSError, RuntimeError, ValueError) as error:  # too long, no such user, a zero in it
        raise ConfigError(f"{text:.60}", "", f"is neither a name nor a path ({error!s:.100})") from error
    if path.suffix in SUFFIXES and is_file:
        return path.absolute()
    if is_file and (path.is_absolute() or path.suffix or len(path.parts) > 1):
        raise ConfigError(text, "", f"a scene file ends in {listing(SUFFIXES)}, not in {path.suffix!r}")
    known = known_scenes(kind)
    name = path.with_suffix("").as_posix() if path.suffix in SUFFIXES else text
    if name in known and (path.suffix in ("", known[name].suffix) or name == text):
        return known[name].absolute()
    what = "robot" if kind == "robots" else "scene" if kind == "scenes" else "robot or scene"
    near = known_names(name, known, lists_all="softsim scenes")
    raise ConfigError(text, "", f"no such file, and no {what} of that name; {near}")


def _paths_of(variable: str) -> list[Path]:
    return [Path(entry).expanduser() for entry in os.environ.get(variable, "").split(os.pathsep) if entry]
