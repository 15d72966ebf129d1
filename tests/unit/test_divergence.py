"""A non-finite or runaway state never leaves the simulation."""

from __future__ import annotations

import math

import pytest

from softsim_core import Simulation, load_scene
from softsim_core.errors import SolverDivergedError

BACKENDS = [pytest.param("numba", marks=pytest.mark.numba), "scipy"]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("force", [1e12, math.nan, math.inf])
def test_a_step_that_diverges_leaves_the_last_good_state(backend: str, force: float) -> None:
    if backend == "numba":
        pytest.importorskip("numba")
    simulation = Simulation(load_scene("tripod"), backend)
    simulation.command([-1.0, -1.0, -1.0])
    for _ in range(3):
        simulation.step()
    simulation.forces[5] = 0.01
    before = simulation.snapshot()
    simulation.forces[40, 1] = force
    with pytest.raises(SolverDivergedError, match=r"diverged at step 4 \(t = 0.040 s\), node \d+; reduce dt"):
        simulation.step()
    simulation.forces[40, 1] = 0.0
    assert simulation.joint_positions == pytest.approx([-0.105] * 3)
    simulation.step()
    after = simulation.snapshot()
    simulation.restore(before)
    simulation.step()
    assert simulation.snapshot() == after
