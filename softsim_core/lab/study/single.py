"""One run of a study: build its scene, command it, step it, measure it, within its time limit."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.util
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.base import Array, SceneError, SoftSimError, SolverDivergedError
from softsim_core.lab.identification import replace_expressions
from softsim_core.lab.study.description import At, CommandStep, QuantityDescription, StudyDescription
from softsim_core.lab.study.quantities import Read, quantity
from softsim_core.scene import RobotDescription, load_scene
from softsim_core.scene.io import ProgramRule, allowed_program, limited_to, load_python, load_yaml
from softsim_core.simulation import Simulation

PENDING, DONE, DIVERGED, RAISED, LATE = range(5)
"""Status of a run."""

STATUS_WORDS = ("pending", "done", "diverged", "raised", "exceeded_its_time")

LONGEST_ERROR = 400
"""Largest number of stored characters of an error."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a run.

    Attributes:
        status: DONE, DIVERGED, RAISED or LATE.
        error: Reason of a failure, in one sentence; empty if done.
        results: Value of each quantity by its name; none after a failure.
    """

    status: int
    error: str
    results: dict[str, Array]


@dataclass(frozen=True, slots=True)
class Work:
    """Common data of a study's runs; it is sent to the processes that run them.

    Attributes:
        study: The study.
        scene: File of its scene.
        functions: Files of the measuring functions, by their names in the study.
        programs: Programs that may run.
    """

    study: StudyDescription
    scene: Path
    functions: Mapping[str, Path]
    programs: ProgramRule

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables."""
        return tuple(each.name for each in self.study.variables)

    def robot(self, values: Sequence[float] | Array) -> RobotDescription:
        """Return the scene of a run with values (p,) of the variables.

        Raises:
            SoftSimError: the scene is invalid with these values.
        """
        acting = dict(zip(self.names, (float(each) for each in values), strict=True))
        overlay = replace_expressions(self.study.overlay, acting)
        arguments = replace_expressions(self.study.arguments, acting)
        with limited_to(self.programs):
            if self.scene.suffix == ".py":
                return load_python(self.scene, overlay, arguments)
            if arguments:
                raise SceneError(f"study {self.study.name}: arguments are for Python scenes; use the overlay")
            return load_yaml(self.scene, overlay)

    def load_unchanged(self) -> RobotDescription:
        """Return the scene without overrides."""
        with limited_to(self.programs):
            return load_scene(self.scene)

    def function(self, description: QuantityDescription) -> Read | None:
        """Return the function that measures a quantity; None: it has none.

        Raises:
            SceneError: there is no such function.
            ConfigError: it may not run.
        """
        if description.function is None:
            return None
        path, name = self.functions[description.function], description.function.partition(".py:")[2]
        with limited_to(self.programs):
            program = allowed_program(path)
        try:
            found = getattr(_module(str(path), program.read_bytes()), name, None)
        except OSError as error:
            raise SceneError(f"quantity {description.name}: {path}: {error.strerror}") from error
        if not callable(found):
            raise SceneError(f"quantity {description.name}: {path} has no function {name!r}")
        return found  # type: ignore[no-any-return]


@functools.lru_cache(maxsize=16)
def _module(path: str, text: bytes) -> Any:
    name = f"softsim_study_{hashlib.sha256(text).hexdigest()[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    exec(compile(text, path, "exec"), module.__dict__)  # the user's function, allowed by the user
    return module


Watch = Callable[[Simulation], None]
"""Called after each step."""


ENDING_S = 1.0
"""Time in [s] to wait for the end of a run that exceeded its limit, before it is abandoned."""


def run_once(work: Work, values: Sequence[float] | Array, watch: Watch | None = None) -> Outcome:
    """Execute one run with values (p,) of the variables; any failure is reported in the outcome.

    The run has a thread of its own. When its time is over, _LateError is raised there between two lines of
    Python. A run that sleeps, or calculates in compiled code, is abandoned and ends when it continues.
    """
    ended: list[Outcome] = []
    run = threading.Thread(
        target=lambda: ended.append(_attempt(work, values, watch)), name="run of a study", daemon=True
    )
    run.start()
    run.join(min(work.study.time_limit, threading.TIMEOUT_MAX))
    late = run.is_alive()
    if late:
        assert run.ident is not None
        thread, error = ctypes.c_ulong(run.ident), ctypes.py_object(_LateError)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(thread, error)
        run.join(ENDING_S)
    if not ended or (late and ended[0].status == RAISED):  # file readers may convert _LateError
        return _late(work)
    return ended[0]


def _late(work: Work) -> Outcome:
    return Outcome(LATE, f"exceeded its time limit of {work.study.time_limit:g} s", {})


def _attempt(work: Work, values: Sequence[float] | Array, watch: Watch | None) -> Outcome:
    try:
        return Outcome(DONE, "", _measure_run(work, values, watch))
    except SolverDivergedError as error:
        return Outcome(DIVERGED, _describe_error(error), {})
    except _LateError:
        return _late(work)
    except BaseException as error:  # a function of the study may call sys.exit
        return Outcome(RAISED, _describe_error(error), {})


def _describe_error(error: BaseException) -> str:
    words = str(error) or "no message"
    text = words if isinstance(error, SoftSimError) else f"{type(error).__name__}: {words}"
    return " ".join(text.split())[:LONGEST_ERROR]


def _measure_run(work: Work, values: Sequence[float] | Array, watch: Watch | None) -> dict[str, Array]:
    study = work.study
    simulation = Simulation(work.robot(values))
    acting = dict(zip(work.names, (float(each) for each in values), strict=True))
    quantities = [
        (each, quantity(each, simulation, work.function(each))) for each in study.measure
    ]  # displacements are relative to the scene's start
    commands = _commands(study, simulation, acting)
    if study.duration is None or study.begin == "equilibrium":
        pose, base_shift = np.array(simulation.robot.start_joints), simulation.robot.start_shift
        if commands:  # else where the start move ends
            _, pose, first_shift = commands[0]
            base_shift = 0.0 if first_shift is None else first_shift
        simulation.settle(pose, base_shift)
    if study.duration is None:
        if watch is not None:
            watch(simulation)
        return {description.name: found.read(simulation) for description, found in quantities}
    steps = round(study.duration / simulation.dt)
    values_read: dict[str, list[Array]] = {each.name: [] for each in study.measure}
    due = {round(command.time / simulation.dt): (joints, shift) for command, joints, shift in commands}
    for step in range(steps + 1):
        if step:
            simulation.step()
        for each, found in quantities:
            if step == steps if each.at == "end" else step % stride_of(each, simulation.dt) == 0:
                values_read[each.name].append(np.array(found.read(simulation), dtype=float))
        if watch is not None:
            watch(simulation)
        if step in due:
            joints, shift = due[step]
            if shift is not None:
                simulation.base_shift = shift
            simulation.command(joints)
    return {each.name: _summarise_values(values_read[each.name], each.at) for each in study.measure}


def _summarise_values(values: list[Array], at: At) -> Array:
    """Return what a run keeps of the values of a quantity at its steps."""
    if at == "series":
        return np.array(values)
    if at == "mean":
        return np.asarray(sum(values) / len(values))
    if at == "end":
        return values[-1]
    return np.asarray(np.max(values, axis=0) if at == "max" else np.min(values, axis=0))


def _commands(
    study: StudyDescription, simulation: Simulation, acting: dict[str, float]
) -> list[tuple[CommandStep, Array, float | None]]:
    """Return each step with positions of all joints (j,) and the shift of their bases in [m]."""
    robot, names = simulation.robot, simulation.joint_names
    joints = np.array([each.rest for each in robot.joints])
    shift: float | None = None
    commands = []
    for each in study.command:
        if each.pose is not None:
            if each.pose not in robot.poses:
                raise SceneError(f"study {study.name}: the scene has no pose {each.pose!r}")
            joints = np.array(robot.poses[each.pose])
        for name, value in replace_expressions(each.joints, acting).items():
            if name not in names:
                raise SceneError(f"study {study.name}: the scene has no joint {name!r}")
            joints = joints.copy()
            joints[names.index(name)] = float(value)
        if each.base_shift is not None:
            shift = float(replace_expressions(each.base_shift, acting))
        commands.append((each, joints.copy(), shift))
    return commands


def stride_of(description: QuantityDescription, dt: float) -> int:
    """Return the number of steps of dt in [s] between the values of a series."""
    return 1 if description.every is None else max(1, round(description.every / dt))


class _LateError(SystemExit):
    """Raised in a run that exceeded its time; as a SystemExit it ends a thread silently."""
