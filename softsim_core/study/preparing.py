"""From a study's file to what its runs share, and to the plan of its store."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import ConfigError
from softsim_core.scene.catalog import code_folder
from softsim_core.scene.files import find_config
from softsim_core.scene.plain import sourced
from softsim_core.scene.programs import ProgramRule
from softsim_core.scene.yaml_source import relative_to_file
from softsim_core.simulation import Simulation
from softsim_core.study.description import StudyDescription, find_study, load_study
from softsim_core.study.identity import scene_hash, versions
from softsim_core.study.quantities import AXES, quantity
from softsim_core.study.single import Work, stride_of
from softsim_core.study.store import Column, Plan


@dataclass(frozen=True, slots=True)
class PreparedStudy:
    """A study that can be run.

    Attributes:
        file: Its file.
        work: What its runs share.
    """

    file: Path
    work: Work

    @property
    def study(self) -> StudyDescription:
        """The study."""
        return self.work.study

    def plan(self, runs: int, block: int, first: Sequence[float] | Array) -> Plan:
        """What the store of so many runs holds, told by the scene with the first values (p,).

        Compiles what is not compiled yet, so that no worker does.

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
            simulation.step()  # compiles, or takes from the cache
        return Plan(runs, block, tuple(columns), coordinates, self._attributes())

    def _attributes(self) -> dict[str, Any]:
        study, work = self.study, self.work
        told = {
            "study": sourced(study, None),
            "scene_sha256": scene_hash(work.unchanged(), tuple(dict.fromkeys(work.functions.values()))),
            "versions": versions(),
            "study_text": self.file.read_text(encoding="utf-8"),
            "title": study.about or study.name,
        }
        return dict(json.loads(json.dumps(told)))


def prepare_study(file: str | Path, code_folders: Iterable[str | Path] = ()) -> PreparedStudy:
    """A study that can be run.

    Args:
        file: Of the study, or the name of one that came with the suite.
        code_folders: Folders whose programs may run: Python scenes and functions, and xacro files of arms,
            outside the installation.

    Raises:
        ConfigError: any problem in the study or its scene, or code that may not run, in one sentence.
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
