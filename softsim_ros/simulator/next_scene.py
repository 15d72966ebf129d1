"""Another scene, loaded and built while the one before runs."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

from softsim_core import RobotDescription, Simulation
from softsim_core.dynamics.backends import has_compiled_step
from softsim_core.errors import SoftSimError, SolverDivergedError
from softsim_core.scene import SceneCatalog
from softsim_core.scene.size import check_size
from softsim_core.warmup import get_ready_to_load, kernels_ready
from softsim_node.ending import ending
from softsim_ros.simulator.compiled_later import BEGINS
from softsim_ros.simulator.parameters import SimulatorSettings
from softsim_ros.simulator.scene_files import SceneFiles
from softsim_ros.simulator.spawning import Spawnings, exchanged


class NextScene(NamedTuple):
    """A scene that is ready to take the place of the one that runs."""

    files: SceneFiles
    scene: RobotDescription
    simulation: Simulation
    overrides: str
    spawned: Spawnings
    text: str | None = None


class Tried(NamedTuple):
    """What came of a parameter's wish (name and value) for another scene: that, or why there is none."""

    wish: tuple[str, str]
    built: NextScene | None
    error: Exception | None


class SceneBuilder:
    """Makes simulations as the node's parameters say; in any thread, and nothing that runs is touched.

    Args:
        settings: Tells the present parameters.
        logger: The node's.
    """

    def __init__(self, settings: Callable[[], SimulatorSettings], logger: Any) -> None:
        self._settings, self._logger = settings, logger

    def build(self, scene: RobotDescription) -> Simulation:
        """The simulation, ready: the first real step takes no longer than the others.

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
            get_ready_to_load()  # now, since later it would be in the way of a robot that moves

        def make() -> Simulation:
            trial = Simulation(replace(robot, controllers=()), backend=backend)
            with suppress(SolverDivergedError):  # the physics thread will meet it, stop there and say so
                trial.step()
            trial.von_mises()
            return Simulation(robot, backend=backend)

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            simulation = ending.abandonable(make)
        for sentence in dict.fromkeys(str(warning.message) for warning in caught):
            self._logger.warning(sentence)
        return simulation

    def waits(self, robot: RobotDescription) -> bool:
        """Whether the robot begins on the SciPy path because kernels are not compiled yet."""
        compiles = self._settings().backend == "auto" and has_compiled_step(robot.scene.solver.linear_solver)
        return compiles and not kernels_ready()

    def anew(self, files: SceneFiles) -> NextScene:
        """The scene as its files are now.

        Raises:
            SoftSimError: it cannot be loaded or built.
        """
        scene = files.load()
        return NextScene(files, scene, self.build(scene), files.overrides, files.spawned)

    def named(self, name: str, scenes: SceneCatalog) -> NextScene:
        """A known scene by its name.

        Raises:
            SoftSimError: it is not known, or cannot be loaded or built.
        """
        robot = scenes.load(name)
        return self.anew(SceneFiles(robot, scenes.rule_of(scenes.find(name))))

    def overridden(self, overrides: str, files: SceneFiles) -> NextScene:
        """The scene with other values laid over its files.

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
        """The scene that runs, with other bodies spawned; `change` makes them of it and of those before.

        Raises:
            SoftSimError: it cannot be built with them, or `change` refuses.
        """
        spawned = change(files.scene, files.spawned)
        scene = exchanged(files.scene, files.spawned, spawned)
        return NextScene(files, scene, self.build(scene), files.overrides, spawned, files.text)

    def proposed(self, files: SceneFiles, text: str) -> NextScene:
        """The scene with a proposed text in the place of its file's.

        Raises:
            SoftSimError: it cannot be built.
        """
        scene = files.try_text(text)
        return NextScene(files, scene, self.build(scene), files.overrides, files.spawned, text)


def reason(error: Exception) -> str:
    """Why something failed, with the kind of an error that is not the suite's."""
    return str(error) if isinstance(error, SoftSimError) else f"{type(error).__name__}: {error}"
