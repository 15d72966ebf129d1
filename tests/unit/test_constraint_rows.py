"""Forces on constraint rows, and cables: both implementations of the step agree, and with forces on nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import ArrayError
from softsim_core.physics.mechanics import Control, Rows, join_rows

pytest.importorskip("numba")


def random_rows(model: Any, rng: np.random.Generator, count: int) -> Rows:
    parts = []
    for _ in range(count):
        entries = int(rng.integers(1, 9))
        index = rng.integers(0, len(model.rest) + model.reduced_size, entries)
        parts.append(Rows(np.array([0, entries]), index, rng.normal(size=(entries, 3))))
    return join_rows(parts)


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
        control = Control(state.joint_positions + 0.01, sim.forces)
        free = stepper.free_motion(state, control, sim.parameters)
        rows = random_rows(sim.model, rng, count)
        matrix = free.compliance(rows)
        free.correct(rng.normal(size=count) * 1e-5)
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
        control = Control(before.joint_positions, forces)
        free = sim._stepper.free_motion(sim._state, control, sim.parameters)
        if by_row:
            rows = Rows(np.array([0, 1]), np.array([node]), force[None])
            free.compliance(rows)
            free.correct(np.array([sim.dt]))
        outcomes.append(sim._state.buffer.copy())
    assert np.abs(outcomes[0] - outcomes[1]).max() < 1e-12


@pytest.mark.parametrize("backend", ["scipy", "numba"])
def test_a_correction_starts_from_the_free_motion_each_time(backend: str, make_tripod: Any) -> None:
    """Other rows, other impulses in between: the last correction alone counts, to the last bit."""
    outcomes = []
    for attempts in (1, 3):
        rng = np.random.default_rng(7)
        sim = make_tripod(backend, True)
        sim.step()
        control = Control(sim.joint_positions + 0.01, sim.forces)
        free = sim._stepper.free_motion(sim._state, control, sim.parameters)
        start, report = sim._state.buffer.copy(), free.report
        wanted, impulses = random_rows(sim.model, rng, 6), 1e-5 * rng.normal(size=6)
        for attempt in range(1, attempts):
            free.compliance(random_rows(sim.model, rng, 10 * attempt))
            assert free.correct(1e-3 * rng.normal(size=10 * attempt)).top_speed > report.top_speed
        free.compliance(wanted)
        free.correct(np.zeros(6))
        np.testing.assert_allclose(sim._state.buffer, start, rtol=1e-12, atol=1e-15)
        free.correct(impulses)
        assert np.abs(sim._state.buffer - start).max() > 1e-9
        outcomes.append(sim._state.buffer.copy())
    np.testing.assert_array_equal(outcomes[0], outcomes[1])


def test_rows_of_other_types_are_converted_and_misshapen_ones_refused(make_tripod: Any) -> None:
    sim = make_tripod("numba", True)
    sim.step()
    control = Control(sim.joint_positions, sim.forces)
    free = sim._stepper.free_motion(sim._state, control, sim.parameters)
    rows = Rows(np.array([0, 1]), np.array([40]), np.array([[1.0, 2.0, 3.0]]))
    expected = free.compliance(rows)
    narrow = Rows(rows.start.astype(np.int32), rows.place.astype(np.uint8), rows.coefficient.astype("f4"))
    np.testing.assert_array_equal(free.compliance(narrow), expected)
    with pytest.raises(ArrayError, match=r"coefficient refused: expected real numbers of shape \(1, 3\)"):
        free.compliance(rows._replace(coefficient=np.zeros((1, 2))))


@pytest.fixture(scope="module")
def make_tripod() -> Any:
    from dataclasses import replace

    scene = load_scene("tripod")

    def make(backend: str, compliant: bool) -> Simulation:
        joints = tuple(
            replace(joint, stiffness=0.5, inertia=1e-5) if compliant else joint for joint in scene.joints
        )
        return Simulation(scene.with_scene(joints=joints), backend=backend)  # type: ignore[arg-type]

    return make
