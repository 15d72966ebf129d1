"""Coupled forces with bounds: every problem is solved, in both twins, and what has no answer says so."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from softsim_core.base import Array
from softsim_core.physics.linalg import bounded, solve_bounded

Problem = tuple[Array, Array, Array, Array]
Solve = Callable[[Array, Array, Array, Array], Array]


@pytest.fixture
def solve(backend: str) -> Solve:
    """solve_bounded, or its compiled twin."""
    if backend == "scipy":
        return solve_bounded
    from softsim_core.physics.dynamics.numba_backend import bounded_forces

    def compiled(compliance: Array, gap: Array, lower: Array, upper: Array) -> Array:
        forces = np.empty(len(gap))
        bounded_forces(compliance, gap, lower, upper, forces)
        return forces

    return compiled


def random_problem(random: np.random.Generator, worst_condition: float = 1e2) -> Problem:
    """One to ten forces; a third of the bounds infinite, some equal."""
    count = int(random.integers(1, 11))
    turn = np.linalg.qr(random.normal(size=(count, count)))[0]
    compliance = (turn * worst_condition ** -random.random(count)) @ turn.T
    spread = worst_condition ** (0.1 * random.normal(size=count))  # rows of different sizes
    compliance = spread[:, None] * (0.5 * (compliance + compliance.T)) * spread
    gap = spread * random.normal(size=count)
    size = np.abs(np.linalg.solve(compliance, gap)).max()
    lower = np.where(
        random.random(count) < 0.3, -np.inf, -size * random.random(count) * (random.random() < 0.7)
    )
    upper = np.where(random.random(count) < 0.3, np.inf, size * random.random(count))
    imposed = random.random(count) < 0.2
    lower[imposed] = upper[imposed] = 0.25 * size
    return compliance, gap, lower, upper


def violation(problem: Problem, forces: Array) -> float:
    """Largest violation of the conditions in shares of what adds up in the row."""
    compliance, gap, lower, upper = problem
    if not ((lower <= forces) & (forces <= upper)).all():
        return float("inf")
    rest = gap + compliance @ forces
    root = np.sqrt(np.diag(compliance))
    adds = np.abs(gap).max() + root * (root @ np.abs(forces))
    wrong = np.where(forces == lower, np.maximum(-rest, 0.0), np.abs(rest))
    wrong = np.where(forces == upper, np.maximum(rest, 0.0), wrong)
    return float(np.max(np.where(lower == upper, 0.0, wrong) / adds))


def by_trying_all(problem: Problem) -> Array:
    """The forces of the only set of held ones that meets the conditions."""
    compliance, gap, lower, upper = problem
    for places in itertools.product((-1, 0, 1), repeat=len(gap)):
        held = np.array(places) == 0
        forces = np.where(np.array(places) < 0, lower, upper)
        if not np.isfinite(forces[~held]).all():
            continue
        forces[held] = -np.linalg.solve(
            compliance[np.ix_(held, held)], gap[held] + compliance[np.ix_(held, ~held)] @ forces[~held]
        )
        if (lower <= forces).all() and (forces <= upper).all() and violation(problem, forces) < 1e-9:
            return forces
    raise AssertionError("no set meets the conditions")


@pytest.mark.slow
@pytest.mark.parametrize("condition", [1e2, 1e7, 1e12])
def test_every_random_problem_is_solved(solve: Solve, condition: float) -> None:
    random = np.random.default_rng(int(np.log10(condition)))
    for _ in range(8_000):
        problem = random_problem(random, condition)
        assert violation(problem, solve(*problem)) < bounded.SOLVED


@pytest.mark.parametrize("seed", [25, 61, 203, 543, 575, 784, 915])
def test_what_active_sets_run_in_circles_on_is_solved(solve: Solve, seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(3, 11))
    root = random.normal(size=(count, count))
    compliance, gap = root @ root.T + 0.01 * np.eye(count), random.normal(size=count)
    problem = (compliance, gap, -random.random(count), random.random(count))
    assert violation(problem, bounded._active_sets(*problem)) > 1e-3
    assert violation(problem, solve(*problem)) < 1e-12


def test_faces_alone_solve_every_problem() -> None:
    random = np.random.default_rng(7)
    for _ in range(1000):
        problem = random_problem(random, 1e6)
        assert violation(problem, bounded._faces(*problem)) < 1e-10


def test_forces_are_those_of_the_only_set_that_holds(solve: Solve) -> None:
    random = np.random.default_rng(11)
    tried = 0
    while tried < 60:
        problem = random_problem(random)
        if len(problem[1]) > 5:
            continue
        tried += 1
        expected = by_trying_all(problem)
        assert solve(*problem) == pytest.approx(expected, rel=1e-8, abs=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("copies", [2, 3])
def test_cables_beside_each_other_share_a_bounded_load(solve: Solve, copies: int) -> None:
    compliance, gap = np.full((copies, copies), 0.01), np.full(copies, -0.01)
    forces = solve(compliance, gap, np.zeros(copies), np.full(copies, 5.0))
    assert forces.sum() == pytest.approx(1.0)
    gap[0] = -0.02  # they want different lengths: one goes to its bound
    forces = solve(compliance, gap, np.zeros(copies), np.full(copies, 5.0))
    assert forces[0] == pytest.approx(2.0)
    assert forces[1:] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("compliance", "gap"),
    [
        ([[1.0, 0.5], [0.5, 1.0]], [np.nan, 1.0]),
        ([[1.0, np.inf], [np.inf, 1.0]], [1.0, 1.0]),
    ],
)
def test_what_has_no_answer_is_not_a_number(
    solve: Solve, compliance: list[list[float]], gap: list[float]
) -> None:
    no_bound = np.full(2, np.inf)
    assert np.isnan(solve(np.array(compliance), np.array(gap), -no_bound, no_bound)).all()


def test_no_forces_need_no_solving(solve: Solve) -> None:
    assert solve(np.zeros((0, 0)), np.zeros(0), np.zeros(0), np.zeros(0)).shape == (0,)
