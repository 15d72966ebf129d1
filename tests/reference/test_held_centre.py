"""The silicone held at its centre moves as in the reference simulator, node by node, step by step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference_scenes import from_reference, held_centre

from softsim_core import Simulation
from softsim_core.base import Backend
from softsim_core.physics.dynamics import solve_static
from softsim_core.physics.mechanics import Control

pytestmark = [pytest.mark.reference, pytest.mark.filterwarnings("ignore:body silicone")]

TOLERANCE = 1e-9
"""In [m]; seen: 4e-12. The reference holds its nodes by springs of 1e12 mN/mm, which give by 1e-12 m."""


@pytest.mark.parametrize(
    ("level", "backend"),
    [
        pytest.param("low", "numba", marks=pytest.mark.numba),
        pytest.param("mid", "numba", marks=[pytest.mark.numba, pytest.mark.slow]),
        pytest.param("low", "scipy", marks=pytest.mark.slow),
        pytest.param("mid", "scipy", marks=pytest.mark.exhaustive),
    ],
)
def test_every_snapshot_of_the_fall(reference_dir: Path, level: str, backend: Backend) -> None:
    results = np.load(reference_dir / "simulator" / f"held_centre_{level}.npz")
    sim = Simulation(held_centre(reference_dir, level), backend=backend)
    snapshots = dict(zip(results["snap_steps"].tolist(), results["snapshots"], strict=True))
    assert sorted(snapshots) == [1, 2, 5, 10, 20, 30, 50, 100]
    for step in range(1, 101):
        sim.step()
        lowest = 1e-3 * results["min_y_history"][step - 1]
        assert sim.positions[:, 2].min() == pytest.approx(lowest, abs=TOLERANCE)
        if step in snapshots:
            np.testing.assert_allclose(sim.positions, from_reference(snapshots[step]), rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("level", ["low", "mid"])
@pytest.mark.slow
def test_pose_after_five_seconds(reference_dir: Path, level: str) -> None:
    results = np.load(reference_dir / "simulator" / f"held_centre_{level}.npz")
    sim = Simulation(held_centre(reference_dir, level))
    for _ in range(500):
        sim.step()
    np.testing.assert_allclose(sim.positions, from_reference(results["position_5s"]), rtol=0, atol=TOLERANCE)


def test_statics_give_the_pose_in_which_the_reference_comes_to_rest(reference_dir: Path) -> None:
    results = np.load(reference_dir / "simulator" / "held_centre_low.npz")
    sim = Simulation(held_centre(reference_dir, "low"), backend="scipy")
    solution = solve_static(
        sim.model, sim.model.rest_state(), Control(np.zeros(0), sim.forces), sim.parameters
    )
    expected = from_reference(results["position_5s"])
    np.testing.assert_allclose(solution.state.positions, expected, rtol=0, atol=TOLERANCE)
