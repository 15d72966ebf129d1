"""CMA-ES over a study: it finds the best, and a start that goes on draws the same generations again."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_files import fingerprint, written
from study_processes import children, kept, started, swept, until

from softsim_core.base import SoftSimError
from softsim_core.lab.study import DONE, OBJECTIVE, RAISED, Outcome, optimisation, prepare_study

pytest.importorskip("cma")

VARIABLES = [
    {"name": "a", "lower": 0.0, "upper": 1.0},
    {"name": "b", "lower": 1.0, "upper": 100.0, "spacing": "log"},
]
BOWL: dict[str, Any] = {
    "variables": VARIABLES,
    "overlay": {"gravity": ["= a", 0.0, "= -b"]},
    "measure": [{"name": "told", "of": "python", "function": "functions.py:gated"}],
    "objective": {"minimise": "= told + (a - 0.3)**2 + (b / 50 - 0.5)**2", "generations": 30, "seed": 4},
}


def search(folder: Path, **changes: Any) -> optimisation._Search:
    return optimisation._Search(prepare_study(written(folder, **{**BOWL, **changes}), [folder]))


def taught(found: optimisation._Search, generations: int) -> list[list[tuple[float, ...]]]:
    """The generations that it draws as it is told the objectives."""
    told = []
    for _ in range(generations):
        drawn = found.draw_generation()
        told.append(drawn)
        values = [
            found.score_outcome({"a": a, "b": b}, Outcome(DONE, "", {"told": np.asarray(1.0)}))
            for a, b in drawn
        ]
        found.learn(np.array([float(each.results[OBJECTIVE]) for each in values]))
    return told


def test_it_finds_the_bottom_and_draws_the_same_again(tmp_path: Path) -> None:
    before = np.random.get_state()[1].tolist()  # noqa: NPY002
    told = taught(search(tmp_path), 30)
    last = np.array(told[-1])
    assert last[:, 0] == pytest.approx(np.full(len(last), 0.3), abs=0.02)
    assert last[:, 1] == pytest.approx(np.full(len(last), 25.0), abs=1.0)
    assert told == taught(search(tmp_path), 30)
    assert told != taught(search(tmp_path, objective={**BOWL["objective"], "seed": 5}), 30)
    every = np.array([row for drawn in told for row in drawn])
    assert (every >= [0.0, 1.0]).all()
    assert (every <= [1.0, 100.0]).all()
    assert np.random.get_state()[1].tolist() == before  # noqa: NPY002


def best_of(found: optimisation._Search, runs: int, objective: Callable[[float, float], float]) -> float:
    """The least of an objective in so many runs."""
    costs: list[float] = []
    while len(costs) < runs and not found.reason():
        told = [objective(a, b) for a, b in found.draw_generation()]
        found.learn(np.array(told))
        costs += told
    return min(costs)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("scale", [1e-12, 1e-9, 1.0, 1e9])
def test_a_bowl_of_two_parameters_is_found_in_72_runs_at_any_scale(
    tmp_path: Path, seed: int, scale: float
) -> None:
    def steep(a: float, b: float) -> float:  # narrow in one direction, round in the other
        return scale * (8.0 + 1e4 * (a - 0.3) ** 2 + (10.0 * (b / 100.0 - 0.6)) ** 2)

    variables = [VARIABLES[0], {"name": "b", "lower": 0.0, "upper": 100.0}]
    found = search(tmp_path, variables=variables, objective={**BOWL["objective"], "seed": seed})
    assert best_of(found, 72, steep) == pytest.approx(8.0 * scale, rel=1e-3)


def test_a_generation_of_failed_runs_hides_no_small_objective(tmp_path: Path) -> None:
    found = search(tmp_path)
    for _ in range(30):
        drawn = found.draw_generation()
        costs = np.array([1e-12 * ((a - 0.3) ** 2 + (b / 50.0 - 0.5) ** 2) for a, b in drawn])
        costs[0] = np.nan
        found.learn(costs)
    assert np.array(drawn)[:, 0] == pytest.approx(np.full(len(drawn), 0.3), abs=0.02)


def test_the_most_is_the_least_of_the_opposite(tmp_path: Path) -> None:
    least = taught(search(tmp_path), 5)
    opposite = {**BOWL["objective"], "minimise": None}
    opposite["maximise"] = "= 0 - (told + (a - 0.3)**2 + (b / 50 - 0.5)**2)"
    del opposite["minimise"]
    assert taught(search(tmp_path, objective=opposite), 5) == least


def test_runs_that_fail_count_as_worse_than_the_worst(tmp_path: Path) -> None:
    found = search(tmp_path)
    failed = Outcome(RAISED, "it broke", {})
    assert found.score_outcome({"a": 0.0, "b": 1.0}, failed) == failed
    broken = search(tmp_path, objective={"minimise": "= told / (a - a)"})
    judged = broken.score_outcome({"a": 0.5, "b": 1.0}, Outcome(DONE, "", {"told": np.asarray(1.0)}))
    assert (judged.status, judged.results) == (RAISED, {})
    found.draw_generation()
    found.learn(np.full(found.population, np.nan))  # a generation of which nothing is known
    assert len(found.draw_generation()) == found.population


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"objective": None}, "objective: is missing"),
        (
            {
                "variables": VARIABLES[:1],
                "overlay": {"gravity": ["= a", 0, 0]},
                "objective": {"minimise": "= a"},
            },
            "CMA-ES needs two or more",
        ),
        ({"objective": {"minimise": "= a", "maximise": "= a"}}, "give exactly one"),
        ({"objective": {"minimise": "a"}}, "an expression"),
        ({"objective": {"minimise": "= a", "population": 3}}, "between 4 and"),
        ({"variables": [VARIABLES[0], {"name": "b", "values": [1.0]}]}, "needs lower and upper"),
    ],
)
def test_a_study_that_cannot_be_optimised_says_why(
    tmp_path: Path, changes: dict[str, Any], told: str
) -> None:
    with pytest.raises(SoftSimError) as refused:
        search(tmp_path, **changes)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_objective_is_of_numbers(tmp_path: Path) -> None:
    measure = [*BOWL["measure"], {"name": "tip", "of": "effector.position"}]
    found = search(tmp_path, measure=measure, objective={"minimise": "= tip + told"})
    with pytest.raises(SoftSimError, match="needs one number, and tip is several"):
        found.plan()


@pytest.mark.slow
@pytest.mark.exhaustive
def test_an_optimisation_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    objective = {**BOWL["objective"], "generations": 6}
    study = written(tmp_path, **{**BOWL, "objective": objective})
    client = started(study, tmp_path / "cut", "--workers", "2", verb="optimise")
    try:
        until(lambda: (tmp_path / "cut").exists() and kept(tmp_path / "cut") >= 15)
        below = children(client.pid)
        os.kill(client.pid, signal.SIGKILL)
        client.wait()
        until(lambda: not any(Path(f"/proc/{each}").exists() for each in below))
    finally:
        client.kill()
        client.wait()
        assert client.stderr is not None
        client.stderr.close()
    went_on = swept(study, tmp_path / "cut", "--workers", "2", "--json", verb="optimise")
    whole = swept(study, tmp_path / "whole", "--workers", "1", "--json", verb="optimise")
    assert whole.returncode == went_on.returncode == 0, went_on.stderr + whole.stderr
    assert fingerprint(tmp_path / "cut") == fingerprint(tmp_path / "whole")
    cut, told = json.loads(went_on.stdout), json.loads(whole.stdout)
    assert cut["new"] <= told["new"] - 15
    assert (cut["values"], cut["objective"]) == (told["values"], told["objective"])
    assert told["objective"] < 1.05
