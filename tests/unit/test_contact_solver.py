"""Forces of contacts and bounded rows: known answers, and the contact law on random problems."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.physics.contact import solve_contacts

DT = 0.01
GRAVITY = 9.81
NONE = (np.zeros(0), np.zeros(0))


def standing_box(contacts: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Compliance and free gaps of a rigid box of 30 g on many contacts: far more rows than freedoms."""
    random = np.random.default_rng(seed)
    mass, inertia = 0.03, 8e-6
    ways = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    points = random.uniform(-0.02, 0.02, (contacts, 3))
    points[:, 2] = -0.02
    rows = np.concatenate(
        [np.broadcast_to(ways, (contacts, 3, 3)), np.cross(points[:, None], ways)], axis=2
    ).reshape(-1, 6)
    compliance = DT**2 * rows @ np.diag([1 / mass] * 3 + [1 / inertia] * 3) @ rows.T
    return compliance, DT * rows @ np.array([*random.normal(0.0, 0.05, 2), -0.12, 0.0, 0.0, 0.3])


def soft_patch(contacts: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Compliance and free gaps of contacts that share fewer soft freedoms."""
    random = np.random.default_rng(seed)
    moves = random.normal(0.0, 0.01, (3 * contacts, 3 * contacts // 2))
    return moves @ moves.T + 1e-7 * np.eye(3 * contacts), random.normal(0.0, 1e-3, 3 * contacts)


def assert_contact_law(forces: np.ndarray, gaps: np.ndarray, friction: float, tolerance: float) -> None:
    """Signorini and Coulomb, row by row; tolerance in [m]."""
    force, gap = forces.reshape(-1, 3), gaps.reshape(-1, 3)
    tangential, limit = np.linalg.norm(force[:, 1:], axis=1), friction * force[:, 0]
    assert (force[:, 0] >= 0.0).all()
    assert (tangential <= limit * (1.0 + 1e-14)).all()
    assert (gap[:, 0] >= -tolerance).all()
    assert (gap[force[:, 0] > 0.0, 0] <= tolerance).all()
    sticks = tangential < limit * (1.0 - 1e-9)
    assert (np.abs(gap[sticks, 1:]) <= tolerance).all()
    slides = ~sticks & (force[:, 0] > 0.0)
    slip = np.linalg.norm(gap[slides, 1:], axis=1)
    work = np.einsum("ki,ki->k", force[slides, 1:], gap[slides, 1:])
    np.testing.assert_allclose(work, -tangential[slides] * slip, atol=tolerance, rtol=1e-4)


@pytest.mark.parametrize(("slope", "slides"), [(0.26, False), (0.29, False), (0.30, True), (0.40, True)])
def test_a_block_slides_where_the_slope_is_steeper_than_the_friction(slope: float, slides: bool) -> None:
    mass, friction = 0.5, 0.3  # arctan 0.3 = 0.2915
    pull = mass * GRAVITY * np.array([-np.cos(slope), np.sin(slope), 0.0])
    compliance = DT**2 / mass * np.eye(3)
    solution = solve_contacts(compliance, compliance @ pull, NONE, friction, np.zeros(3), 100, 1e-15)
    normal = mass * GRAVITY * np.cos(slope)
    held = min(mass * GRAVITY * np.sin(slope), friction * normal)
    np.testing.assert_allclose(solution.forces, [normal, -held, 0.0], rtol=1e-12, atol=1e-15)
    assert solution.residual < 1e-15
    slip = (compliance @ (pull + solution.forces))[1]
    assert bool(slip > 1e-9) is slides


@pytest.mark.parametrize("problem", [standing_box, soft_patch])
@pytest.mark.parametrize("contacts", [1, 4, 30])
@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_random_contacts_obey_the_law(problem, contacts: int, friction: float, seed: int) -> None:
    compliance, gap = problem(contacts, seed)
    solution = solve_contacts(compliance, gap, NONE, friction, np.zeros(len(gap)), 1000, 1e-12)
    assert solution.residual < 1e-12
    assert_contact_law(solution.forces, gap + compliance @ solution.forces, friction, 1e-11)


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0])
def test_a_box_on_three_feet_in_a_line_stays_within_a_micrometre_of_the_law(friction: float) -> None:
    compliance, gap = standing_box(4, seed=3)
    solution = solve_contacts(compliance, gap, NONE, friction, np.zeros(len(gap)), 1000, 1e-12)
    assert solution.residual < 1e-6
    assert_contact_law(solution.forces, gap + compliance @ solution.forces, friction, 1e-6)


def test_a_resting_box_weighs_what_it_weighs() -> None:
    compliance, gap = standing_box(12, seed=1)
    gap = gap.reshape(-1, 3) * 0.0 + [-GRAVITY * DT**2, 0.0, 0.0]
    solution = solve_contacts(compliance, gap.ravel(), NONE, 0.5, np.zeros(36), 1000, 1e-14)
    assert solution.forces[::3].sum() == pytest.approx(0.03 * GRAVITY, rel=1e-6)


def test_open_contacts_get_no_force() -> None:
    compliance, gap = soft_patch(10, seed=2)
    gap[::3] = 1.0
    solution = solve_contacts(compliance, gap, NONE, 0.5, np.full(30, 0.1), 1000, 1e-12)
    assert not solution.forces.any()


def test_starting_from_the_solution_takes_no_sweep() -> None:
    compliance, gap = soft_patch(30, seed=3)
    first = solve_contacts(compliance, gap, NONE, 0.5, np.zeros(90), 1000, 1e-12)
    again = solve_contacts(compliance, gap, NONE, 0.5, first.forces, 1000, 2e-12)
    assert again.sweeps == 0
    np.testing.assert_allclose(again.forces, first.forces, rtol=1e-14)


@pytest.mark.parametrize(("lower", "upper"), [(-np.inf, np.inf), (0.0, np.inf), (0.0, 0.2), (0.1, 0.1)])
def test_bounded_rows_hold_their_gap_or_sit_at_a_bound(lower: float, upper: float) -> None:
    random = np.random.default_rng(4)
    moves = random.normal(0.0, 0.03, (2 + 24, 40))
    compliance, gap = moves @ moves.T, random.normal(0.0, 1e-2, 26)
    bounds = (np.full(2, lower), np.full(2, upper))
    solution = solve_contacts(compliance, gap, bounds, 0.4, np.zeros(26), 1000, 1e-12)
    assert solution.residual < 1e-12
    left = gap + compliance @ solution.forces
    assert_contact_law(solution.forces[2:], left[2:], 0.4, 1e-11)
    for force, off in zip(solution.forces[:2], left[:2], strict=True):
        assert lower <= force <= upper
        assert abs(off) < 1e-11 or (force == lower and off > 0.0) or (force == upper and off < 0.0)


def test_it_stops_at_the_given_number_of_sweeps_and_says_how_far_it_is() -> None:
    compliance, gap = standing_box(30, seed=5)
    solution = solve_contacts(compliance, gap, NONE, 0.5, np.zeros(90), 1, 0.0)
    assert solution.sweeps == 1
    assert np.isfinite(solution.residual)
    assert np.isfinite(solution.forces).all()


def test_no_rows_is_no_work() -> None:
    solution = solve_contacts(np.zeros((0, 0)), np.zeros(0), NONE, 0.5, np.zeros(0), 10, 1e-9)
    assert len(solution.forces) == 0
    assert solution.residual == 0.0


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_contact_of_two_held_things_is_left_alone(friction: float) -> None:
    """No force moves either side, so it takes none, and what else touches is solved as without it."""
    rest, gap = standing_box(8, 3)
    compliance = np.zeros((27, 27))
    compliance[3:, 3:] = rest
    alone = solve_contacts(rest, gap, NONE, friction, np.zeros(24), 1000, 1e-9)
    start = np.zeros(27)
    solution = solve_contacts(
        compliance, np.append([-1e-3, 1e-4, 0.0], gap), NONE, friction, start, 1000, 1e-9
    )
    np.testing.assert_array_equal(solution.forces[:3], 0.0)
    np.testing.assert_allclose(solution.forces[3:], alone.forces, rtol=0.0, atol=1e-9)
    assert solution.residual <= 1e-9
