"""Preparation of a study: from its file to the values of its runs and the plan of its store."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from softsim_core.base import Array, ConfigError, SceneError
from softsim_core.lab.study.description import (
    MOST_RUNS,
    StudyDescription,
    VariableDescription,
    find_study,
    load_study,
)
from softsim_core.lab.study.quantities import AXES, quantity
from softsim_core.lab.study.single import Work, stride_of
from softsim_core.lab.study.store import Column, Plan, scene_hash, versions
from softsim_core.scene.io import ProgramRule, code_folder, find_config, mark_source, relative_to_file
from softsim_core.simulation import Simulation


def values_of_runs(study: StudyDescription) -> Array:
    """Return the variables of each run, shape (runs, p); the same study gives the same values.

    Raises:
        SceneError: the variables do not fit the kind of design, or there are too many runs.
    """
    variables, design = study.variables, study.design
    owner = f"study {study.name}: design {design.kind}"
    if design.kind == "grid":
        levels = [_levels(each, owner) for each in variables]
        count = int(np.prod([float(len(each)) for each in levels]))
        if count > MOST_RUNS:
            raise SceneError(f"{owner}: {count} runs are more than {MOST_RUNS}; take fewer values")
        return np.array(list(product(*levels)), dtype=float)
    if design.kind == "list":
        lengths = {each.name: len(each.values) for each in variables}
        if len(set(lengths.values())) > 1 or 0 in lengths.values():
            raise SceneError(f"{owner}: every variable needs values, as many as the others, not {lengths}")
        return np.array([each.values for each in variables], dtype=float).T
    assert design.samples is not None
    for each in variables:
        if each.lower is None:
            raise SceneError(f"{owner}: variable {each.name} needs lower and upper")
    shares = _shares(design.kind, len(variables), design.samples, design.seed)
    values = np.array(
        [[each.between(share) for each, share in zip(variables, row, strict=True)] for row in shares.tolist()]
    )
    if study.posterior is not None:
        values[:, : len(study.posterior.names)] = study.posterior.draw(design.samples, design.seed)
    return values


def _levels(variable: VariableDescription, owner: str) -> list[float]:
    if variable.values:
        return list(variable.values)
    if variable.count is None:
        raise SceneError(f"{owner}: variable {variable.name} needs values, or count beside its bounds")
    return [variable.between(k / (variable.count - 1)) for k in range(variable.count)]


def _shares(kind: str, dimensions: int, samples: int, seed: int) -> Array:
    """Return points of the unit box, shape (samples, dimensions)."""
    if kind == "random":
        return np.random.default_rng(seed).random((samples, dimensions))
    if kind == "latin_hypercube":
        return np.asarray(qmc.LatinHypercube(dimensions, seed=seed).random(samples))
    exponent = max(0, (samples - 1).bit_length())  # the first points of a balanced set
    return np.asarray(qmc.Sobol(dimensions, seed=seed).random_base2(exponent)[:samples])


@dataclass(frozen=True, slots=True)
class PreparedStudy:
    """A study that can be run.

    Attributes:
        file: Its file.
        work: Common data of its runs.
    """

    file: Path
    work: Work

    @property
    def study(self) -> StudyDescription:
        """The study."""
        return self.work.study

    def plan(self, runs: int, block: int, first: Sequence[float] | Array) -> Plan:
        """Return the plan of a store with `runs` runs, determined by the scene with the first values (p,).

        It compiles all kernels, so that no worker does.

        Raises:
            SoftSimError: that scene cannot be built, or has no such quantities.
        """
        study, work = self.study, self.work
        simulation = Simulation(work.robot(first))
        dt, steps = simulation.dt, 0 if study.duration is None else round(study.duration / simulation.dt)
        columns = [
            Column(each.name, each.unit, about=f"variable {each.name}", is_variable=True)
            for each in study.variables
        ]
        coordinates: dict[str, tuple[Array, str]] = {}
        strides = {stride_of(each, dt) for each in study.measure if each.at == "series"}
        for each in study.measure:
            found = quantity(each, simulation, work.function(each))
            shape = found.shape if found.shape is not None else np.shape(found.read(simulation))
            dimensions = tuple(f"{each.name}_{k}" for k in range(len(shape)))
            if shape == (3,):
                dimensions = ("axis",)
                coordinates["axis"] = np.array(AXES), ""
            if each.at == "series":
                stride = stride_of(each, dt)
                time = "time" if len(strides) == 1 else f"time_{stride}"
                at = dt * np.arange(0, steps + 1, stride)
                coordinates[time] = np.asarray(at, dtype=float), "s"
                dimensions, shape = (time, *dimensions), (len(at), *shape)
            about = f"{each.of if each.function is None else each.function} at {each.at}"
            columns.append(Column(each.name, found.unit, shape, dimensions, about))
        if study.duration is not None:
            simulation.step()  # compiles, or loads from the cache
        attributes = {
            "study": mark_source(study, None),
            "scene_sha256": scene_hash(work.load_unchanged(), tuple(dict.fromkeys(work.functions.values()))),
            "versions": versions(),
            "study_text": self.file.read_text(encoding="utf-8"),
            "title": study.about or study.name,
        }
        return Plan(runs, block, tuple(columns), coordinates, json.loads(json.dumps(attributes)))


def prepare_study(file: str | Path, code_folders: Iterable[str | Path] = ()) -> PreparedStudy:
    """Load a study and prepare its runs.

    Args:
        file: File of the study, or the name of one that came with the suite.
        code_folders: Folders whose programs may run: Python scenes and functions, and xacro files of arms,
            outside the installation.

    Raises:
        ConfigError: any problem in the study or its scene, or code that may not run, as one message.
    """
    path = find_study(file)
    study = load_study(path)
    programs = ProgramRule(tuple(code_folder(each) for each in code_folders))
    beside = relative_to_file(study.scene, path)
    scene = find_config(beside if beside.is_file() else study.scene).resolve()
    functions = {
        each.function: relative_to_file(f"{each.function.partition('.py:')[0]}.py", path).resolve()
        for each in study.measure
        if each.function
    }
    for code in (scene, *functions.values()):
        if not programs.allows(code):
            raise ConfigError(
                path, "", f"{code} is code that would run; allow it: --allow-code {code.parent}"
            )
    for code in functions.values():
        if not code.is_file():
            raise ConfigError(path, "measure", f"no such file {code}")
    if study.arguments and scene.suffix != ".py":
        raise ConfigError(path, "arguments", f"are for Python scenes, and {scene.name} is none; use overlay")
    return PreparedStudy(path, Work(study, scene, functions, programs))
