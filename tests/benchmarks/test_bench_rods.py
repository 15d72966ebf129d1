"""The falling rod of `softsim bench --rods`: its errors, the order of the schemes, PyElastica's limit."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import rods


def test_the_error_is_taken_at_the_times_of_both() -> None:
    def line(count: int) -> np.ndarray:
        return np.linspace(0.0, 1.0, count + 1)[1:, None] * (1.0, 2.0, 3.0)

    assert rods.rms_error(line(40), line(1600)) == pytest.approx(0.0, abs=1e-12)
    assert rods.rms_error(line(40), line(50)) == pytest.approx(0.0, abs=1e-12)
    assert rods.rms_error(np.array([0.0, 3e-3, 4e-3]) + line(40), line(1600)) == pytest.approx(5.0)


@pytest.mark.parametrize(("scheme", "order"), [("Euler", 0.8), ("Bossak", 1.5), ("Bossak, iterated", 1.5)])
def test_schemes_converge_with_their_order(scheme: str, order: float) -> None:
    finest, fine, coarse = (rods.fall(10, dt, rods.SCHEMES[scheme])() for dt in (0.5e-3, 2e-3, 4e-3))
    assert np.log2(rods.rms_error(coarse, finest) / rods.rms_error(fine, finest)) > order


def test_the_motion_is_the_limit_of_pyelastica() -> None:
    """Its clamp holds its first element, so that its error halves with the elements."""
    if missing := rods.peer_missing():
        pytest.skip(missing)
    ours = rods.fall(rods.COUNTS[1], 1e-3, rods.SCHEMES["Bossak"])()
    coarse, fine = (rods.fall_of_peer(n, 4.0e-3 / n)() for n in (30, 60))
    off = [rods.rms_error(each, ours) for each in (coarse, fine, 2.0 * fine - coarse)]
    assert off[2] < 0.2 * off[1] < 0.2 * off[0]


def test_speeds_are_compared_at_equal_errors() -> None:
    def measured(scheme: str, elements: int, error: float, shortest: float) -> rods.Fall:
        return rods.Fall(scheme, elements, 1e-3, lambda: lambda: np.zeros((1, 3)), error, shortest, shortest)

    falls = [
        measured("Bossak", rods.COUNTS[0], 0.9, 0.1),
        measured("Bossak", rods.COUNTS[0], 1.1, 0.01),
        measured("Bossak", rods.COUNTS[1], 0.9, 0.02),
        measured(rods.PEER, rods.COUNTS[0], 5.0, 0.4),
    ]
    assert falls[0].speed == pytest.approx(rods.SECONDS / 0.1)
    assert rods.speed_ratio(falls, rods.COUNTS[0]) == pytest.approx(4.0)
    assert rods.speed_ratio(falls, rods.COUNTS[1]) == pytest.approx(20.0)
    assert np.isnan(rods.speed_ratio(falls[:3], rods.COUNTS[0]))
