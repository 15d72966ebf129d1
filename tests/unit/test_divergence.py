"""A non-finite or runaway state never leaves the simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from softsim_core import Simulation, load_scene
from softsim_core.base import FactorisationError, SolverDivergedError
from softsim_core.scene import Controller
from softsim_core.simulation import small_scene

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


def test_a_singular_matrix_is_divergence_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    """A body without mass and stiffness: the factorisation fails, and its error is the cause."""
    simulation = Simulation(load_scene("tripod"), "scipy")
    size = 3 * len(simulation.positions)
    nothing = sp.csr_matrix((size, size))
    monkeypatch.setattr(
        "softsim_core.physics.dynamics.scipy_backend.node_stiffness", lambda *_, **__: nothing
    )
    object.__setattr__(simulation.model, "mass", 0.0 * simulation.model.mass)
    with pytest.raises(SolverDivergedError) as caught:
        simulation.step()
    assert isinstance(caught.value.__cause__, FactorisationError)


@pytest.mark.parametrize("place", ["controller", "step"])
def test_somebodys_mistake_is_not_called_divergence(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def mistaken(*_: object, **__: object) -> None:
        raise RuntimeError("my own mistake")

    scene = load_scene("tripod")
    if place == "controller":
        scene = replace(scene, controllers=(Controller(on_begin=mistaken),))
    simulation = Simulation(scene, "scipy")
    before = simulation.snapshot()
    if place == "step":
        monkeypatch.setattr("softsim_core.physics.dynamics.scipy_backend.node_stiffness", mistaken)
    with pytest.raises(RuntimeError, match="my own mistake"):
        simulation.step()
    assert simulation.positions.tobytes() in before


def test_the_report_counts_what_is_inside_out(backend: str) -> None:
    simulation = Simulation(small_scene(), backend)  # type: ignore[arg-type]
    simulation.step()
    assert simulation.report.inverted == 0
    assert simulation.report.positive
    nodes = simulation.model.free_nodes
    rng = np.random.default_rng(3)
    simulation._state.positions[nodes] = rng.uniform(-0.01, 0.01, (len(nodes), 3))
    simulation.step()
    corners, rest = simulation.positions[simulation.tets], simulation.model.rest[simulation.tets]
    volumes, sizes = (np.linalg.det(each[:, 1:] - each[:, :1]) for each in (corners, rest))
    assert simulation.report.inverted == ((volumes * np.sign(sizes)) <= 0.0).sum() > 10
