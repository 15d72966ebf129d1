"""Run a MuJoCo model in MuJoCo and as a scene of ours: positions over time, sags, step times."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softsim_core import Simulation
from softsim_core.base import Array, Contender, MjcfError, restart_every, take_turns
from softsim_core.mjcf import ImportedScene, MujocoRun, import_mjcf, write_imported
from softsim_core.scene import load_scene

LAWS = ("corotational", "saint_venant_kirchhoff")
"""Our default law, which is compiled, and the law that MuJoCo uses."""
TIMES = 10
"""Number of instants at which positions are compared."""
MOST_STEPS = 100_000
STEPS_A_TURN, TURNS_A_FALL = 10, 4


@dataclass(frozen=True, slots=True)
class Moment:
    """Distance of soft and free rigid bodies from MuJoCo's at a time in [s]: largest and RMS value in [m]."""

    time: float
    largest: float
    mean: float


@dataclass(frozen=True, slots=True)
class EngineRow:
    """Results of one engine.

    Attributes:
        name: The engine; for ours, with the law.
        sags: How far in [m] the lowest point of each soft body is below its lowest point at the start.
        speed: Largest speed in [m/s] of any vertex at the end.
        min_ms, median_ms: Time per step in [ms].
        samples: Number of timed steps.
        moments: Distances from MuJoCo; empty for MuJoCo itself.
        method: How it computes a step.
    """

    name: str
    sags: dict[str, float]
    speed: float
    min_ms: float
    median_ms: float
    samples: int
    moments: tuple[Moment, ...]
    method: str


@dataclass(frozen=True, slots=True)
class ModelComparison:
    """A model in both engines.

    Attributes:
        file: The model.
        version: MuJoCo's version.
        dt: Time step in [s] of both.
        seconds: Simulated time in [s].
        nodes, elements: Counts over all soft bodies.
        rows: MuJoCo, then our engine with each law.
        warnings: Number of warnings that MuJoCo gave.
        remarks: Messages about parts of the model that were not imported.
    """

    file: Path
    version: str
    dt: float
    seconds: float
    nodes: int
    elements: int
    rows: tuple[EngineRow, ...]
    warnings: int
    remarks: tuple[str, ...]


class _Ours:
    """A MuJoCo model imported as a scene of ours, with its soft vertices and free rigid bodies."""

    def __init__(self, imported: ImportedScene, file: Path, law: str) -> None:
        self.simulation = Simulation(load_scene(file))
        self.name, self.method = f"ours, {law}", "one exact factorisation a step"
        bodies, rigid_names = self.simulation.bodies, [each.name for each in imported.scene.rigid_bodies]
        self._parts = [(each.name, each.nodes) for each in bodies if each.name in imported.flexes]
        self._rigid = [rigid_names.index(name) for name in imported.free]

    def restart(self) -> None:
        self.simulation.reset()

    def advance(self) -> None:
        self.simulation.step()

    def soft(self) -> dict[str, Array]:
        """Return the current vertices of each soft body in [m]."""
        return {name: self.simulation.positions[nodes] for name, nodes in self._parts}

    def rigid(self) -> Array:
        """Return the current centres of the free rigid bodies in [m], shape (k, 3)."""
        poses = self.simulation.rigid_poses
        return np.array([poses[k].position for k in self._rigid]).reshape(-1, 3)


class _Theirs(MujocoRun):
    """The same model in MuJoCo, with the same methods."""

    def __init__(self, imported: ImportedScene, file: Path) -> None:
        super().__init__(file)
        self._flexes, self._free = imported.flexes, tuple(imported.free.values())

    def soft(self) -> dict[str, Array]:
        points = self.points()
        return {name: points[part] for name, part in self._flexes.items()}

    def rigid(self) -> Array:
        return self.bodies(self._free)


def compare_model(file: Path, laws: Sequence[str], seconds: float, rounds: int) -> ModelComparison:
    """Run a MuJoCo model in MuJoCo and in our engine, both from rest and without control.

    Both use the model's own dt.

    Args:
        file: An MJCF file.
        laws: Laws of our soft bodies; each is run separately.
        seconds: Simulated time in [s].
        rounds: Turns of each engine when steps are timed.

    Raises:
        MjcfError: the model is refused.
        SceneError, MeshError: it does not run as a scene.
    """
    with tempfile.TemporaryDirectory(prefix="softsim-mjcf-") as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        scenes = [import_mjcf(file, law) for law in laws]
        if not scenes[0].scene.bodies:  # without soft bodies the law has no effect
            laws, scenes = laws[:1], scenes[:1]
        ours = [
            _Ours(imported, write_imported(imported, Path(folder, law), file.name), law)
            for imported, law in zip(scenes, laws, strict=True)
        ]
    theirs = _Theirs(scenes[0], file.absolute())
    if seconds > MOST_STEPS * theirs.dt:
        reason = f"takes more than {MOST_STEPS} steps for {seconds:g} s; ask for fewer --seconds"
        raise MjcfError(file, reason)
    engines: list[_Ours | _Theirs] = [theirs, *ours]
    found = [_run(engine, seconds, theirs.dt) for engine in engines]
    warned = theirs.warnings
    contenders = [
        Contender(each.name, each.advance, STEPS_A_TURN, restart_every(TURNS_A_FALL, each.restart))
        for each in engines
    ]
    times = take_turns(contenders, rounds)
    rows = tuple(
        EngineRow(
            name=engine.name,
            sags=run.sags,
            speed=run.speed,
            min_ms=float(times[engine.name].min()),
            median_ms=float(np.median(times[engine.name])),
            samples=len(times[engine.name]),
            moments=() if engine is theirs else _distances(run, found[0]),
            method=engine.method,
        )
        for engine, run in zip(engines, found, strict=True)
    )
    first = ours[0].simulation
    sizes = len(first.positions), len(first.tets) if first.bodies else 0
    return ModelComparison(file, theirs.version, theirs.dt, seconds, *sizes, rows, warned, scenes[0].remarks)


class _Run(NamedTuple):
    """Positions (n, 3) at some times in [s], sags, and the final speed."""

    times: tuple[float, ...]
    places: tuple[Array, ...]
    sags: dict[str, float]
    speed: float


def _run(engine: _Ours | _Theirs, seconds: float, dt: float) -> _Run:
    steps = max(1, round(seconds / dt))
    marks = np.unique(np.linspace(0, steps, TIMES + 1).round().astype(int))[1:].tolist()
    engine.restart()
    start = {name: float(points[:, 2].min()) for name, points in engine.soft().items()}
    places, before = [], _all(engine)
    for step in range(1, steps + 1):
        if step == steps:
            before = _all(engine)
        engine.advance()
        if step in marks:
            places.append(_all(engine))
    moved = np.linalg.norm(places[-1] - before, axis=1).max(initial=0.0)
    sags = {name: start[name] - float(points[:, 2].min()) for name, points in engine.soft().items()}
    return _Run(tuple(mark * dt for mark in marks), tuple(places), sags, float(moved / dt))


def _all(engine: _Ours | _Theirs) -> Array:
    return np.concatenate([*engine.soft().values(), engine.rigid()])


def _distances(ours: _Run, theirs: _Run) -> tuple[Moment, ...]:
    moments = []
    for time, a, b in zip(ours.times, ours.places, theirs.places, strict=True):
        far = np.linalg.norm(a - b, axis=1)
        mean = float(np.sqrt((far**2).mean())) if len(far) else 0.0
        moments.append(Moment(time, float(far.max(initial=0.0)), mean))
    return tuple(moments)
