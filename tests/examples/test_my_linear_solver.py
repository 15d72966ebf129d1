"""The example of a linear solver: its scene moves, and rests, as with the suite's own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.scene import RobotDescription

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "my_linear_solver.py"


def scenes() -> tuple[RobotDescription, RobotDescription]:
    """With the example's solver, and with the default."""
    own = load_scene(EXAMPLE)
    solver = replace(own.scene.solver, linear_solver="auto")
    return own, replace(own, scene=replace(own.scene, solver=solver))


@pytest.mark.slow
def test_the_scene_moves_as_with_the_default() -> None:
    own, default = (Simulation(scene, "scipy") for scene in scenes())
    assert own.scene.solver.linear_solver == "dense_cholesky"
    for _ in range(40):
        for simulation in (own, default):
            simulation.step()
        np.testing.assert_allclose(own.positions, default.positions, rtol=0, atol=1e-8 * 0.1)
    assert own.report.positive
    assert np.abs(own.positions - own.model.rest).max() > 1e-3


def test_statics_use_it_too_and_agree() -> None:
    own, default = (Simulation(scene).equilibrium([]) for scene in scenes())
    np.testing.assert_allclose(own.state.positions, default.state.positions, rtol=0, atol=1e-8 * 0.1)


def test_it_is_the_plain_step_that_runs_it_and_a_second_load_replaces_it() -> None:
    own, _ = scenes()
    scenes()
    assert Simulation(own).backend == "scipy"


def test_it_is_short() -> None:
    assert len(EXAMPLE.read_text().splitlines()) <= 80
