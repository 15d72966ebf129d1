"""The values of a study's variables at which its objective is best, by CMA-ES, on the engine of sweeps.

One run of each generation is the minimum of a quadratic function that is fitted to the best runs so far:
smooth objectives are found in few generations, and the strategy goes its way where none fits.

The strategy is not kept anywhere: its state follows from the seed and from what runs gave, and these lie in
the store. A start that goes on has it draw the same generations again, and hands it what is known.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import ConfigError, SceneError, StudyError
from softsim_core.extras import install_command
from softsim_core.identification.expressions import evaluated, names_in
from softsim_core.study.engine import Engine, Task, engine
from softsim_core.study.preparing import PreparedStudy
from softsim_core.study.quadratic import quadratic_minimum
from softsim_core.study.single import DONE, RAISED, Outcome
from softsim_core.study.store import Column, Plan, Store
from softsim_core.study.sweep import StudySummary, SweepOptions, summary_of

OBJECTIVE = "objective"
"""Name of its array in the store."""


@dataclass(frozen=True, slots=True)
class Optimum:
    """What an optimisation found.

    Attributes:
        summary: What became of its runs.
        run: Number of the best.
        objective: Its objective.
        values: Its variables by name.
        generations: How many were run.
        ended: Why no more were.
    """

    summary: StudySummary
    run: int
    objective: float
    values: Mapping[str, float]
    generations: int
    ended: str


def optimise(prepared: PreparedStudy, folder: Path, options: SweepOptions | None = None) -> Optimum:
    """Run generations of a study until its objective is found, going on where an earlier start ended.

    Args:
        prepared: The study, with an objective.
        folder: Its store.
        options: How its runs are done.

    Raises:
        StudyError: as `sweep`; cma is not installed, or no run gave results.
        ConfigError: the study has no objective, or one variable only.
    """
    options = SweepOptions() if options is None else options
    search = _Search(prepared)
    with Store(folder, search.plan()) as store, contextlib.ExitStack() as stack:
        begun = len(store.left)
        cluster: Engine | None = None
        ended = f"all {search.objective.generations} generations are done"
        generation = 0
        for generation in range(search.objective.generations):
            numbers = range(generation * search.population, (generation + 1) * search.population)
            drawn = search.drawn()
            left = [number for number in numbers if store.status[number] == 0]
            if left:
                cluster = cluster or stack.enter_context(engine(options.where))
                tasks: list[Task] = [(number, drawn[number - numbers.start]) for number in left]
                _run(store, cluster, search, tasks, options)
            search.learn(store.values(OBJECTIVE)[numbers.start : numbers.stop])
            if reason := search.reason():
                ended = reason
                break
        return _best(store, search, summary_of(store, begun - len(store.left)), generation + 1, ended)


class _Search:
    """CMA-ES over the unit box of the variables."""

    def __init__(self, prepared: PreparedStudy) -> None:
        study = prepared.study
        if study.objective is None:
            raise ConfigError(prepared.file, "objective", "is missing; say what to minimise or maximise")
        if len(study.variables) < 2:
            raise ConfigError(prepared.file, "variables", "CMA-ES needs two or more; sweep a single one")
        self.prepared, self.study, self.objective = prepared, study, study.objective
        size = len(study.variables)
        self.population = study.objective.population or 4 + math.floor(3.0 * math.log(size))
        try:
            self._cma = importlib.import_module("cma")
        except ImportError as error:
            raise StudyError(f"optimising needs cma: {install_command('study')}") from error
        generator = np.random.default_rng(study.objective.seed)
        settings = {
            "bounds": [[0.0] * size, [1.0] * size],
            "popsize": self.population,
            "randn": lambda *shape: generator.standard_normal(shape),
            "seed": math.nan,  # the generator's alone; NumPy's global one stays as it is
            "verbose": -9,
            "tolfun": 0.0,  # absolute ones end at once where all objectives are small
            "tolfunhist": 0.0,
            "tolfunrel": 1e-9,
            "tolx": 1e-4,
        }
        with contextlib.redirect_stdout(io.StringIO()):
            self._strategy: Any = self._cma.CMAEvolutionStrategy(
                size * [0.5], study.objective.spread, settings
            )
        self._drawn: list[Array] = []
        self._points, self._costs = np.empty((0, size)), np.empty(0)

    def plan(self) -> Plan:
        """Of the store: a generation is a block."""
        middle = [each.between(0.5) for each in self.study.variables]
        plan = self.prepared.plan(self.objective.generations * self.population, self.population, middle)
        shapes = {each.name: each.shape for each in plan.columns}
        for name in names_in(self.objective.expression):
            if shapes[name]:
                raise SceneError(
                    f"study {self.study.name}: the objective needs one number, and {name} is several"
                )
        column = Column(OBJECTIVE, "", about=self.objective.expression)
        versions = {**plan.attributes["versions"], "cma": str(self._cma.__version__)}
        return replace(
            plan, columns=(*plan.columns, column), attributes={**plan.attributes, "versions": versions}
        )

    def drawn(self) -> list[tuple[float, ...]]:
        """Values of the next generation's variables."""
        minimum = quadratic_minimum(self._points, self._costs)
        if minimum is not None:
            self._strategy.inject([minimum], force=True)
        self._drawn = self._strategy.ask()
        return [
            tuple(each.between(float(share)) for each, share in zip(self.study.variables, row, strict=True))
            for row in self._drawn
        ]

    def judged(self, values: Mapping[str, float], outcome: Outcome) -> Outcome:
        """An outcome with its objective."""
        if outcome.status != DONE:
            return outcome
        told = {name: float(each) for name, each in outcome.results.items() if each.shape == ()}
        try:
            found = evaluated(self.objective.expression, {**values, **told})
        except SceneError as error:
            return Outcome(RAISED, str(error), {})
        return replace(outcome, results={**outcome.results, OBJECTIVE: np.asarray(found)})

    def learn(self, objectives: Array) -> None:
        """Take in what the generation gave; runs that failed count as worse than the worst."""
        costs = self.objective.sign * objectives
        good = np.isfinite(costs)
        known = costs[good]
        self._points = np.vstack([self._points, np.asarray(self._drawn)[good]])
        self._costs = np.append(self._costs, known)
        worst = float(known.max() + (np.ptp(known) or abs(known.max()) or 1.0)) if len(known) else 1.0
        self._strategy.tell(self._drawn, np.where(np.isfinite(costs), costs, worst).tolist())

    def reason(self) -> str:
        """Why it need not go on; empty: it should."""
        stops = dict(self._strategy.stop())
        return f"CMA-ES sees no more to gain ({', '.join(stops)})" if stops else ""


def _run(store: Store, cluster: Engine, search: _Search, tasks: list[Task], options: SweepOptions) -> None:
    names, total = search.prepared.work.names, len(store.status)
    for number, values, outcome in cluster.run(search.prepared.work, tasks, options.recorded(total)):
        named = dict(zip(names, values, strict=True))
        store.add(number, named, search.judged(named, outcome))
        options.progress(total - len(store.left), int((store.status > DONE).sum()), total)


def _best(store: Store, search: _Search, summary: StudySummary, generations: int, ended: str) -> Optimum:
    costs = search.objective.sign * store.values(OBJECTIVE)
    if not np.isfinite(costs).any():
        raise StudyError(
            f"{store.folder}: no run gave an objective; look at the errors: {summary.first_errors}"
        )
    run = int(np.nanargmin(costs))
    values = {name: float(store.values(name)[run]) for name in search.prepared.work.names}
    return Optimum(summary, run, float(search.objective.sign * costs[run]), values, generations, ended)
