"""Conjugate gradients in panels without fill against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

from softsim_core.physics.linalg import (  # noqa: E402  # noqa: E402
    LANES,
    ROWS,
    Matrix,
    Preconditioner,
    Sharing,
    conjugate_gradients,
    copy_matrix,
    divide_tree,
    empty_factor,
    factor,
    matrix_layout,
    matrix_of,
    multiply,
    open_agenda,
    plan,
    precondition,
    sharing_of,
    tree_of,
)
from softsim_core.physics.mechanics import rotation_exp  # noqa: E402


def problem(seed: int, count: int = 60) -> tuple[Matrix, Preconditioner, Sharing, np.ndarray]:
    """A random positive matrix of a random graph in panels, its factor, its parts, and the matrix itself.

    Odd seeds divide its tree.
    """
    rng = np.random.default_rng(seed)
    edges = rng.integers(0, count, size=(4 * count, 2))
    layout = plan(count, edges, edges[:0], 0, LANES, ROWS)
    own = matrix_layout(layout.position, edges, edges[:0], 0, LANES)
    dense = np.zeros((3 * count, 3 * count))
    placed = layout.position[edges]
    for a, b in placed[placed[:, 0] != placed[:, 1]]:
        block = rng.normal(size=(3, 3))
        dense[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += block
        dense[3 * b : 3 * b + 3, 3 * a : 3 * a + 3] += block.T
    dense += np.diag(np.abs(dense).sum(axis=1) + rng.uniform(0.01, 1.0, size=3 * count))
    matrix = matrix_of(np.zeros(own.panel[-1]), own)
    for i in range(count):
        columns = [(i, 0)]
        for e in range(matrix.start[i], matrix.start[i + 1]):
            columns.append((matrix.node[e], matrix.later[i] + 3 * (e - matrix.start[i])))
        for j, column in columns:
            for k in range(3):
                at = matrix.row[i] + k * matrix.width[i] + column
                matrix.panels[at : at + 3] = dense[3 * i + k, 3 * j : 3 * j + 3]
    tree, store = tree_of(layout), empty_factor(layout, 0, np.float32)
    supernode = layout.supernode[np.argsort(layout.position)]
    copy_matrix(matrix, tree, supernode, store.panels)
    factor(tree, store)
    widest = int(layout.width.max()) + ROWS
    rotations = np.broadcast_to(np.eye(3), (count, 3, 3)).copy()
    by = Preconditioner(
        tree, store.panels, rotations, np.zeros(3 * count, np.float32), np.zeros(widest, np.float32)
    )
    sharing = sharing_of(divide_tree(layout, 0.0 if seed % 2 else np.inf), 3 * count)
    return matrix, by, sharing, dense


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.slow
def test_the_product_is_that_of_the_dense_matrix(seed: int) -> None:
    matrix, by, sharing, dense = problem(seed)
    p, q = sharing.work[2:]
    for _ in range(2):  # nothing is left of one in the next
        p[:] = np.random.default_rng(seed).normal(size=len(dense))
        multiply(matrix, by, sharing, open_agenda())
        assert np.allclose(q, dense @ p, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.slow
def test_the_preconditioner_is_the_turned_inverse(seed: int) -> None:
    matrix, by, sharing, dense = problem(seed)
    rng = np.random.default_rng(seed)
    for rotation in by.rotations:
        rotation[:] = rotation_exp(rng.normal(size=3))
    turn = np.zeros_like(dense)
    for n, rotation in enumerate(by.rotations):
        turn[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] = rotation
    r, z = sharing.work[:2]
    r[:] = 1e-30 * rng.normal(size=len(dense))
    precondition(matrix, by, sharing, 1e-30, open_agenda())
    wanted = turn @ np.linalg.solve(dense, turn.T @ r)
    assert np.abs(z - wanted).max() < 1e-5 * np.abs(wanted).max()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.slow
def test_a_poor_preconditioner_costs_iterations_but_no_accuracy(seed: int) -> None:
    matrix, by, sharing, dense = problem(seed)
    rng = np.random.default_rng(seed)
    b, x = rng.normal(size=len(dense)), np.zeros(len(dense))
    few = conjugate_gradients(matrix, by, sharing, b, x, 1e-12, 0.0, 100, open_agenda())
    assert np.abs(x - np.linalg.solve(dense, b)).max() < 1e-11
    for rotation in by.rotations:
        rotation[:] = rotation_exp(0.5 * rng.normal(size=3))
    many = conjugate_gradients(matrix, by, sharing, b, x, 1e-12, 0.0, 200, open_agenda())
    assert 0 < few < many
    assert np.abs(x - np.linalg.solve(dense, b)).max() < 1e-11


def test_what_cannot_be_solved_is_told() -> None:
    matrix, by, sharing, dense = problem(0)
    b, x = np.ones(len(dense)), np.zeros(len(dense))
    by.rotations[:] = rotation_exp(np.array([0.4, -0.3, 0.6]))
    assert conjugate_gradients(matrix, by, sharing, b, x, 1e-12, 0.0, 1, open_agenda()) == -1
    assert conjugate_gradients(matrix, by, sharing, 0.0 * b, x, 1e-12, 0.0, 9, open_agenda()) == 0
    assert not x.any()
    assert conjugate_gradients(matrix, by, sharing, np.nan * b, x, 1e-12, 0.0, 9, open_agenda()) == -2
    matrix.panels[:] *= -1.0
    assert conjugate_gradients(matrix, by, sharing, b, x, 1e-12, 0.0, 9, open_agenda()) == -2
