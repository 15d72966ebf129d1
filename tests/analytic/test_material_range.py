"""The Tripod stays sound over the whole range of Young modulus that its tuning offers."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene


@pytest.mark.parametrize("young_modulus", [10.0e3, 50.0e3, 2000.0e3])
def test_the_tripod_moves_with_any_material(young_modulus: float, backend: str) -> None:
    simulation = Simulation(load_scene("tripod"), backend=backend)  # type: ignore[arg-type]
    simulation.start_animation()
    for step in range(150):
        if step == 50:
            simulation.set_material("silicone", young_modulus=young_modulus)
        if step == 100:
            simulation.command([-0.785, -1.4965, -1.0])
        simulation.step()
    rest = np.abs(simulation.model.rest).max()
    assert np.abs(simulation.positions).max() < 2.0 * rest
    assert np.linalg.norm(simulation.velocities, axis=1).max() < 5.0
