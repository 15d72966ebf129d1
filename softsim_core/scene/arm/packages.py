"""Folders of ROS packages that robot files name, with and without a ROS installation."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from softsim_core.errors import listing

MANIFEST: Final = "package.xml"
MOST_MANIFEST_BYTES: Final = 1_000_000
MOST_ABOVE: Final = 6
"""Folders above a file whose children are searched: of WORKSPACE/src/REPOSITORY/PACKAGE/urdf all five."""
MOST_BELOW: Final = 3
"""Depth to which the children of a folder are searched."""
MOST_FOLDERS: Final = 5000
"""Folders that one search visits at most."""
AMENT, CATKIN = "AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"
_IGNORED: Final = ("COLCON_IGNORE", "AMENT_IGNORE", "CATKIN_IGNORE")


def package_folders(
    package: str, file: Path, allowed: Callable[[Path], bool] = lambda folder: True
) -> Iterator[Path]:
    """Search a ROS package above a file, beside the folders above it, and where the environment says.

    A folder is the package if its `package.xml` says so; above the file and below AMENT_PREFIX_PATH also if
    it has the name. Children of / and of the home folder are not searched, nor those of a folder that other
    users may write, such as /tmp.

    Args:
        package: Its name.
        file: The file that names it.
        allowed: Whether a folder beside those above the file may be taken.

    Yields:
        Folders that exist, the nearest first.
    """
    above = file.resolve().parents
    yield from (folder for folder in above if folder.name == package or _name_of(folder) == package)
    yield from (folder for folder in _below(package, _searched(file)) if allowed(folder))
    shares = (entry / "share" / package for entry in _entries(AMENT))
    yield from (folder for folder in shares if folder.is_dir())
    yield from _below(package, _entries(CATKIN))


def not_found(package: str, file: Path) -> str:
    """Return the message that a package is in none of `package_folders`, with the places searched."""
    below = listing(f"{folder}" for folder in _searched(file)[-1:])
    entries = (f"{name} ({listing(_entries(name))})" for name in (AMENT, CATKIN))
    return (
        f"package {package} is in no folder of that name and no folder with its package.xml above {file}, "
        f"up to {MOST_BELOW} folders below {below}, and in {listing(entries)}; put it beside the file's own "
        f"package, or name its folder in {CATKIN}"
    )


def _entries(variable: str) -> list[Path]:
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def _searched(file: Path) -> list[Path]:
    """The folders above a file whose children are searched."""
    return [folder for folder in file.resolve().parents[:MOST_ABOVE] if _is_searchable(folder)]


def _is_searchable(folder: Path) -> bool:
    return folder not in (Path(folder.anchor), Path.home()) and _is_trusted(folder)


def _is_trusted(folder: Path) -> bool:
    """Whether only this user and root may put something into a folder."""
    status = folder.stat()
    own = not hasattr(os, "getuid") or status.st_uid in (0, os.getuid())
    return own and not status.st_mode & stat.S_IWOTH


def _below(package: str, roots: Iterable[Path]) -> Iterator[Path]:
    """The folders of that package among some folders and what is below them."""
    visited: set[Path] = set()
    for root in roots:
        for folder in _packages(root, MOST_BELOW, visited):
            if _name_of(folder) == package:
                yield folder


def _packages(folder: Path, depth: int, visited: set[Path]) -> Iterator[Path]:
    """The folders with a manifest: the folder itself, or folders below it. No package lies in another one."""
    if folder in visited or len(visited) >= MOST_FOLDERS:
        return
    visited.add(folder)
    if (folder / MANIFEST).is_file():
        yield folder
    elif depth > 0 and not any((folder / name).exists() for name in _IGNORED):
        for child in _children(folder):
            yield from _packages(child, depth - 1, visited)


def _children(folder: Path) -> list[Path]:
    """The trusted folders in a folder by name, without hidden ones and links; none if it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            names = [each.name for each in entries if each.is_dir(follow_symlinks=False)]
        shown = (folder / name for name in sorted(names) if not name.startswith("."))
        return [child for child in shown if _is_trusted(child)]
    except OSError:
        return []


def _name_of(folder: Path) -> str:
    """Return the name in the manifest of a folder; "" where there is no manifest that can be read."""
    try:
        with (folder / MANIFEST).open("rb") as stream:
            text = stream.read(MOST_MANIFEST_BYTES + 1)
        if len(text) > MOST_MANIFEST_BYTES:
            return ""
        return (ElementTree.fromstring(text).findtext("name") or "").strip()
    except (OSError, ElementTree.ParseError, ValueError, LookupError):
        return ""
