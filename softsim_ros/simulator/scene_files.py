"""The files a scene is made of: loading them anew, and seeing that one of them was saved."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from softsim_core import RobotDescription, load_scene
from softsim_core.editing import Put, SceneDocument
from softsim_core.editing.document import Proposal
from softsim_core.editing.edits import Edit
from softsim_core.errors import ConfigError, SceneError
from softsim_core.scene.catalog import names_up_to
from softsim_core.scene.file_names import file_names, named_files
from softsim_core.scene.overrides import Item, read_overrides
from softsim_core.scene.programs import ANY_PROGRAM, ProgramRule, limited_to
from softsim_core.scene.yaml_loader import load_yaml
from softsim_core.scene.yaml_source import read_yaml, relative_to_file
from softsim_core.values import MeshFile
from softsim_ros.simulator.spawning import Spawnings, exchanged

Stamps = dict[Path, tuple[int, int] | None]


class SceneFiles:
    """The source of a scene: its file, the files it extends or imports, its meshes, what is laid over them.

    Args:
        robot: As loaded; one that came from no file can be neither watched nor loaded anew.
        programs: Which programs run when it is loaded anew, such as the xacro file of its arm.

    Attributes:
        scene: The scene that runs.
        programs: As given.
        overrides: Text of values that are laid over the files when they are loaded, see `read_overrides`.
        spawned: What was put beside it since; it stays when the files are loaded anew.
        text: What stands for the text of its file until the files are loaded anew; None: nothing does.
    """

    def __init__(self, robot: RobotDescription, programs: ProgramRule = ANY_PROGRAM) -> None:
        self.scene, self.overrides, self.programs = robot, "", programs
        self.spawned: Spawnings = ()
        self.text: str | None = None
        self._name, self._source = robot.name, robot.source
        self._files = files_of(robot)
        self._loaded = self._seen = stamps(self._files)
        self._named_files = named_files(robot)

    def load(self) -> RobotDescription:
        """The scene as its files are now.

        Raises:
            SceneError: it came from no file.
            ConfigError: any problem in the files or in the overrides, in one sentence.
        """
        if self._source is None:
            raise SceneError(f"{self._name} came from no file and cannot be loaded anew; restart its program")
        self._loaded = self._seen = stamps(self._files)
        for module in _modules_beside(self._source):
            sys.modules.pop(module, None)
        importlib.invalidate_caches()
        with limited_to(self.programs):
            scene = load_scene(self._source, read_overrides(self.overrides))
        self._files = files_of(scene)
        self._loaded = self._seen = {**stamps(self._files), **self._loaded}
        self._named_files |= named_files(scene)
        return exchanged(scene, (), self.spawned)

    def try_overrides(self, overrides: str) -> RobotDescription:
        """The scene with other overrides, which come from others; only `load` takes them over.

        Raises:
            SceneError: it came from no file.
            ConfigError: as `load`; or the overrides hold an arm, or name a file that the scene does not name.
        """
        if self._source is None:
            raise SceneError(f"{self._name} came from no file; nothing can be laid over it")
        values = read_overrides(overrides)
        self._check_names("overrides", values, Path.cwd())
        with limited_to(self.programs):
            if self.text is None:
                scene = load_scene(self._source, values)
            else:
                scene = load_yaml(self._source, values, self.text)
        if overrides:
            self._check_files("overrides", scene)
        return exchanged(scene, (), self.spawned)

    def try_text(self, text: str) -> RobotDescription:
        """The scene with another text in the place of its file's; only `take_over` goes on with it.

        Raises:
            SceneError: it came from no file.
            ConfigError: as `load`.
        """
        if self._source is None:
            raise SceneError(f"{self._name} came from no file; it cannot be edited")
        with limited_to(self.programs):
            scene = load_yaml(self._source, read_overrides(self.overrides), text)
        return exchanged(scene, (), self.spawned)

    def proposed(self, document: SceneDocument, edits: Sequence[Edit]) -> Proposal:
        """What edits of others would make of a document of the scene; it changes nothing.

        Raises:
            ConfigError: they fit nowhere, or name a file that the scene itself does not name.
        """
        for edit in edits:
            if isinstance(edit, Put):
                self._check_names("edit", _written_out(edit), document.file.parent)
        with limited_to(self.programs):
            proposal = document.proposed(edits)
        self._check_files("edit", proposal.robot)
        return proposal

    def _check_names(self, whose: str, values: Mapping[str, Any], folder: Path) -> None:
        """Refuse values of others that name other files than the scene does; nothing is looked for.

        Args:
            whose: Names the values in a message.
            values: As `load_scene` takes them.
            folder: That relative paths in them are relative to.

        Raises:
            ConfigError: they name others, or hold an arm, which is made of files of its own.
        """
        if "arm" in values:
            raise ConfigError(whose, "arm", "is made of files; change it in the scene's own file")
        others = (name for name in file_names(values) if _plain_path(folder / name) not in self._named_files)
        _refuse_others(whose, others)

    def _check_files(self, whose: str, scene: RobotDescription) -> None:
        """Refuse a scene made with values of others that names other files.

        Raises:
            ConfigError: it does; `whose` names the values.
        """
        _refuse_others(whose, sorted(map(str, named_files(scene) - self._named_files)))

    def take_over(
        self, scene: RobotDescription, overrides: str, spawned: Spawnings, text: str | None = None
    ) -> None:
        """Go on with a scene, what was laid over its files for it, what was spawned in it, and its text."""
        self.scene, self.overrides, self.spawned, self.text = scene, overrides, spawned, text
        self._files = files_of(scene)
        self._loaded = self._seen = {**stamps(self._files), **self._loaded}

    def note_saved(self) -> None:
        """The text that runs was written into the file: there is nothing to load anew."""
        self.text = None
        self._loaded = self._seen = stamps(self._files)

    def saved(self) -> bool:
        """Whether a file has changed since it was loaded and is at rest since the last call."""
        before, self._seen = self._seen, stamps(self._files)
        at_rest = self._seen == before and None not in self._seen.values()
        return at_rest and any(self._loaded.get(file) != stamp for file, stamp in self._seen.items())


def _refuse_others(whose: str, names: Iterable[str]) -> None:
    others = list(names)
    if others:
        raise ConfigError(
            whose,
            "",
            f"name other files than the scene does ({names_up_to(3, others)}); name them in its file",
        )


def _written_out(edit: Put) -> Mapping[str, Any]:
    """The part of a file that holds what an edit puts there."""
    data: Any = edit.value
    for step in reversed(edit.steps):
        data = [data] if isinstance(step, Item) else {step: data}
    return data if isinstance(data, Mapping) else {}


def _plain_path(path: Path) -> Path:
    """A path without `..`, by its text alone."""
    return Path(os.path.normpath(path))


def files_of(robot: RobotDescription) -> list[Path]:
    """Every file that the scene was made of and that a person may edit."""
    if robot.source is None:
        return []
    files = [robot.source]
    if robot.source.suffix == ".py":
        modules = (sys.modules[name] for name in _modules_beside(robot.source))
        files += [Path(module.__file__) for module in modules if module.__file__]
    else:
        files += _extended(robot.source)
    for body in robot.scene.bodies:
        files += [mesh.file for mesh in (body.mesh, body.surface) if isinstance(mesh, MeshFile)]
    return list(dict.fromkeys(files))


def stamps(files: list[Path]) -> Stamps:
    """Time of the last change and size of each file; None for one that is not there."""
    return {file: _stamp(file) for file in files}


def _stamp(file: Path) -> tuple[int, int] | None:
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def _extended(file: Path) -> Iterator[Path]:
    """The files that a YAML file extends, one after the other; ends where one cannot be read."""
    seen = {file}
    while True:
        try:
            target = read_yaml(file).get("extends")
        except ConfigError:
            return
        if not isinstance(target, str):
            return
        file = relative_to_file(target, file)
        if file in seen:
            return
        seen.add(file)
        yield file


def _modules_beside(source: Path) -> list[str]:
    """Names of the imported modules that lie in the scene's folder or below, the suite's own left out."""
    folder = str(source.parent) + "/"
    return [
        name
        for name, module in list(sys.modules.items())
        if str(getattr(module, "__file__", None) or "").startswith(folder)
        and not name.startswith(("softsim_core", "softsim_ros", "servo_bridge", "__main__"))
    ]
