"""Measure a whole step of both implementations, and a tick of inverse control."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from benchmarks.measured_scenes import TOUCHING, Case, TouchingScene
from benchmarks.records import Record
from softsim_core import Simulation
from softsim_core.base import Array, Contender, take_turns
from softsim_core.control.inverse import InverseController
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.dynamics import ScipyStepper, Unknowns
from softsim_core.physics.linalg import factorise_matrix
from softsim_core.physics.mechanics import Control, Pose
from softsim_core.scene import RobotDescription

GOAL_SPREAD = 0.004
"""Half the range in [m] around the effector's position in the start pose from which goals are drawn."""


def can_control() -> bool:
    """Return whether inverse control can be measured here: it needs daqp and compiled steps."""
    return bool(find_spec("daqp") and find_spec("numba"))


class MovingGoal:
    """Inverse control in motion: the goal jumps between positions around the start pose."""

    def __init__(self, description: RobotDescription) -> None:
        self.controller = InverseController(replace(description, start=None), backend="numba")
        start = description.start
        if start is not None:
            self.controller.start(description.poses[start.pose], start.base_shift)
        self._home = self.controller.tick().model_pose
        self._random = np.random.default_rng(1)

    def stir(self) -> None:
        """Set another goal."""
        shift = self._random.uniform(-GOAL_SPREAD, GOAL_SPREAD, 3)
        self.controller.set_goal(Pose(self._home.position + shift, self._home.quaternion_xyzw))


STEPS_A_TURN = {"numba": 20, "scipy": 1}
FACTORISATIONS_A_TURN, PROBES_A_TURN = 2, 5
LEAD_IN_STEPS = {"numba": 60, "scipy": 30}
"""Steps before the first timed one: the clamped body falls, the Tripod plays its start animation."""

FALL_STEPS = 40
"""Steps after which the clamped body falls from rest again, since implicit Euler damps it within 1 s."""

COMMAND_SPREAD = 0.2
"""Half the range in [rad] around the start pose from which the Tripod's joint commands are drawn."""

Path = Literal["numba", "scipy"]


def known_paths() -> list[Path]:
    """Return the implementations of the step that can run here."""
    return ["numba", "scipy"] if find_spec("numba") else ["scipy"]


class MovingScene:
    """A simulation in motion: the clamped body swings, the Tripod's joints follow random commands."""

    def __init__(self, case: Case, path: Path) -> None:
        with warnings.catch_warnings():  # the warnings about slivers are known
            warnings.simplefilter("ignore", UserWarning)
            self.simulation = Simulation(case.description, backend=path)
        self._random = np.random.default_rng(1)
        if case.description.start is not None:
            self.simulation.start_animation()
        for _ in range(LEAD_IN_STEPS[path]):
            self.simulation.step()

    def stir(self) -> None:
        """Send another joint command near the start pose; a body without joints falls again periodically."""
        start = self.simulation.robot.start
        if start is None:
            if self.simulation.step_count >= FALL_STEPS:
                self.simulation.reset()
            return
        pose = np.array(self.simulation.robot.poses[start.pose])
        self.simulation.command(pose + self._random.uniform(-COMMAND_SPREAD, COMMAND_SPREAD, len(pose)))


def step_matrix(simulation: Simulation) -> sp.csc_matrix:
    """Return the matrix of the next step over its unknowns, shape (d, d).

    Unknowns are free nodes, frames and compliant joints. Rows and columns of prescribed joints are left out,
    as in the step.
    """
    model = simulation.model
    state = model.rest_state()
    state.positions[:] = simulation.positions
    state.joint_positions[:] = simulation.joint_positions
    state.base_shift[0] = simulation.base_shift
    frames = simulation.frames()
    for index, name in enumerate(model.frame_names):
        state.frame_positions[index] = frames[name].position
    control = Control(simulation.joint_targets, simulation.forces, simulation.base_shift)
    matrix, *_ = ScipyStepper(model, Actuators()).system(state, control, simulation.parameters)
    solved = Unknowns(model).solved
    return matrix[solved][:, solved].tocsc()


class Factorisation:
    """One SuperLU factorisation of a moving scene's matrix: minimum degree on A + A^T, symmetric mode."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self.prepare()

    def prepare(self) -> None:
        """Take the matrix of the simulation's present state."""
        self._matrix = step_matrix(self._simulation)

    def run(self) -> None:
        """Factorise it."""
        factorise_matrix(self._matrix)


_PANELS, _ROWS, _COLUMNS = 64, 64, 32
"""Panels of 16 kB in all 1 MB, such as the factor of a mesh of a thousand nodes."""


class Probe:
    """What this processor can do: a fixed kernel that streams panels and multiplies each with itself.

    A target that compares a step with SuperLU depends on the processor, since SuperLU follows indices where
    the step works on dense panels. The probe does nothing but the latter, so that a step that misses both
    targets has become slower, and not the machine.

    Attributes:
        panels: The panels, shape (p, r, c).
        squares: The products, shape (p, c, c).
    """

    def __init__(self) -> None:
        import numba

        self.panels = np.random.default_rng(1).uniform(0.5, 1.0, (_PANELS, _ROWS, _COLUMNS))
        self.squares = np.zeros((_PANELS, _COLUMNS, _COLUMNS))
        self._update: Any = numba.njit(fastmath=True, error_model="numpy")(_update)

    def run(self) -> None:
        """Do the work once: 8.4 Mflop, and 1.5 MB read or written."""
        self._update(self.panels, self.squares)


def _update(panels: Array, squares: Array) -> None:
    """Set each square to the product of its panel with itself, row by row."""
    for p in range(len(panels)):
        panel, square = panels[p], squares[p]
        square[:] = 0.0
        for row in range(panel.shape[0]):
            for i in range(panel.shape[1]):
                factor = panel[row, i]
                for j in range(panel.shape[1]):
                    square[i, j] += factor * panel[row, j]


def measure(cases: Sequence[Case], paths: Sequence[Path], rounds: int) -> list[Record]:
    """Measure the cases of one mesh on the given paths, all in turns.

    Args:
        cases: Scenes on one mesh.
        paths: Implementations of the step.
        rounds: Turns of each.

    Returns:
        One record per case and path, not judged yet; inverse control needs daqp and the Numba path.
    """
    contenders: list[Contender] = []
    sizes: dict[str, tuple[int, int]] = {}
    ticks = [case for case in cases if case.scene == "inverse" and "numba" in paths and can_control()]
    for case in ticks:
        goal = MovingGoal(case.description)
        contenders.append(Contender("inverse", goal.controller.tick, STEPS_A_TURN["numba"], goal.stir))
        sizes[case.scene] = (len(goal.controller.model.positions), len(goal.controller.model.tets))
    steps = [case for case in cases if case.scene != "inverse"]
    for case in steps:
        for path in paths:
            scene: MovingScene | TouchingScene
            if case.scene in TOUCHING:
                scene = TouchingScene(case.scene, case.description, path)
            else:
                scene = MovingScene(case, path)
            contenders.append(
                Contender(f"{case.scene} {path}", scene.simulation.step, STEPS_A_TURN[path], scene.stir)
            )
            sizes[case.scene] = (len(scene.simulation.positions), len(scene.simulation.tets))
            if path == paths[0] and isinstance(scene, MovingScene):
                splu = Factorisation(scene.simulation)
                contenders.append(
                    Contender(f"{case.scene} splu", splu.run, FACTORISATIONS_A_TURN, splu.prepare)
                )
    if "numba" in paths:
        contenders.append(Contender("probe", Probe().run, PROBES_A_TURN))
    times = take_turns(contenders, rounds)
    records = [
        _record(case, path, sizes[case.scene], times[f"{case.scene} {path}"], times.get(f"{case.scene} splu"))
        for case in steps
        for path in paths
    ] + [_record(case, "numba", sizes[case.scene], times["inverse"], None) for case in ticks]
    if "probe" in times:
        for record in records:
            record.probe_min_ms = float(times["probe"].min())
    return records


def _record(case: Case, path: Path, size: tuple[int, int], step: Array, splu: Array | None) -> Record:
    return Record(
        scene=case.scene,
        mesh=case.mesh,
        path=path,
        nodes=size[0],
        elements=size[1],
        min_ms=float(step.min()),
        median_ms=float(np.median(step)),
        splu_min_ms=None if splu is None else float(splu.min()),
        extras={
            **({} if splu is None else {"splu_median_ms": float(np.median(splu))}),
            "rotation": case.description.scene.solver.rotation,
            "dt_s": case.description.scene.dt,
            "samples": len(step),
        },
    )
