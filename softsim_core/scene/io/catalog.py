"""Catalogue of scenes that others may request from a running process: known names only, with code rules."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from softsim_core.base import ConfigError, known_names, shorten
from softsim_core.scene import RobotDescription
from softsim_core.scene.io.files import SUFFIXES, known_scenes
from softsim_core.scene.io.loaders import load_python, load_yaml
from softsim_core.scene.io.programs import ANY_PROGRAM, ProgramRule, limited_to

MOST_FILES: Final = 200
"""Largest number of known scenes per folder."""

MOST_ENTRIES: Final = 20000
"""Largest number of entries read per folder."""

HEAD_BYTES: Final = 65536
_MARKS: Final = {
    True: re.compile(rb"^def create_scene\(", re.MULTILINE),
    False: re.compile(rb"^(arm|bodies|rigid_bodies|extends)\s*:", re.MULTILINE),
}
"""Text that marks a scene in an allowed folder, for Python files and for YAML files."""


class SceneCatalog:
    """The scenes that can be requested over ROS, by a bag or from a page: names, never paths.

    Known scenes are those of the config roots, those named by the start command, and those in a folder whose
    code it allowed; other files in the folder of a named scene are ignored. A Python scene is a program, and
    so is a xacro file that a scene names. Programs run only if the scene belongs to the installation, was
    named by the start command, or lies in a folder whose code is allowed.

    Args:
        named: Names and files of the scenes that the start command named.
        code_folders: Folders whose Python scenes may run, including everything below.
        start_folder: Folder in which the process was started; None: the working directory.

    Attributes:
        start_folder: That folder, into which copies are written; None: it was removed.
    """

    def __init__(
        self,
        named: Mapping[str, Path] | None = None,
        code_folders: Iterable[str | os.PathLike[str]] = (),
        start_folder: Path | None = None,
    ) -> None:
        self._named = {name: file.absolute() for name, file in (named or {}).items()}
        self._code_folders = tuple(code_folder(each) for each in code_folders)
        self.start_folder: Path | None
        try:
            self.start_folder = Path.cwd() if start_folder is None else start_folder.absolute()
        except OSError:  # the working directory was removed
            self.start_folder = None

    def scenes(self) -> dict[str, Path]:
        """Return names and files of every known scene, sorted by name."""
        files_by_name = known_scenes()
        for name, file in self._named.items():
            files_by_name.setdefault(name, file)
        for folder in self._code_folders:
            _add(files_by_name, folder)
        return dict(sorted(files_by_name.items()))

    def names(self) -> tuple[str, ...]:
        """Return the names of the scenes that can be loaded."""
        return tuple(name for name, file in self.scenes().items() if self.rule_of(file).allows(file))

    def find(self, name: str) -> Path:
        """Return the file of a known scene.

        Raises:
            ConfigError: no scene of that name is known, or its code may not run.
        """
        files_by_name = self.scenes()
        if name not in files_by_name:
            near = known_names(name, map(shorten, files_by_name), "known are")
            problem = f"no known scene has this name; {near}; another file must be named when the simulator "
            raise ConfigError(shorten(name), "", f"{problem}is started")
        if not self.rule_of(files_by_name[name]).allows(files_by_name[name]):
            problem = (
                "is a Python scene, which runs code; name it when the simulator is started, or allow the "
                "code of its folder there (--allow-code DIR, parameter allow_code)"
            )
            raise ConfigError(name, "", problem)
        return files_by_name[name].absolute()

    def load(self, name: str, overrides: Mapping[str, Any] | None = None) -> RobotDescription:
        """Load a known scene, with overrides as `load_scene` takes them.

        Raises:
            ConfigError: as `find`, and any problem in the file.
        """
        file = self.find(name)
        with limited_to(self.rule_of(file)):
            return load_python(file, overrides) if file.suffix == ".py" else load_yaml(file, overrides)

    def rule_of(self, file: Path) -> ProgramRule:
        """Return which programs run with a known scene: all that it names, if its own file is trusted."""
        rule = ProgramRule(self._code_folders)
        return ANY_PROGRAM if file.absolute() in self._named.values() or rule.trusts(file) else rule


def folders_of(text: str) -> list[str]:
    """Split a list of folders that is written like $PATH; empty text is an empty list."""
    return [each for each in text.split(os.pathsep) if each]


def code_folder(path: str | os.PathLike[str]) -> Path:
    """Return a folder whose code is allowed.

    Raises:
        ConfigError: there is none.
    """
    try:
        folder = Path(path).expanduser().absolute()
        if folder.is_dir():
            return folder
    except (OSError, RuntimeError, ValueError):
        pass
    raise ConfigError(shorten(os.fspath(path)), "", "is no folder; allow the code of an existing one")


def _add(files_by_name: dict[str, Path], folder: Path) -> None:
    """Add the scenes in a folder and below if their names are free."""
    try:
        entries = itertools.islice(folder.rglob("*"), MOST_ENTRIES)
        found = sorted(each for each in entries if each.suffix in SUFFIXES and each.name[0] != "_")
    except OSError:
        return
    for file in found[:MOST_FILES]:
        name = file.relative_to(folder).with_suffix("").as_posix()
        if name not in files_by_name and _is_scene(file):
            files_by_name[name] = file


def _is_scene(file: Path) -> bool:
    """Return whether the beginning of an ordinary file looks like a scene."""
    try:
        if not file.is_file():
            return False
        with file.open("rb") as stream:
            return _MARKS[file.suffix == ".py"].search(stream.read(HEAD_BYTES)) is not None
    except OSError:
        return False
