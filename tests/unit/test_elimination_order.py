"""Elimination orders of graphs, what they cost, and wide panels that are factored in blocks."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softsim_core.base import IndexArray
from softsim_core.physics.linalg import Factoriser, choose_linear_solver
from softsim_core.physics.mesh import box_mesh

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

from softsim_core.physics.linalg import (  # noqa: E402
    FITS,
    LEAF,
    cholesky,
    column_counts,
    elimination_order,
    elimination_tree,
    factor_cost,
    graph_of,
    minimum_degree,
    nested_dissection,
    postorder,
)


def mesh_edges(tets: IndexArray) -> IndexArray:
    return np.concatenate([tets[:, list(pair)] for pair in itertools.combinations(range(4), 2)])


def random_edges(count: int, many: int, seed: int) -> IndexArray:
    return np.random.default_rng(seed).integers(0, count, (many, 2))


GRAPHS = {
    "empty": (0, np.zeros((0, 2), np.int64)),
    "one": (1, np.zeros((0, 2), np.int64)),
    "no edges": (300, np.zeros((0, 2), np.int64)),
    "path": (400, np.stack([np.arange(399), np.arange(1, 400)], axis=1)),
    "complete": (LEAF + 30, np.array(list(itertools.combinations(range(LEAF + 30), 2)))),
    "apart": (500, np.concatenate([random_edges(250, 700, 0), 250 + random_edges(250, 700, 1)])),
    "random": (600, random_edges(600, 1200, 2)),
    "star": (500, np.stack([np.zeros(499, np.int64), np.arange(1, 500)], axis=1)),
    "box": (512, mesh_edges(box_mesh((1.0, 1.0, 1.0), (7, 7, 7)).tets)),
}


@pytest.mark.parametrize("name", GRAPHS)
def test_dissection_orders_every_node_once_and_always_alike(name: str) -> None:
    graph = graph_of(*GRAPHS[name])
    order = nested_dissection(*graph)
    assert np.array_equal(np.sort(order), np.arange(GRAPHS[name][0]))
    assert np.array_equal(order, nested_dissection(*graph))


@pytest.mark.parametrize("seed", range(4))
def test_column_counts_are_those_of_elimination_by_hand(seed: int) -> None:
    count = 40
    graph = graph_of(count, random_edges(count, 70, seed))
    order = np.random.default_rng(seed).permutation(count)
    joined = np.zeros((count, count), dtype=bool)
    for node in range(count):
        joined[node, graph[1][graph[0][node] : graph[0][node + 1]]] = True
    joined = joined[np.ix_(order, order)]
    for j in range(count):
        later = j + 1 + np.flatnonzero(joined[j, j + 1 :])
        joined[np.ix_(later, later)] = True
    expected = np.triu(joined, 1)
    parent = elimination_tree(*graph, order)
    assert np.array_equal(column_counts(*graph, order, parent), expected.sum(axis=1))
    assert np.array_equal(parent, np.where(expected.any(axis=1), expected.argmax(axis=1), -1))
    places = np.argsort(postorder(parent))
    assert (places[parent[parent >= 0]] > places[parent >= 0]).all()


def test_dissection_costs_less_than_minimum_degree_on_a_solid_body() -> None:
    mesh = box_mesh((1.0, 1.0, 1.0), (13, 13, 13))
    graph = graph_of(len(mesh.points), mesh_edges(mesh.tets))
    dissected, greedy = nested_dissection(*graph), minimum_degree(graph)
    assert factor_cost(graph, dissected)[0] < 0.7 * factor_cost(graph, greedy)[0]
    assert np.array_equal(elimination_order(graph), dissected)


def test_the_cheaper_order_is_taken() -> None:
    graph = graph_of(*GRAPHS["star"])
    cheapest = min(
        factor_cost(graph, order)[0] for order in (nested_dissection(*graph), minimum_degree(graph))
    )
    assert factor_cost(graph, elimination_order(graph))[0] == cheapest


def solid_matrix(cells: int) -> sp.csc_matrix:
    """Positive definite with the pattern of a box of cubes, shape (3 n, 3 n)."""
    mesh, rng = box_mesh((1.0, 1.0, 1.0), (cells,) * 3), np.random.default_rng(3)
    unknowns = (3 * mesh.tets[:, :, None] + np.arange(3)).reshape(-1, 12)
    factors = rng.normal(size=(len(mesh.tets), 12, 4))
    blocks, size = factors @ factors.swapaxes(1, 2), 3 * len(mesh.points)
    places = (np.repeat(unknowns, 12, axis=1).ravel(), np.tile(unknowns, (1, 12)).ravel())
    return (sp.coo_matrix((blocks.ravel(), places), (size, size)) + sp.diags(np.ones(size))).tocsc()


@pytest.mark.slow
@pytest.mark.parametrize(
    "columns", [cholesky.BLOCK - 1, cholesky.BLOCK, 2 * cholesky.BLOCK + 5, 3 * cholesky.BLOCK + 64]
)
def test_wide_panels_agree_with_dense_algebra(columns: int) -> None:
    rng = np.random.default_rng(columns)
    size = columns + 300  # one panel for all that is coupled to all, and a border of dense unknowns
    factor = rng.normal(size=(size, size))
    matrix = factor @ factor.T + size * np.eye(size)
    assert columns * size > FITS
    factors = Factoriser(choose_linear_solver("supernodal"), size - columns).factor(sp.csc_matrix(matrix))
    right = rng.normal(size=(size, 3))
    assert factors.positive
    np.testing.assert_allclose(factors.solve(right), np.linalg.solve(matrix, right), rtol=0, atol=1e-13)
    for many in (9, 150):
        rows = rng.normal(size=(many, size))
        np.testing.assert_allclose(factors.schur(rows), rows @ np.linalg.solve(matrix, rows.T), atol=1e-11)


def test_the_compliance_of_a_whole_face_is_that_of_superlu() -> None:
    matrix = solid_matrix(9)
    face = 3 * np.flatnonzero(box_mesh((1.0, 1.0, 1.0), (9, 9, 9)).points[:, 2] == 0.0)
    places = (face[:, None] + np.arange(3)).ravel()
    rows = sp.csr_matrix(
        (np.ones(len(places)), (np.arange(len(places)), places)), (len(places), matrix.shape[0])
    )
    found, expected = (
        Factoriser(choose_linear_solver(name)).factor(matrix).schur(rows)
        for name in ("supernodal", "superlu")
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_solid_body_is_solved_as_by_superlu_to_the_same_bits_every_time() -> None:
    matrix = solid_matrix(11)
    right = np.random.default_rng(4).normal(size=(matrix.shape[0], 2))
    first, second = (Factoriser(choose_linear_solver("supernodal")).factor(matrix) for _ in range(2))
    assert first.positive
    solved = first.solve(right)
    expected = splu(matrix).solve(right)
    np.testing.assert_allclose(solved, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert np.array_equal(solved, second.solve(right))


def test_a_pivot_below_zero_in_a_wide_panel_is_reported() -> None:
    rng = np.random.default_rng(6)
    size = 3 * cholesky.BLOCK
    factor = rng.normal(size=(size, size))
    matrix = factor @ factor.T + size * np.eye(size)
    matrix[size // 2, size // 2] -= 10.0 * size
    factors = Factoriser(choose_linear_solver("supernodal")).factor(sp.csc_matrix(matrix))
    assert not factors.positive
    right = rng.normal(size=size)
    np.testing.assert_allclose(factors.solve(right), np.linalg.solve(matrix, right), rtol=0, atol=1e-8)
