"""How an equilibrium moves with commands and loads, against differences of equilibria."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import Array, IndexArray
from softsim_core.control.observer import field_rows, point_rows
from softsim_core.physics.mechanics import join_rows

SCENES = {
    "tripod": ([-1.2, -1.0, -1.4], 1e-4, 0.035),
    "cable_finger": ([0.006], 1e-5, 0.0),
    "pneu_finger": ([4e-7], 1e-9, 0.0),
}
"""Where the joints stand, by how much a command is moved, and where the bases are."""


def _watched(simulation: Simulation) -> tuple[IndexArray, Array]:
    """Two free nodes that are far apart, and a force on both in [N]."""
    free = simulation.model.free_nodes
    return free[[len(free) // 3, -1]], np.array([[0.6, -0.2, 0.3], [0.1, 0.4, -0.5]])


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.slow
def test_the_response_is_the_derivative_of_the_equilibrium(name: str) -> None:
    joints, step, shift = SCENES[name]
    simulation = Simulation(load_scene(name).robot_alone())
    simulation.settle(joints, shift)
    nodes, force = _watched(simulation)
    rows = join_rows([field_rows(nodes, force[None]), *(point_rows(nodes[[k]], np.ones(1)) for k in (0, 1))])
    response = simulation.static_response(rows)

    def difference(by: float, command: float) -> Array:
        simulation.forces = np.zeros_like(simulation.forces)
        simulation.forces[nodes] = by * force
        there = simulation.equilibrium(np.array(joints) + command * np.eye(len(joints))[0]).state
        return there.positions[nodes].ravel()

    by_command = (difference(0.0, step) - difference(0.0, -step)) / (2.0 * step)
    assert response.rows_by_command[1:, 0] == pytest.approx(
        by_command, rel=1e-3, abs=1e-3 * np.abs(by_command).max()
    )
    by_load = (difference(1e-3, 0.0) - difference(-1e-3, 0.0)) / 2e-3
    assert response.rows_by_row[1:, 0] == pytest.approx(by_load, rel=1e-3, abs=1e-3 * np.abs(by_load).max())
    assert response.rows_by_row[0, 0] == pytest.approx(force.ravel() @ by_load, rel=1e-3)  # Maxwell and Betti
    assert response.rows_by_row == pytest.approx(response.rows_by_row.T)


def test_a_displaced_simulation_stands_where_its_response_says() -> None:
    simulation = Simulation(load_scene("tripod").robot_alone())
    simulation.settle([-1.2, -1.2, -1.2], 0.035)
    free = simulation.model.free_nodes
    rows = join_rows(
        [
            field_rows(free[:1], np.eye(1, 3)[None]),
            *(point_rows(free[[k]], np.ones(1)) for k in range(len(free))),
        ]
    )
    response = simulation.static_response(rows)
    change = 0.02 * np.array([1.0, -0.5, 0.2])
    nodes = (response.rows_by_command[1:] @ change).reshape(-1, 3)
    simulation.displace(nodes, response.reduced_by_command @ change)
    shown = simulation.positions
    simulation.settle(np.array([-1.2, -1.2, -1.2]) + change)
    moved = np.abs(nodes).max()
    assert moved > 2e-4
    assert shown == pytest.approx(simulation.positions, abs=0.05 * moved)  # the regions' nodes, too
