"""Forces on constraint rows, and cables: both implementations of the step agree, and with forces on nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.dynamics.rows import Rows, joined
from softsim_core.dynamics.stepper import Inputs

pytest.importorskip("numba")


def random_rows(model: Any, rng: np.random.Generator, count: int) -> Rows:
    parts = []
    for _ in range(count):
        entries = int(rng.integers(1, 9))
        index = rng.integers(0, len(model.rest) + model.border_size, entries)
        parts.append(Rows(np.array([0, entries]), index, rng.normal(size=(entries, 3))))
    return joined(parts)


@pytest.mark.parametrize("compliant", [False, True])
@pytest.mark.parametrize("count", [1, 37])
def test_both_steps_answer_rows_alike(count: int, compliant: bool, make_tripod: Any) -> None:
    rng = np.random.default_rng(count)
    results = []
    for backend in ("scipy", "numba"):
        rng = np.random.default_rng(count)
        sim = make_tripod(backend, compliant)
        for _ in range(3):
            sim.step()
        stepper, state = sim._stepper, sim._state
        before = sim.model.empty_state()
        before.copy_from(state)
        stepper.step(state, Inputs(before.joint_positions + 0.01, sim.forces), sim.parameters)
        rows = random_rows(sim.model, rng, count)
        matrix = stepper.compliance(rows, before)
        stepper.correct(state, before, rng.normal(size=count) * 1e-5)
        results.append((matrix, state.buffer.copy()))
    (a, x), (b, y) = results
    assert np.abs(a - b).max() < 1e-9 * np.abs(a).max()
    assert np.abs(x - y).max() < 1e-9 * np.abs(x).max()


@pytest.mark.parametrize("backend", ["scipy", "numba"])
def test_an_impulse_on_a_row_is_a_force_on_its_node(backend: str, make_tripod: Any) -> None:
    outcomes = []
    node, force = 40, np.array([0.01, -0.02, 0.03])
    for by_row in (False, True):
        sim = make_tripod(backend, True)
        before = sim.model.empty_state()
        before.copy_from(sim._state)
        forces = np.zeros_like(sim.forces)
        if not by_row:
            forces[node] = force
        sim._stepper.step(sim._state, Inputs(before.joint_positions, forces), sim.parameters)
        if by_row:
            rows = Rows(np.array([0, 1]), np.array([node]), force[None])
            sim._stepper.compliance(rows, before)
            sim._stepper.correct(sim._state, before, np.array([sim.dt]))
        outcomes.append(sim._state.buffer.copy())
    assert np.abs(outcomes[0] - outcomes[1]).max() < 1e-12


@pytest.fixture(scope="module")
def make_tripod() -> Any:
    from dataclasses import replace

    scene = load_scene("tripod")

    def make(backend: str, compliant: bool) -> Simulation:
        joints = tuple(
            replace(joint, stiffness=0.5, inertia=1e-5) if compliant else joint for joint in scene.joints
        )
        return Simulation(replace(scene, joints=joints), backend=backend)  # type: ignore[arg-type]

    return make
