"""The quadratic function nearest to known points, and its minimum."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.lab.study import quadratic_minimum


@pytest.mark.parametrize("size", [2, 3, 5])
@pytest.mark.parametrize("scale", [1e-15, 1.0, 1e200])
def test_the_minimum_of_a_quadratic_function_is_exact(size: int, scale: float) -> None:
    generator = np.random.default_rng(size)
    root, where = generator.normal(size=(size, size)), generator.uniform(0.3, 0.7, size)
    hessian = root @ root.T + 0.1 * np.eye(size)
    points = generator.uniform(0.0, 1.0, (4 * size * size, size))
    costs = scale * np.einsum("ni,ij,nj->n", points - where, hessian, points - where)
    assert quadratic_minimum(points, costs) == pytest.approx(where, abs=1e-6)


def test_none_is_made_up() -> None:
    points = np.random.default_rng(1).uniform(0.0, 1.0, (20, 2))
    assert quadratic_minimum(points[:6], points[:6, 0]) is None  # too few
    assert quadratic_minimum(points, np.ones(20)) is None  # flat
    assert quadratic_minimum(points, -((points - 0.5) ** 2).sum(axis=1)) is None  # a top
    assert quadratic_minimum(points, (points[:, 0] - 0.5) ** 2) is None  # a valley
    assert quadratic_minimum(points * [1.0, 0.0], points[:, 0]) is None  # on a line


def test_a_minimum_outside_is_brought_to_the_box() -> None:
    points = np.random.default_rng(2).uniform(0.0, 1.0, (20, 2))
    found = quadratic_minimum(points, ((points - [1.5, 0.4]) ** 2).sum(axis=1))
    assert found == pytest.approx([1.0, 0.4], abs=1e-9)
