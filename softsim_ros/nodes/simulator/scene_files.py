"""Load scenes while the simulator runs: files and their changes, the next scene, background compilation."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from softsim_core import RobotDescription, Simulation, load_scene
from softsim_core.base import (
    ConfigError,
    MeshFile,
    SceneError,
    SoftSimError,
    SolverDivergedError,
    names_up_to,
    python_command,
    start_process,
)
from softsim_core.physics.dynamics import has_compiled_step
from softsim_core.scene import SceneCatalog, check_size
from softsim_core.scene.editing import Edit, Proposal, Put, SceneDocument
from softsim_core.scene.io import (
    ANY_PROGRAM,
    Item,
    ProgramRule,
    file_names,
    limited_to,
    load_yaml,
    named_files,
    read_overrides,
    read_yaml,
    relative_to_file,
)
from softsim_core.simulation import get_ready_to_load, kernels_ready
from softsim_node import ending
from softsim_ros.nodes.simulator.parameters import SimulatorSettings
from softsim_ros.nodes.simulator.physics_thread import PhysicsThread
from softsim_ros.nodes.simulator.spawning import Spawnings, replace_spawned

LOOK_S: Final = 0.1

BEGINS: Final = "the robot begins on the SciPy path while kernels compile beside it, once, one to two minutes"


class CompiledLater:
    """Compiles the kernels in the background, then switches the physics thread to them.

    Nothing waits for it. The kernels of the running scene are compiled first, then those that other scenes
    need, then those that only large meshes need.

    Args:
        scene: File of the running scene; None if the scene differs from its file: it then waits for all
            kernels.
    """

    def __init__(self, physics: PhysicsThread, scene: str | os.PathLike[str] | None, logger: Any) -> None:
        self._physics, self._logger = physics, logger
        self._scene = scene
        own = [["--only", "--scene", os.fspath(scene)]] if scene is not None else []
        self._stages: list[list[str]] = [*own, ["--small"], []]
        self._ended = threading.Event()
        self._child: subprocess.Popen[bytes] | None = None
        self._changes = threading.Lock()  # guards the child process: none starts after close()
        self._thread = threading.Thread(target=self._run, name="compiled later", daemon=True)

    def start(self) -> None:
        """Start to compile."""
        self._thread.start()

    def close(self) -> None:
        """End the compiling process, if any; the cache stays, so the next start continues from there."""
        with self._changes:
            self._ended.set()
            child = self._child
        if child is not None and child.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()
        if self._thread.ident is not None:
            ending.wait_for(self._thread)

    def _run(self) -> None:
        for words in self._stages:
            if not self._compile_kernels(words):
                continue  # the scene's file may be gone; the later stages include its kernels
            try:
                self._go_over()
            except SoftSimError as error:
                if not self._ended.is_set():
                    self._logger.warning(f"the SciPy path continues: {error}")

    def _compile_kernels(self, words: list[str]) -> bool:
        """Compile the kernels of a scene in a child process and wait for its end.

        Return False if it failed, which is logged, or if `close` ended it.
        """
        with self._changes:
            if self._ended.is_set():
                return False
            self._child = start_process(
                python_command("softsim_core.simulation.warmup", "--beside", *words),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is for the node, which ends this process itself
            )
        _, errors = self._child.communicate()
        if self._child.returncode and not self._ended.is_set():
            last = (errors.decode(errors="replace").strip().splitlines() or ["no reason was given"])[-1]
            self._logger.warning(f"kernels were not compiled ({last:.200}); the SciPy path continues")
        return self._child.returncode == 0

    def _go_over(self) -> None:
        """Switch the running simulation to the kernels.

        Do nothing if it uses them already or needs some that are not compiled yet.
        """
        while not self._ended.is_set():
            running = self._physics.call(lambda simulation: simulation, shows=False)
            if running.compiled or not (kernels_ready() or running.robot.source == self._scene):
                return
            loaded = _build_with_kernels(running)
            if not loaded.compiled:
                return
            step = self._physics.call(partial(_switch_to, loaded, running), shows=False)
            if step is not None:
                self._logger.info(f"kernels compiled: from step {step} on the simulation runs on them")
                return


def _switch_to(loaded: Simulation, running: Simulation, simulation: Simulation) -> int | None:
    """Switch `running` to the kernels between two steps; return the number of the next step.

    Return None if another simulation runs by then.
    """
    if simulation is not running:
        return None
    simulation.step_by(loaded)
    return simulation.step_count + 1


def _build_with_kernels(running: Simulation) -> Simulation:
    """Return the same scene stepped by the kernels; building it loads them."""
    trial = _try_step(running.robot, "numba")
    return Simulation(trial.robot, backend="numba", like=trial)


def _try_step(robot: RobotDescription, backend: Any) -> Simulation:
    """Return a simulation without controllers after a step, in which all that a step needs was loaded."""
    trial = Simulation(replace(robot, controllers=()), backend=backend)
    with suppress(SolverDivergedError):  # the physics thread will meet it too, stop and report it
        trial.step()
    trial.von_mises()
    return trial


Stamps = dict[Path, tuple[int, int] | None]


class SceneFiles:
    """Sources of a scene: its file, the files that it extends or imports, its meshes, and overrides.

    Args:
        robot: As loaded; one that came from no file can be neither watched nor reloaded.
        programs: Programs that may run when it is reloaded, such as the xacro file of its arm.

    Attributes:
        scene: The running scene.
        programs: As given.
        overrides: Text of values that override those of the files when they are loaded, see `read_overrides`.
        spawned: Bodies that were spawned since the start; they stay when the files are reloaded.
        text: Text that replaces that of the scene's file until the files are reloaded; None: none.
    """

    def __init__(self, robot: RobotDescription, programs: ProgramRule = ANY_PROGRAM) -> None:
        self.scene, self.overrides, self.programs = robot, "", programs
        self.spawned: Spawnings = ()
        self.text: str | None = None
        self._name, self._source = robot.name, robot.source
        self._files = files_of(robot)
        self._loaded = self._last_stamps = stamps(self._files)
        self._named_files = named_files(robot)

    def load(self) -> RobotDescription:
        """Load the scene from its files as they are now.

        Raises:
            SceneError: it came from no file.
            ConfigError: any problem in the files or in the overrides, as a message.
        """
        if self._source is None:
            raise SceneError(f"{self._name} came from no file and cannot be reloaded; restart its program")
        self._loaded = self._last_stamps = stamps(self._files)
        for module in _modules_beside(self._source):
            sys.modules.pop(module, None)
        importlib.invalidate_caches()
        with limited_to(self.programs):
            scene = load_scene(self._source, read_overrides(self.overrides))
        self._files = files_of(scene)
        self._loaded = self._last_stamps = {**stamps(self._files), **self._loaded}
        self._named_files |= named_files(scene)
        return replace_spawned(scene, (), self.spawned)

    def try_overrides(self, overrides: str) -> RobotDescription:
        """Return the scene with other overrides, which may be remote.

        Nothing else changes; `take_over` makes it the running scene.

        Raises:
            SceneError: it came from no file.
            ConfigError: as `load`; or the overrides contain an arm, or name a file that the scene does not
                name.
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
        return replace_spawned(scene, (), self.spawned)

    def try_text(self, text: str) -> RobotDescription:
        """Return the scene with another text instead of its file's.

        Nothing else changes; `take_over` makes it the running scene.

        Raises:
            SceneError: it came from no file.
            ConfigError: as `load`.
        """
        if self._source is None:
            raise SceneError(f"{self._name} came from no file; it cannot be edited")
        with limited_to(self.programs):
            scene = load_yaml(self._source, read_overrides(self.overrides), text)
        return replace_spawned(scene, (), self.spawned)

    def propose(self, document: SceneDocument, edits: Sequence[Edit]) -> Proposal:
        """Apply remote edits to a document of the scene and return the result; the document does not change.

        Raises:
            ConfigError: they fit nowhere, or name a file that the scene itself does not name.
        """
        for edit in edits:
            if isinstance(edit, Put):
                self._check_names("edit", _written_out(edit), document.file.parent)
        with limited_to(self.programs):
            proposal = document.propose(edits)
        self._check_files("edit", proposal.robot)
        return proposal

    def _check_names(self, whose: str, values: Mapping[str, Any], folder: Path) -> None:
        """Refuse remote values that name files which the scene does not name, or contain an arm.

        No file is accessed; relative paths refer to `folder`, and `whose` names the values in a message.
        """
        if "arm" in values:
            raise ConfigError(whose, "arm", "is made of files; change it in the scene's own file")
        # normpath, from the text alone: a path with `..` must not be looked up on the disk
        others = (
            name
            for name in file_names(values)
            if Path(os.path.normpath(folder / name)) not in self._named_files
        )
        _refuse_others(whose, others)

    def _check_files(self, whose: str, scene: RobotDescription) -> None:
        """Refuse a scene that was built with remote values and names other files."""
        _refuse_others(whose, sorted(map(str, named_files(scene) - self._named_files)))

    def take_over(
        self, scene: RobotDescription, overrides: str, spawned: Spawnings, text: str | None = None
    ) -> None:
        """Record the scene that runs now, with its overrides, its spawned bodies and its text."""
        self.scene, self.overrides, self.spawned, self.text = scene, overrides, spawned, text
        self._files = files_of(scene)
        self._loaded = self._last_stamps = {**stamps(self._files), **self._loaded}

    def note_saved(self) -> None:
        """Record that the running text was written into the file, so nothing has to be reloaded."""
        self.text = None
        self._loaded = self._last_stamps = stamps(self._files)

    def has_changed_on_disk(self) -> bool:
        """Return whether a file has changed since it was loaded and has not changed since the last call."""
        before, self._last_stamps = self._last_stamps, stamps(self._files)
        at_rest = self._last_stamps == before and None not in self._last_stamps.values()
        return at_rest and any(self._loaded.get(file) != stamp for file, stamp in self._last_stamps.items())


def _refuse_others(whose: str, names: Iterable[str]) -> None:
    others = list(names)
    if others:
        raise ConfigError(
            whose,
            "",
            f"name other files than the scene does ({names_up_to(3, others)}); name them in its file",
        )


def _written_out(edit: Put) -> Mapping[str, Any]:
    """Return the part of a scene file that an edit would set, as nested mappings."""
    data: Any = edit.value
    for step in reversed(edit.steps):
        data = [data] if isinstance(step, Item) else {step: data}
    return data if isinstance(data, Mapping) else {}


def files_of(robot: RobotDescription) -> list[Path]:
    """Return every file that the scene was made of and that a user may edit."""
    if robot.source is None:
        return []
    files = [robot.source]
    if robot.source.suffix == ".py":
        modules = (sys.modules[name] for name in _modules_beside(robot.source))
        files += [Path(module.__file__) for module in modules if module.__file__]
    else:
        files += _find_extended(robot.source)
    for body in robot.scene.bodies:
        files += [mesh.file for mesh in (body.mesh, body.surface) if isinstance(mesh, MeshFile)]
    return list(dict.fromkeys(files))


def stamps(files: list[Path]) -> Stamps:
    """Return modification time and size of each file; None for a missing one."""
    found: Stamps = dict.fromkeys(files)
    for file in files:
        with suppress(OSError):
            status = file.stat()
            found[file] = status.st_mtime_ns, status.st_size
    return found


def _find_extended(file: Path) -> Iterator[Path]:
    """Yield the files that a YAML file extends, in order; stop at one that cannot be read."""
    visited = {file}
    while True:
        try:
            target = read_yaml(file).get("extends")
        except ConfigError:
            return
        if not isinstance(target, str):
            return
        file = relative_to_file(target, file)
        if file in visited:
            return
        visited.add(file)
        yield file


def _modules_beside(source: Path) -> list[str]:
    """Return names of the imported modules from the scene's folder or below, except this project's."""
    folder = str(source.parent) + "/"
    return [
        name
        for name, module in list(sys.modules.items())
        if str(getattr(module, "__file__", None) or "").startswith(folder)
        and not name.startswith(("softsim_core", "softsim_ros", "servo_bridge", "__main__"))
    ]


class NextScene(NamedTuple):
    """A scene that is ready to replace the running one."""

    files: SceneFiles
    scene: RobotDescription
    simulation: Simulation
    overrides: str
    spawned: Spawnings
    text: str | None = None


class Attempt(NamedTuple):
    """Result of building the scene that a parameter change (name and value) asks for, or the error."""

    request: tuple[str, str]
    built: NextScene | None
    error: Exception | None


class SceneBuilder:
    """Builds simulations as the node's parameters say, in any thread; touches no running simulation."""

    def __init__(self, settings: Callable[[], SimulatorSettings], logger: Any) -> None:
        self._settings, self._logger = settings, logger

    def build(self, scene: RobotDescription) -> Simulation:
        """Build a simulation that is warmed up: its first step takes no longer than the others.

        Before the kernels are compiled, "auto" is the SciPy path; see CompiledLater.

        Raises:
            SoftSimError: it takes more memory than allowed, see scene.size, or cannot be built.
        """
        check_size(scene.scene)
        robot = self._settings().over(scene)
        backend: Any = self._settings().backend
        waits = self.waits(robot)
        self._logger.info(f"building {robot.name}{f'; {BEGINS}' if waits else ''}")
        if waits:
            backend = "scipy"
            get_ready_to_load()  # now, since later it would delay a moving robot

        def make() -> Simulation:
            _try_step(robot, backend)
            return Simulation(robot, backend=backend)

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            simulation = ending.abandonable(make)
        for message in dict.fromkeys(str(warning.message) for warning in caught):
            self._logger.warning(message)
        return simulation

    def waits(self, robot: RobotDescription) -> bool:
        """Return whether the robot starts on the SciPy path because kernels are not compiled yet."""
        compiles = self._settings().backend == "auto" and has_compiled_step(robot.scene.solver.linear_solver)
        return compiles and not kernels_ready()

    def build_again(self, files: SceneFiles) -> NextScene:
        """Load and build the scene from its files as they are now.

        Raises:
            SoftSimError: it cannot be loaded or built.
        """
        scene = files.load()
        return NextScene(files, scene, self.build(scene), files.overrides, files.spawned)

    def build_named(self, name: str, scenes: SceneCatalog) -> NextScene:
        """Load and build a known scene by its name.

        Raises:
            SoftSimError: it is unknown, or cannot be loaded or built.
        """
        robot = scenes.load(name)
        return self.build_again(SceneFiles(robot, scenes.rule_of(scenes.find(name))))

    def build_overridden(self, overrides: str, files: SceneFiles) -> NextScene:
        """Load and build the scene with other overrides of its files.

        Raises:
            SoftSimError: it cannot be loaded or built with them.
        """
        try:
            scene = files.try_overrides(overrides)
            return NextScene(files, scene, self.build(scene), overrides, files.spawned, files.text)
        except Exception as error:
            raise SoftSimError(f"overrides refused: {reason(error)}") from error

    def with_spawned(
        self, files: SceneFiles, change: Callable[[RobotDescription, Spawnings], Spawnings]
    ) -> NextScene:
        """Build the running scene with other spawned bodies.

        Args:
            files: Sources of the running scene.
            change: Returns the new spawned bodies, given the scene and the present ones.

        Raises:
            SoftSimError: it cannot be built with them, or `change` refuses.
        """
        spawned = change(files.scene, files.spawned)
        scene = replace_spawned(files.scene, files.spawned, spawned)
        return NextScene(files, scene, self.build(scene), files.overrides, spawned, files.text)

    def build_proposed(self, files: SceneFiles, text: str) -> NextScene:
        """Build the scene with a proposed text instead of its file's.

        Raises:
            SoftSimError: it cannot be built.
        """
        scene = files.try_text(text)
        return NextScene(files, scene, self.build(scene), files.overrides, files.spawned, text)


def reason(error: Exception) -> str:
    """Return why something failed; for an error from outside this project, with its type."""
    return str(error) if isinstance(error, SoftSimError) else f"{type(error).__name__}: {error}"
