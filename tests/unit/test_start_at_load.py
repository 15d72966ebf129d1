"""The start animation may begin with the scene, without a key."""

from __future__ import annotations

import pytest

from softsim_core import Simulation, load_scene


@pytest.mark.slow
def test_at_start_plays_the_start_animation_at_load_and_at_every_reset() -> None:
    asked = Simulation(load_scene("tripod", {"start": {"at_start": True}}), backend="scipy")
    by_key = Simulation(load_scene("tripod"), backend="scipy")
    by_key.start_animation()
    for _ in range(2):
        for simulation in (asked, by_key):
            for _ in range(25):
                simulation.step()
        assert asked.joint_positions == pytest.approx([-1.4965] * 3)
        assert asked.base_shift == pytest.approx(0.035)
        assert asked.positions.tobytes() == by_key.positions.tobytes()
        for simulation in (asked, by_key):
            simulation.reset()
        by_key.start_animation()
