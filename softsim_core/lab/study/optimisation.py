"""Optimisation of a study's variables by CMA-ES, and quadratic fits through its results.

One run of each generation is the minimum of a quadratic function fitted to the best runs so far, so smooth
objectives need few generations. Where no quadratic function fits, the strategy continues alone.

The state of the strategy is not stored: it follows from the seed and from the results of the runs in the
store. A continued optimisation draws the same generations again and uses the known results.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.base import Array, ConfigError, SceneError, StudyError, install_command
from softsim_core.lab.identification import evaluate_expression, names_in
from softsim_core.lab.study.cluster import Engine, StudySummary, SweepOptions, engine, run_into, summary_of
from softsim_core.lab.study.preparing import PreparedStudy
from softsim_core.lab.study.single import DONE, RAISED, Outcome
from softsim_core.lab.study.store import Column, Plan, Store

_LEAST_CURVATURE = 1e-9  # least reliable curvature of a minimum, as a part of that in the steepest direction


def quadratic_minimum(points: Array, costs: Array) -> Array | None:
    r"""Return the minimum within the unit box of :math:`c + g^T x + x^T H x / 2`, fitted to the best points.

    Args:
        points: Points in the unit box, shape (n, p).
        costs: Finite costs, shape (n,).

    Returns:
        The minimum of the fit, shape (p,); None: there are too few points, or the fit has no minimum.
    """
    size = points.shape[1]
    needed = (size + 1) * (size + 2) // 2
    best = np.argsort(costs, kind="stable")[: 2 * needed]
    if len(best) <= needed:
        return None
    points, costs = points[best], costs[best]
    extent, rise = np.ptp(points, axis=0), np.ptp(costs)
    if not ((extent > 0.0).all() and 0.0 < rise < np.inf):
        return None
    scaled = (points - points[0]) / extent
    rows, columns = np.triu_indices(size)
    terms = np.column_stack([np.ones(len(scaled)), scaled, scaled[:, rows] * scaled[:, columns]])
    found, _, rank, _ = np.linalg.lstsq(terms, (costs - costs[0]) / rise, rcond=None)
    if rank < needed:
        return None
    hessian = np.zeros((size, size))
    hessian[rows, columns] = found[size + 1 :]
    hessian += hessian.T
    curvatures = np.linalg.eigvalsh(hessian)
    if not curvatures[0] > _LEAST_CURVATURE * curvatures[-1]:
        return None
    minimum: Array = points[0] + extent * np.linalg.solve(hessian, -found[1 : size + 1])
    return minimum.clip(0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class ResponseSurface:
    """A fitted surface over p variables.

    Attributes:
        lower, upper: Range of each variable, shape (p,).
        terms: Scaled variables that each coefficient multiplies: none, one or two of them.
        coefficients: One per term, in the unit of the quantity.
        share: Part of the results' variance that the surface explains, at most 1.
    """

    lower: Array
    upper: Array
    terms: tuple[tuple[int, ...], ...]
    coefficients: Array
    share: float

    def __call__(self, points: Array) -> Array:
        """Return values at points (k, p) in the units of the variables, shape (k,)."""
        return np.asarray(
            _columns(_normalise_points(points, self.lower, self.upper), self.terms) @ self.coefficients
        )

    def plain(self) -> dict[str, Any]:
        """Return the surface as plain data."""
        return {
            "lower": self.lower.tolist(),
            "upper": self.upper.tolist(),
            "terms": [list(each) for each in self.terms],
            "coefficients": self.coefficients.tolist(),
            "share": self.share,
        }


def response_surface(points: Array, values: Array) -> ResponseSurface:
    """Fit a surface to results by least squares; with few results, or few levels, one of lower degree.

    The points (k, p) have a range along each variable, the values (k,) of the quantity are finite.
    """
    count, size = points.shape
    lower, upper = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    scaled = _normalise_points(points, lower, upper)
    levels = [len(np.unique(scaled[:, k])) for k in range(size)]
    terms: list[tuple[int, ...]] = [(), *((k,) for k in range(size))]
    squares = list(combinations_with_replacement(range(size), 2))
    whole = [*terms, *(each for each in squares if each[0] != each[1] or levels[each[0]] > 2)]
    chosen = tuple(whole if count >= len(whole) else terms if count >= len(terms) else [()])
    columns = _columns(scaled, chosen)
    coefficients = np.linalg.lstsq(columns, values, rcond=None)[0]
    spread = float(((values - values.mean()) ** 2).sum())
    left = float(((values - columns @ coefficients) ** 2).sum())
    share = 1.0 - left / spread if spread > 0.0 else 1.0
    return ResponseSurface(lower, upper, chosen, coefficients, share)


def _normalise_points(points: Array, lower: Array, upper: Array) -> Array:
    return np.asarray(2.0 * (points - lower) / (upper - lower) - 1.0)


def _columns(scaled: Array, terms: tuple[tuple[int, ...], ...]) -> Array:
    return np.stack([scaled[:, list(each)].prod(axis=1) for each in terms], axis=1)


OBJECTIVE = "objective"
"""Name of the objective's array in the store."""


@dataclass(frozen=True, slots=True)
class Optimum:
    """Result of an optimisation.

    Attributes:
        summary: Summary of its runs.
        run: Number of the best run.
        objective: Objective of this run.
        values: Variables of this run by name.
        generations: Number of generations.
        ended: Reason for the end.
    """

    summary: StudySummary
    run: int
    objective: float
    values: Mapping[str, float]
    generations: int
    ended: str


def optimise(prepared: PreparedStudy, folder: Path, options: SweepOptions | None = None) -> Optimum:
    """Run generations of a study with an objective into its store, and continue earlier ones, to an optimum.

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
            drawn = search.draw_generation()
            left = [number for number in numbers if store.status[number] == 0]
            if left:
                cluster = cluster or stack.enter_context(engine(options.where))
                tasks = [(number, drawn[number - numbers.start]) for number in left]
                run_into(store, cluster, prepared.work, tasks, options, search.score_outcome)
            search.learn(store.values(OBJECTIVE)[numbers.start : numbers.stop])
            if reason := search.reason():
                ended = reason
                break
        summary, sign = summary_of(store, begun - len(store.left)), search.objective.sign
        costs = sign * store.values(OBJECTIVE)
        if not np.isfinite(costs).any():
            raise StudyError(
                f"{store.folder}: no run gave an objective; look at the errors: {summary.first_errors}"
            )
        run = int(np.nanargmin(costs))
        values = {name: float(store.values(name)[run]) for name in prepared.work.names}
        return Optimum(summary, run, float(sign * costs[run]), values, generation + 1, ended)


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
            "seed": math.nan,  # use only the generator; NumPy's global seed stays as it is
            "verbose": -9,
            "tolfun": 0.0,  # absolute tolerances end at once if all objectives are small
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
        """Return the plan of the store: a generation is a block."""
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

    def draw_generation(self) -> list[tuple[float, ...]]:
        """Return values of the next generation's variables."""
        minimum = quadratic_minimum(self._points, self._costs)
        if minimum is not None:
            self._strategy.inject([minimum], force=True)
        self._drawn = self._strategy.ask()
        return [
            tuple(each.between(float(share)) for each, share in zip(self.study.variables, row, strict=True))
            for row in self._drawn
        ]

    def score_outcome(self, values: Mapping[str, float], outcome: Outcome) -> Outcome:
        """Return an outcome with its objective."""
        if outcome.status != DONE:
            return outcome
        scalars = {name: float(each) for name, each in outcome.results.items() if each.shape == ()}
        try:
            found = evaluate_expression(self.objective.expression, {**values, **scalars})
        except SceneError as error:
            return Outcome(RAISED, str(error), {})
        return replace(outcome, results={**outcome.results, OBJECTIVE: np.asarray(found)})

    def learn(self, objectives: Array) -> None:
        """Pass the generation's results to the strategy; failed runs count as worse than the worst."""
        costs = self.objective.sign * objectives
        good = np.isfinite(costs)
        finite = costs[good]
        self._points = np.vstack([self._points, np.asarray(self._drawn)[good]])
        self._costs = np.append(self._costs, finite)
        worst = float(finite.max() + (np.ptp(finite) or abs(finite.max()) or 1.0)) if len(finite) else 1.0
        self._strategy.tell(self._drawn, np.where(np.isfinite(costs), costs, worst).tolist())

    def reason(self) -> str:
        """Return the reason to stop; empty: continue."""
        stops = dict(self._strategy.stop())
        return f"CMA-ES sees no more to gain ({', '.join(stops)})" if stops else ""
