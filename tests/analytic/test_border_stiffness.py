"""Static stiffness of frames and joints: what moving a joint does to the effector and to all drives."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.physics.dynamics import reduced_stiffness, solve_static
from softsim_core.physics.mechanics import Control, State, rotation_log

RANDOM = np.random.default_rng(11)
TARGETS = RANDOM.uniform(-1.9, -0.2, (3, 3))
STEP_RAD = 1e-4


def settled(simulation: Simulation, start: State, targets: np.ndarray) -> State:
    control = Control(targets, np.zeros_like(simulation.model.rest), 0.035)
    return solve_static(simulation.model, start, control, simulation.parameters).state


@pytest.mark.numba
@pytest.mark.parametrize(
    "targets", [TARGETS[0], *(pytest.param(each, marks=pytest.mark.exhaustive) for each in TARGETS[1:])]
)
@pytest.mark.slow
def test_it_is_the_derivative_of_settled_states(targets: np.ndarray) -> None:
    pytest.importorskip("numba")
    simulation = Simulation(load_scene("tripod"), "numba")
    state = settled(simulation, simulation.model.rest_state(), targets)
    fast = reduced_stiffness(simulation._stepper, state, simulation.parameters, simulation.forces)
    plain = Simulation(simulation.scene, "scipy")._stepper
    assert fast == pytest.approx(
        reduced_stiffness(plain, state, simulation.parameters, simulation.forces), rel=1e-9, abs=1e-9
    )
    effector = -np.linalg.solve(fast[:6, :6], fast[:6, 6:])
    effort = fast[6:, 6:] + fast[6:, :6] @ effector
    for j in range(3):
        change = STEP_RAD * np.eye(3)[j]
        after, before = (settled(simulation, state, targets + sign * change) for sign in (1.0, -1.0))
        moved = after.frame_positions[0] - before.frame_positions[0]
        turned = rotation_log(after.frame_rotations[0] @ before.frame_rotations[0].T)
        assert np.r_[moved, turned] / (2 * STEP_RAD) == pytest.approx(effector[:, j], abs=1e-6)
        torque = (after.joint_efforts - before.joint_efforts) / (2 * STEP_RAD)
        assert torque == pytest.approx(effort[:, j], abs=1e-6)


@pytest.mark.numba
def test_soft_fixings_and_loads_are_in_it() -> None:
    """Both paths alike; for the law `qr` the compiled path takes the derivative of `polar` there."""
    pytest.importorskip("numba")
    scene = load_scene("tripod")
    pull = dataclasses.replace(scene.scene.attachments[-1], name="pull", to="world", stiffness=20.0)
    scene = scene.with_scene(attachments=(*scene.scene.attachments, pull))
    polar = Simulation(scene, "scipy")
    for law in ("polar", "qr"):
        changed = scene.with_scene(solver=dataclasses.replace(scene.scene.solver, rotation=law))
        simulation = Simulation(changed, "numba")
        simulation.forces[:] = np.linspace(0.0, 1e-3, simulation.forces.size).reshape(-1, 3)
        simulation.command([-0.5, -1.0, -0.8])
        for _ in range(40):
            simulation.step()
        fast = simulation.reduced_stiffness()
        polar.forces[:] = simulation.forces
        polar._state.copy_from(simulation._state)
        assert fast == pytest.approx(polar.reduced_stiffness(), rel=1e-7, abs=1e-7)
        assert fast == pytest.approx(fast.T)
