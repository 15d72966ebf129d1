"""Contacts of a box that soft fingers hold on a floor: redundant ones, which stick, slide and open."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.physics.contact import solve_contacts
from softsim_core.physics.contact.solver import ContactProblem, Smoothed, eliminate, project, steepness

DT, HALF = 0.01, 0.02
NONE = (np.zeros(0), np.zeros(0))
SIDES = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])


def held_box(fingers: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Compliance and free gaps of a box of 30 g on a floor: each corner found twice, six contacts a finger.

    A finger has twelve freedoms, fewer than its rows.
    """
    random = np.random.default_rng(seed)
    corners = np.array([[x, y, -HALF] for x in (-HALF, HALF) for y in (-HALF, HALF)])
    up = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    points, ways = [corners, corners + random.normal(0.0, 1e-9, (4, 3))], [np.tile(up, (8, 1, 1))]
    soft = np.zeros((24 + 18 * fingers, 24 + 18 * fingers))
    pressed = np.zeros((8 + 6 * fingers, 3))
    for k in range(fingers):
        side = SIDES[random.integers(5)]
        inward = -(side + random.normal(0.0, 0.1, 3))
        inward /= np.linalg.norm(inward)
        aside = np.cross(inward, [0.3, 0.5, 0.8])
        aside /= np.linalg.norm(aside)
        way = np.array([inward, aside, np.cross(inward, aside)])
        spread = random.normal(0.0, 0.003, (6, 3))
        spread -= np.outer(spread @ side, side)
        points.append(side * HALF + np.cross(side, random.normal(0.0, 0.008, 3)) + spread)
        ways.append(np.tile(way, (6, 1, 1)))
        nodes = np.einsum("ia,dx->idax", random.dirichlet(np.ones(4), 6), -way).reshape(18, 12)
        bends = random.normal(0.0, 0.02, (12, 12))
        moves = bends @ bends.T / 12 + np.kron(np.ones((4, 4)), np.diag(random.uniform(1e-3, 1e-2, 3)))
        rows = slice(24 + 18 * k, 42 + 18 * k)
        soft[rows, rows] = nodes @ moves @ nodes.T
        pressed[8 + 6 * k : 14 + 6 * k, 0] = random.uniform(2e-3, 3e-2) + random.normal(0.0, 2e-4, 6)
        pressed[8 + 6 * k : 14 + 6 * k, 1:] = random.normal(0.0, 2e-3, 2)
    way = np.concatenate(ways)
    turns = np.cross(np.concatenate(points)[:, None], way)
    rows = np.concatenate([way, turns], axis=2).reshape(-1, 6)
    rigid = DT**2 * rows @ np.diag([1 / 0.03] * 3 + [1 / 8e-6] * 3) @ rows.T
    speed = np.array([*random.normal(0.0, 0.02, 2), -0.1, *random.normal(0.0, 0.3, 3)])
    return rigid + soft, DT * rows @ speed - pressed.ravel()


@pytest.mark.parametrize("fingers", [2, 3, 4])
@pytest.mark.parametrize("friction", [0.0, 0.08, 0.3, 0.8])
def test_a_held_box_obeys_the_law_within_few_sweeps(fingers: int, friction: float) -> None:
    for seed in (0, 1, 21, 30, 35, 37, 38):  # from 21 on, sweeps and Newton's method alone get stuck
        compliance, gap = held_box(fingers, seed)
        solution = solve_contacts(compliance, gap, NONE, friction, np.zeros(len(gap)), 1000, 1e-8)
        assert solution.residual <= 1e-8
        assert solution.sweeps <= 120
        left = gap + compliance @ solution.forces
        assert left[::3].min() > -2e-8
        assert np.abs(left[::3] * solution.forces[::3]).max() < 1e-6  # [J]


@pytest.mark.parametrize("size", [1, 3, 4, 5, 8, 30])
def test_elimination_solves(size: int) -> None:
    random = np.random.default_rng(size)
    matrix, right = random.normal(size=(size, size)), random.normal(size=size)
    expected = np.linalg.solve(matrix, right)
    eliminate(matrix.copy(), right)
    np.testing.assert_allclose(right, expected, rtol=1e-9)


def test_elimination_leaves_out_what_nothing_decides() -> None:
    matrix, right = np.diag([2.0, 0.0, 4.0, 5.0, 8.0]), np.array([2.0, 0.0, 8.0, 5.0, 8.0])
    eliminate(matrix, right)
    np.testing.assert_array_equal(right, [1.0, 0.0, 2.0, 1.0, 1.0])


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_the_smoothed_projection_has_the_slope_that_it_tells(friction: float) -> None:
    random = np.random.default_rng(6)
    lower, upper = np.array([-np.inf, 0.0, -np.inf, -0.3]), np.array([np.inf, np.inf, 0.2, 0.3])
    rows, energy = 4 + 15, 1e-3
    compliance = np.diag(random.uniform(0.5, 2.0, rows))
    problem = ContactProblem(compliance, np.zeros(rows), lower, upper, np.full(5, friction))
    steep = steepness(problem)
    forces, gaps = random.normal(0.0, 0.3, rows), np.zeros(rows)  # without gaps only the forces are projected

    def projected(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        result, slope = np.zeros(rows), np.zeros((rows, 3))
        project(problem, steep, energy, at, gaps, Smoothed(result, slope))
        return result, slope

    _, slope = projected(forces)
    scale = np.ones(rows)
    if friction > 0.0:
        scale[4::3] = friction  # a cone is projected with its normal force times the friction
    for j in range(rows):
        step = np.zeros(rows)
        step[j] = 1e-6
        change = (projected(forces + step)[0] - projected(forces - step)[0]) / 2e-6
        expected = np.zeros(rows)
        first = j if j < 4 else j - (j - 4) % 3
        if j < 4 or friction == 0.0:
            expected[j] = slope[j, 0] if j < 4 or j == first else 0.0
        else:
            expected[first : first + 3] = (
                slope[first : first + 3, j - first] * scale[j] / scale[first : first + 3]
            )
        np.testing.assert_allclose(change, expected, atol=1e-7)


def test_what_the_smoothed_projection_keeps_has_force_times_gap() -> None:
    compliance, energy = np.diag([2.0, 2.0, 2.0]), 1e-4
    problem = ContactProblem(compliance, np.zeros(3), *NONE, np.array([0.5]))
    steep = steepness(problem)
    forces = np.array([0.1, 0.0, 0.0])
    gaps = np.array([energy / 0.1, 0.0, 0.0])
    result, slope = np.zeros(3), np.zeros((3, 3))
    assert project(problem, steep, energy, forces, gaps, Smoothed(result, slope)) < 1e-30
    np.testing.assert_allclose(result, forces, rtol=1e-12)
