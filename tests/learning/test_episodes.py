"""A seeded episode's return is the same on every Python version, NumPy and machine, without Gymnasium."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("numba")

from softsim_core.learning.episodes import Episodes
from softsim_core.learning.tasks import TASKS

RETURNS = {"TripodReach-v0": -8.1918195, "TripodBalance-v0": 16.1716706, "CableGripperLift-v0": 1.6996004}
"""Of 20 random actions; the episode has the seed 3."""


@pytest.mark.parametrize("name", RETURNS)
def test_a_seeded_episode_gives_the_same_return_everywhere(name: str) -> None:
    episodes, random, first = Episodes(TASKS[name], 1), np.random.default_rng(5), np.array([0])
    episodes.generators[0] = np.random.default_rng(3)
    episodes.begin(first)
    total = 0.0
    for _ in range(20):
        _, done = episodes.act(first, random.uniform(-0.3, 0.3, (1, len(TASKS[name].low))))
        total += float(done.reward[0])
    assert total == pytest.approx(RETURNS[name], rel=1e-5)
