"""All registered linear solvers give the same answers on the same matrices, and say the same about them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from softsim_core.base import Array, FactorisationError, SceneError
from softsim_core.physics.linalg import (
    AUTO,
    Factoriser,
    Factors,
    SuperLU,
    choose_linear_solver,
    linear_solver_names,
    register_linear_solver,
)

SOLVERS = [pytest.param("supernodal", marks=pytest.mark.numba), "superlu"]
"""Each registered one: a newcomer belongs here too."""

REGISTERED = linear_solver_names()
"""Those of the package: examples that run later add theirs."""

SIZES = [(1, 0), (4, 0), (20, 5), (60, 1), (0, 6), (90, 12)]
"""Nodes, and dense unknowns behind them."""


@pytest.fixture(params=SOLVERS)
def solver(request: pytest.FixtureRequest) -> str:
    if request.param == "supernodal":
        pytest.importorskip("numba")
    return str(request.param)


def test_every_registered_solver_is_tested() -> None:
    assert set(REGISTERED) == {"supernodal", "iterative", "superlu"}


def random_matrix(nodes: int, dense: int, rng: np.random.Generator, scalars: int = 0) -> sp.csc_matrix:
    """Positive definite, as of elements of four nodes each: 3 x 3 blocks, and dense unknowns at the end.

    `scalars` unknowns without a node stand between both.
    """
    size = 3 * nodes + scalars + dense
    total = sp.lil_matrix((size, size))
    total.setdiag(10.0 ** rng.uniform(-2.0, 2.0, size))
    for _ in range(2 * nodes):
        corner = int(rng.integers(nodes))
        corners = np.unique(np.minimum(corner + rng.integers(0, 6, 4), nodes - 1))
        dofs = (3 * corners[:, None] + np.arange(3)).ravel()
        if dense and rng.random() < 0.3:
            dofs = np.append(dofs, size - 1 - rng.integers(dense))
        if scalars:
            dofs = np.append(dofs, 3 * nodes + rng.integers(scalars))
        factor = rng.normal(size=(len(dofs), 3))
        total[np.ix_(dofs, dofs)] += factor @ factor.T
    if dense:
        factor = rng.normal(size=(dense, dense))
        total[size - dense :, size - dense :] += factor @ factor.T
    return total.tocsc()


def answers(solver: str, matrix: sp.csc_matrix, dense: int = 0) -> Factors:
    return Factoriser(choose_linear_solver(solver), dense).factor(matrix)


def assert_close(found: Array, expected: Array, share: float = 1e-9) -> None:
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=share * max(1e-300, np.abs(expected).max(initial=0))
    )


@pytest.mark.parametrize(("nodes", "dense"), SIZES)
@pytest.mark.parametrize("scalars", [0, 1, 2])
@pytest.mark.slow
def test_solve_and_schur_agree_with_dense_algebra(solver: str, nodes: int, dense: int, scalars: int) -> None:
    rng = np.random.default_rng(100 * nodes + dense)
    matrix = random_matrix(nodes, dense, rng, scalars)
    whole, size = matrix.toarray(), matrix.shape[0]
    factors = answers(solver, matrix, dense)
    assert factors.positive
    for right in (rng.normal(size=size), rng.normal(size=(size, 1)), rng.normal(size=(size, 11))):
        solved = factors.solve(right)
        assert solved.shape == right.shape
        assert_close(solved, np.linalg.solve(whole, right))
    for rows in (
        rng.normal(size=(9, size)),
        sp.random(7, size, 0.05, format="csr", random_state=rng),
        sp.csr_matrix((1, size)),
        np.zeros((0, size)),
    ):
        plain = rows.toarray() if sp.issparse(rows) else rows
        assert_close(factors.schur(rows), plain @ np.linalg.solve(whole, plain.T))


def test_a_plan_is_used_again_for_other_values_and_made_anew_for_another_pattern(
    solver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    matrix = random_matrix(15, 3, rng)
    chosen, plans = choose_linear_solver(solver), []
    made = type(chosen).plan
    monkeypatch.setattr(type(chosen), "plan", lambda self, p: plans.append(p) or made(self, p))
    factoriser = Factoriser(chosen, 3)
    right = rng.normal(size=matrix.shape[0])
    for scale in (1.0, 7.0, 0.1):
        assert_close(
            factoriser.factor(scale * matrix).solve(right), np.linalg.solve(scale * matrix.toarray(), right)
        )
    assert len(plans) == 1
    other = random_matrix(15, 3, rng)
    assert_close(factoriser.factor(other).solve(right), np.linalg.solve(other.toarray(), right))
    assert len(plans) == 2


@pytest.mark.parametrize("where", ["sparse", "dense"])
def test_indefinite_matrices_are_found_not_positive_and_solved(solver: str, where: str) -> None:
    rng = np.random.default_rng(5)
    matrix = random_matrix(20, 4, rng)
    place = 30 if where == "sparse" else matrix.shape[0] - 2
    matrix[place, place] -= 1e4
    factors = answers(solver, matrix, 4)
    assert not factors.positive
    right = rng.normal(size=matrix.shape[0])
    assert_close(factors.solve(right), np.linalg.solve(matrix.toarray(), right))
    factoriser = Factoriser(choose_linear_solver(solver), 4)  # and a plan recovers
    assert not factoriser.factor(matrix).positive
    matrix[place, place] += 1e4
    assert factoriser.factor(matrix).positive


@pytest.mark.parametrize("where", ["sparse", "dense"])
def test_singular_and_infinite_matrices_raise_the_typed_error(solver: str, where: str) -> None:
    rng = np.random.default_rng(6)
    matrix = random_matrix(10, 3, rng).tolil()
    place = 12 if where == "sparse" else matrix.shape[0] - 1
    matrix[place, :] = 0.0
    matrix[:, place] = 0.0
    matrix[place, place] = 1.0
    empty = matrix.tocsc()
    empty[place, place] = 0.0
    with pytest.raises(FactorisationError, match="the matrix has no factors"):
        answers(solver, empty, 3)
    for value in (np.nan, np.inf):
        matrix[place, place] = value
        with pytest.raises(FactorisationError, match="not finite"):
            answers(solver, matrix.tocsc(), 3)


def test_names() -> None:
    assert choose_linear_solver(AUTO).name in linear_solver_names()
    with pytest.raises(
        SceneError, match="unknown linear solver 'none'; known: supernodal, iterative, superlu"
    ):
        choose_linear_solver("none")
    with pytest.raises(SceneError, match="linear solver 'superlu' is the package's own"):
        register_linear_solver(SuperLU())


def test_a_scene_chooses_by_name(solver: str, small: Any) -> None:
    from softsim_core import Simulation

    plain, other = Simulation(small(AUTO), "scipy"), Simulation(small(solver), "scipy")
    for simulation in (plain, other):
        for _ in range(5):
            simulation.step()
        assert simulation.report.positive
    np.testing.assert_allclose(other.positions, plain.positions, rtol=0, atol=1e-8)  # contact is iterated
    joints = plain.joint_positions + np.array([0.05, 0.001])
    assert_close(other.equilibrium(joints).state.positions, plain.equilibrium(joints).state.positions)
    assert_close(other.reduced_stiffness(), plain.reduced_stiffness(), 1e-6)  # of the two states above


def test_a_wrong_choice_is_refused_in_a_sentence(small: Any) -> None:
    from softsim_core import Simulation

    with pytest.raises(SceneError, match="linear_solver must be one of auto, supernodal, iterative, superlu"):
        small("quick")
    with pytest.raises(SceneError, match="backend numba is one with the linear solver supernodal"):
        Simulation(small("superlu"), "numba")


@pytest.fixture
def small() -> Any:
    from dataclasses import replace

    from softsim_core.simulation import touching_scene

    def make(name: str) -> Any:
        scene = touching_scene()
        return replace(scene, solver=replace(scene.solver, linear_solver=name))

    return make
