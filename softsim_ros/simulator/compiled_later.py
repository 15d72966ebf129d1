"""Kernels compile in a process beside the simulation, which goes over to them between two steps."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

from softsim_core import Simulation
from softsim_core.errors import SoftSimError, SolverDivergedError
from softsim_core.processes import python_command, start_process
from softsim_core.warmup import kernels_ready
from softsim_node.ending import ending
from softsim_ros.simulator.physics_thread import PhysicsThread

LOOK_S: Final = 0.1

BEGINS: Final = "the robot begins on the SciPy path while kernels compile beside it, once, one to two minutes"


class CompiledLater:
    """Compiles, then has a physics thread step by the compiled kernels; waits for nobody.

    What the scene steps by comes first, then what other scenes need, then what large meshes need more.

    Args:
        physics: Whose simulation.
        scene: File of the scene that runs; None: it is not as its file says, and waits for all kernels.
        logger: The node's.
    """

    def __init__(self, physics: PhysicsThread, scene: str | os.PathLike[str] | None, logger: Any) -> None:
        self._physics, self._logger = physics, logger
        self._scene = scene
        own = [["--only", "--scene", os.fspath(scene)]] if scene is not None else []
        self._stages: list[list[str]] = [*own, ["--small"], []]
        self._ended = threading.Event()
        self._child: subprocess.Popen[bytes] | None = None
        self._changes = threading.Lock()  # of the child: none begins once all has ended
        self._thread = threading.Thread(target=self._run, name="compiled later", daemon=True)

    def start(self) -> None:
        """Begin to compile."""
        self._thread.start()

    def close(self) -> None:
        """End the process if it still compiles: what is in the cache stays, the next start goes on there."""
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
            if not self._compile(words):
                continue  # the scene's file may be gone; all other kernels hold its own
            try:
                self._go_over()
            except SoftSimError as error:
                if not self._ended.is_set():
                    self._logger.warning(f"the SciPy path goes on: {error}")

    def _compile(self, words: list[str]) -> bool:
        """Have a process compile, and wait for it; False where it failed, which is told, or all has ended."""
        with self._changes:
            if self._ended.is_set():
                return False
            self._child = start_process(
                python_command("softsim_core.warmup", "--beside", *words),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is for the robot, which ends this process
            )
        _, errors = self._child.communicate()
        if self._child.returncode and not self._ended.is_set():
            last = (errors.decode(errors="replace").strip().splitlines() or ["no reason was given"])[-1]
            self._logger.warning(f"kernels were not compiled ({last:.200}); the SciPy path goes on")
        return self._child.returncode == 0

    def _go_over(self) -> None:
        """Until the simulation that runs steps by the kernels, or needs some that are not compiled yet."""
        while not self._ended.is_set():
            running = self._physics.call(lambda simulation: simulation, shows=False)
            if running.compiled or not (kernels_ready() or running.robot.source == self._scene):
                return
            loaded = _compiled(running)
            if not loaded.compiled:
                return
            step = self._physics.call(_goes_over(running, loaded), shows=False)
            if step is not None:
                self._logger.info(f"kernels compiled: from step {step} on the simulation runs on them")
                return


def _compiled(running: Simulation) -> Simulation:
    """The same scene, stepped by the kernels, which this loads."""
    robot = replace(running.robot, controllers=())
    trial = Simulation(robot, backend="numba")
    with suppress(SolverDivergedError):
        trial.step()
    trial.von_mises()
    return Simulation(robot, backend="numba", like=trial)


def _goes_over(running: Simulation, loaded: Simulation) -> Callable[[Simulation], int | None]:
    """What to do between two steps; gives the next step's number, None where another simulation runs now."""

    def go_over(simulation: Simulation) -> int | None:
        if simulation is not running:
            return None
        simulation.step_by(loaded)
        return simulation.step_count + 1

    return go_over
