"""Intervals of parameters where neighbouring rows err alike: beside many made measurements of a line."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.base import Array
from softsim_core.lab.identification import QUANTILE, neighbours, widening

ROWS, SIZE = 200, 3


def errors(seed: int, alike: float) -> Array:
    """Of unit variance; each row is so much like the one before it, shape (ROWS, SIZE)."""
    made = np.random.default_rng(seed).standard_normal((ROWS, SIZE))
    for k in range(1, ROWS):
        made[k] = alike * made[k - 1] + np.sqrt(1.0 - alike**2) * made[k]
    return made


def covered(alike: float) -> tuple[float, float]:
    """How often 95 % intervals of two parameters hold the truth: as told by slopes, and widened."""
    along = np.linspace(-1.0, 1.0, ROWS)
    slopes = np.repeat(np.column_stack([np.ones(ROWS), np.sin(2.0 * along)]), SIZE, axis=0)
    plain, wide = [], []
    for seed in range(400):
        made = errors(seed, alike).ravel()
        off = np.linalg.lstsq(slopes, made, rcond=None)[0]
        left = made - slopes @ off
        spread = np.sqrt(np.diagonal(np.linalg.inv(slopes.T @ slopes)) * (left @ left) / (len(left) - 2))
        plain.append(np.abs(off) < QUANTILE * spread)
        wider = widening(slopes, left, [(np.arange(ROWS), SIZE)])
        assert wider.min() >= 1.0
        wide.append(np.abs(off) < QUANTILE * wider * spread)
    return float(np.mean(plain)), float(np.mean(wide))


def test_independent_errors_are_left_as_they_are() -> None:
    plain, wide = covered(0.0)
    assert 0.93 < plain <= wide < 0.97


@pytest.mark.parametrize("alike", [0.6, 0.8])
def test_errors_that_are_alike_widen_intervals_to_nearly_what_they_are(alike: float) -> None:
    plain, wide = covered(alike)
    assert plain < 0.75
    assert 0.84 < wide < 0.97


def test_the_order_of_rows_is_that_given() -> None:
    made, slopes = errors(0, 0.9), np.ones((ROWS * SIZE, 1))
    mixed = np.random.default_rng(1).permutation(ROWS)
    told = widening(slopes, made.ravel(), [(np.arange(ROWS), SIZE)])
    assert told > 2.0
    assert widening(slopes, made[mixed].ravel(), [(np.argsort(mixed), SIZE)]) == pytest.approx(told)


def test_neighbours_are_counted_beyond_chance() -> None:
    assert neighbours(np.ones((8, 1))) == 2
    assert neighbours(np.zeros((8, 3))) == 0
    assert neighbours(errors(3, 0.0)) <= 1
