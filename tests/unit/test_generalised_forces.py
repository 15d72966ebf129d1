"""Forces on nodes, gathered on frames and joints, are those that the matrix of their velocities gives."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.physics.dynamics import Unknowns, generalised_forces, jacobian


@pytest.mark.parametrize("name", ["tripod", "emio", "cable_gripper"])
def test_they_are_the_transposed_jacobian_s(name: str) -> None:
    simulation, random = Simulation(load_scene(name), backend="scipy"), np.random.default_rng(7)
    model, state = simulation.model, simulation._state
    state.joint_positions += random.uniform(-0.3, 0.3, len(state.joint_positions))
    model.displace(state, np.zeros((len(model.free_nodes), 3)), random.uniform(-0.3, 0.3, model.reduced_size))
    forces, at = random.normal(size=state.positions.shape), Unknowns(model)
    expected = jacobian(model, at, state).T @ forces.ravel()
    given = generalised_forces(model, at, state, forces)
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert np.abs(given[at.first_reduced :]).max() > 0.0
