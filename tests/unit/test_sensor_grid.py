"""How the cells of a tactile array share forces on a surface's vertices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from softsim_core.physics.sensing import grid_over, spread_over


@pytest.mark.parametrize("seed", range(4))
def test_every_force_is_shared_out_whole_and_as_shape_functions_are(seed: int) -> None:
    """Against points thrown at random on the triangles around a vertex."""
    rng = np.random.default_rng(seed)
    seen = rng.uniform(-0.03, 0.02, (25, 2))
    patch = Delaunay(seen).simplices.astype(np.int64)
    patch[::2] = patch[::2, ::-1]  # some turned away
    seen = np.concatenate([seen, rng.uniform(size=(3, 2))])  # of no triangle
    rows, columns = rng.integers(1, 9, 2).tolist()
    grid = grid_over(patch, seen, rows, columns)
    assert grid is not None
    shares = spread_over(patch, seen, grid).toarray() * grid.area
    np.testing.assert_allclose(shares.sum(axis=0), [1.0] * 25 + [0.0] * 3, rtol=1e-12)
    assert shares.min() >= 0.0

    vertex = int(rng.integers(25))
    around = patch[(patch == vertex).any(axis=1)]
    corners = seen[around]
    areas = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 2.0
    which = rng.choice(len(around), 40_000, p=areas / areas.sum())
    weights = rng.dirichlet(np.ones(3), len(which))
    places = np.einsum("qa,qai->qi", weights, corners[which])
    own = np.take_along_axis(weights, (around[which] == vertex).argmax(axis=1)[:, None], axis=1)[:, 0]
    thrown = np.bincount(grid.cell(places), own, minlength=rows * columns) / own.sum()
    np.testing.assert_allclose(shares[:, vertex], thrown, atol=0.03)


def test_cells_are_numbered_row_by_row_and_take_what_is_beside_them() -> None:
    square = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.2], [0.0, 0.2]])
    patch = np.array([[0, 1, 2], [0, 2, 3]])
    grid = grid_over(patch, square, 2, 4)
    assert grid is not None
    assert grid.area == pytest.approx(0.01)
    assert grid.cell(np.array([[0.05, 0.05], [0.35, 0.05], [0.05, 0.15], [9.0, 9.0]])).tolist() == [
        0,
        3,
        4,
        7,
    ]
    even = spread_over(patch, square, grid) @ np.array([1.0, 0.5, 1.0, 0.5])  # as even pressure loads corners
    np.testing.assert_allclose(even, 3.0 / 0.08, rtol=0.02)
    assert grid_over(patch, square * [1.0, 0.0], 2, 4) is None


def test_two_large_triangles_fill_a_fine_grid() -> None:
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    patch = np.array([[0, 1, 2], [0, 2, 3]])
    grid = grid_over(patch, square, 60, 60)
    assert grid is not None
    even = spread_over(patch, square, grid) @ np.array([1.0, 0.5, 1.0, 0.5])
    np.testing.assert_allclose(even, 3.0, rtol=0.1)
