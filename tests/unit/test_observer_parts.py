"""The parts of the observer that know nothing of robots: belief, detection of jumps, thresholds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from softsim_core.base import SoftSimError
from softsim_core.control.observer import (
    WINDOWS,
    JumpDetector,
    ObserverSettings,
    StateEstimate,
    chi_square_limit,
    squared_distance,
)


def test_a_belief_after_many_measurements_is_the_least_squares_estimate() -> None:
    rng = np.random.default_rng(3)
    prior, noise = np.diag([0.3, 2.0, 1.0]) ** 2, np.diag([0.1, 0.2]) ** 2
    truth, belief = rng.standard_normal(3), StateEstimate(np.zeros(3), prior)
    information, score = np.linalg.inv(prior), np.zeros(3)
    for _ in range(40):
        rows = rng.standard_normal((2, 3))
        seen = rows @ truth + rng.standard_normal(2) * [0.1, 0.2]
        belief = belief.with_measurement(seen - rows @ belief.mean, rows, noise)
        information += rows.T @ np.linalg.inv(noise) @ rows
        score += rows.T @ np.linalg.inv(noise) @ seen
    assert belief.mean == pytest.approx(np.linalg.solve(information, score), abs=1e-12)
    assert belief.covariance == pytest.approx(np.linalg.inv(information), rel=1e-9, abs=1e-15)


def test_a_random_walk_seen_through_noise_has_the_variance_of_the_riccati_equation() -> None:
    belief, q, r = StateEstimate(np.zeros(1), np.eye(1)), 0.04, 0.5
    for _ in range(200):
        belief = belief.spread(np.array([q])).with_measurement(np.zeros(1), np.eye(1), r * np.eye(1))
    predicted = q / 2.0 + np.sqrt(q * q / 4.0 + q * r)  # the steady state, in closed form
    assert belief.covariance[0, 0] == pytest.approx(predicted * r / (predicted + r), rel=1e-9)


def test_what_is_pinned_stays_out_and_what_is_opened_is_independent() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((4, 4))
    belief = StateEstimate(rng.standard_normal(4), root @ root.T).with_fixed_unknowns(slice(2, 4))
    assert belief.deviation[2:] == pytest.approx(0.0)
    for _ in range(5):
        belief = belief.with_measurement(rng.standard_normal(2), rng.standard_normal((2, 4)), np.eye(2))
    assert belief.mean[2:] == pytest.approx(0.0)
    opened = belief.with_unknowns(slice(2, 4), np.array([1.0, 2.0]), 9.0 * np.eye(2))
    assert opened.mean[2:] == pytest.approx([1.0, 2.0])
    assert opened.covariance[2:, :2] == pytest.approx(0.0)
    assert opened.covariance[:2, :2] == pytest.approx(belief.covariance[:2, :2])


@pytest.mark.parametrize(("freedom", "chance"), [(1, 0.05), (6, 1e-9), (2400, 1e-9)])
def test_the_limit_of_a_chi_square_variable(freedom: int, chance: float) -> None:
    assert chi_square_limit(freedom, chance) == pytest.approx(chi2.isf(chance, freedom), rel=1e-9)


def test_jumps_are_found_when_they_must_be_and_not_without_one() -> None:
    rng = np.random.default_rng(7)
    rows = rng.standard_normal((4, 3))
    root = rng.standard_normal((4, 4))
    covariance = root @ root.T + np.eye(4)
    lower = np.linalg.cholesky(covariance)
    detector = JumpDetector(np.full(3, 5.0), false_alarms=1e-2)
    alarms = sum(
        detector.look(lower @ rng.standard_normal(4), rows, covariance) is not None for _ in range(4000)
    )
    assert alarms <= 40  # windows overlap: fewer than one in a hundred, as promised

    detector, jump = JumpDetector(np.full(3, 5.0), false_alarms=1e-6), np.array([1.2, -1.0, 0.8])
    jump *= np.sqrt(8.0 / squared_distance(rows @ jump, covariance))  # six steps add up to 48
    for _ in range(50):
        assert detector.look(lower @ rng.standard_normal(4), rows, covariance) is None
    for _ in range(WINDOWS[-1]):
        found = detector.look(rows @ jump + lower @ rng.standard_normal(4), rows, covariance)
        if found is not None:
            break
    assert found is not None
    assert squared_distance(found.mean - jump, found.covariance) < chi2.isf(1e-6, 3)


@pytest.mark.parametrize("wrong", [{"joint_offset": -1.0}, {"touch": 0.0}, {"latency": float("nan")}])
def test_settings_that_cannot_be_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(SoftSimError, match=f"observer.*{next(iter(wrong))}"):
        ObserverSettings(**wrong)
