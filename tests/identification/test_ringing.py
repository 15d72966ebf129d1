"""Frequency and damping of a known swing, and none where nothing swings."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.lab.identification import ringing

TIMES = np.arange(0.0, 3.0, 0.01)


@pytest.mark.parametrize(("frequency", "ratio"), [(7.7, 0.05), (4.3, 0.06), (2.0, 0.15), (12.0, 0.01)])
def test_a_known_swing_is_told(frequency: float, ratio: float) -> None:
    turns = 2.0 * np.pi * frequency
    decay = turns * ratio / np.sqrt(1.0 - ratio**2)
    swing = 8e-3 * np.exp(-decay * TIMES) * np.cos(turns * TIMES + 0.4) + 1e-3 * np.exp(-TIMES / 0.8)
    places = np.outer(swing, [0.2, 0.0, -1.0]) + np.array([0.1, 0.2, 0.3])
    places += np.random.default_rng(5).normal(0.0, 5e-5, places.shape)
    told = ringing(TIMES, places)
    assert told is not None
    assert told.frequency == pytest.approx(frequency, rel=5e-3)
    assert told.damping == pytest.approx(ratio, rel=0.05)


@pytest.mark.parametrize("what", ["noise", "creep", "still", "few"])
def test_what_does_not_swing_has_none(what: str) -> None:
    places = {
        "noise": np.random.default_rng(1).normal(size=(300, 3)),
        "creep": np.outer(np.exp(-TIMES), [1.0, 0.0, 0.0]),
        "still": np.ones((300, 3)),
        "few": np.outer(np.cos(20.0 * TIMES), [1.0, 0.0, 0.0])[:30],
    }[what]
    assert ringing(TIMES[: len(places)], places) is None
