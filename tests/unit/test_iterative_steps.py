"""Steps by conjugate gradients: the same physics to ten tolerances, whatever moves, pulls and touches."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softsim_core import (
    AttachmentDescription,
    BodyDescription,
    Box,
    MaterialDescription,
    SceneDescription,
    Simulation,
    SolverSettings,
    TetMesh,
    box_mesh,
    load_scene,
)
from softsim_core.base import Placement
from softsim_core.physics.mesh import Shape
from softsim_core.scene import CollisionDescription, RigidBodyDescription

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

from softsim_core.physics.dynamics.numba_backend import (  # noqa: E402
    TOLERANCE,
    elimination,
    stepper,
)


def both(name: str) -> tuple[Simulation, Simulation]:
    """A scene with a factor, and by iteration."""
    direct, iterated = (
        Simulation(load_scene(name, {"solver": {"linear_solver": solver}}), backend="numba")
        for solver in ("supernodal", "iterative")
    )
    return direct, iterated


def swing(simulation: Simulation, step: int) -> None:
    """Drive every joint to and fro, well inside its limits."""
    rest = np.array([joint.rest for joint in simulation.model.joints])
    phase = np.sin(step / 12.0 + np.arange(len(rest)))
    wanted = rest.copy()
    for j, joint in enumerate(simulation.robot.joints):
        low, high = max(joint.limits.lower, -1.0), min(joint.limits.upper, 1.0)
        wanted[j] += 0.5 * phase[j] * (high - rest[j] if phase[j] > 0.0 else rest[j] - low)
    simulation.command(wanted)


@pytest.mark.parametrize(
    "name",
    [
        "tripod",  # three servos and a free frame
        "cable_finger",  # an actuator with bounds
        "tripod_ball",  # a rigid body rolls on it
        "cable_gripper",  # contact with friction
        "cantilever_quadratic",  # found stress, nearly incompressible
        "silicone_beam",  # of second order
        "inflated_cube",  # the stiffness of a pressure
        "tripod_quadratic",
    ],
)
@pytest.mark.slow
def test_steps_are_those_of_a_factor(name: str) -> None:
    direct, iterated = both(name)
    apart, count = 0.0, 0
    for step in range(40):
        for simulation in (direct, iterated):
            if simulation.joint_names:
                swing(simulation, step)
            simulation.step()
        count += iterated.report.linear_iterations
        assert direct.report.linear_iterations == 0
        apart = max(apart, float(np.abs(direct.positions - iterated.positions).max()))
    assert count > 0
    assert apart < 20.0 * TOLERANCE


def hanging(
    solver: str, young_modulus: float = 30e3, mesh: TetMesh | None = None, **fields: Any
) -> Simulation:
    """A bar held at one end, askew, that sags far; `fields` are of its SceneDescription."""
    mesh = mesh or box_mesh((0.12, 0.02, 0.02), (18, 3, 3))
    body = BodyDescription(
        name="bar",
        mesh=mesh,
        material=MaterialDescription(young_modulus=young_modulus, poisson_ratio=0.45),
        total_mass=0.05,
    )
    box = Box(center=(0.0, 0.0, 0.0), size=(0.004, 0.1, 0.1))
    hold = AttachmentDescription(name="hold", body="bar", to="world", box=box)
    settings = SolverSettings(linear_solver=solver, rayleigh_stiffness=0.01)
    return Simulation(
        SceneDescription(
            name="hanging",
            gravity=(1.0, 4.0, -8.0),
            bodies=(body,),
            attachments=(hold,),
            solver=settings,
            **fields,
        ),
        backend="numba",
    )


@pytest.mark.slow
def test_a_bar_that_hangs_down_comes_to_rest_where_a_factor_takes_it() -> None:
    direct, iterated = hanging("supernodal"), hanging("iterative")
    most = 0
    for _ in range(600):
        direct.step()
        iterated.step()
        most = max(most, iterated.report.linear_iterations)
    assert np.abs(direct.positions - direct.model.rest).max() > 0.05
    assert np.abs(direct.positions - iterated.positions).max() < 20.0 * TOLERANCE
    assert most < 40  # the preconditioner turns with the body
    assert iterated.report.linear_iterations <= 3  # at rest hardly anything is left to do


def test_a_snapshot_goes_on_bit_by_bit() -> None:
    first, second = hanging("iterative"), hanging("iterative")
    for _ in range(30):
        first.step()
    second.restore(first.snapshot())
    for _ in range(20):
        first.step()
        second.step()
    assert np.array_equal(first.positions, second.positions)


def test_tuned_materials_are_taken_over() -> None:
    direct, iterated = hanging("supernodal"), hanging("iterative")
    for simulation in (direct, iterated):
        for _ in range(10):
            simulation.step()
        simulation.set_material("bar", young_modulus=120e3)
    for _ in range(30):
        direct.step()
        iterated.step()
        assert iterated.report.linear_iterations < 40
    assert np.abs(direct.positions - iterated.positions).max() < 20.0 * TOLERANCE


def test_steps_that_do_not_converge_are_factored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(elimination, "MOST_ITERATIONS", 2)
    direct, iterated = hanging("supernodal"), hanging("iterative")
    for _ in range(15):
        direct.step()
        iterated.step()
    assert iterated.report.linear_iterations == 0
    assert np.abs(direct.positions - iterated.positions).max() < 20.0 * TOLERANCE


def test_auto_iterates_where_a_factor_has_too_much_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    small = hanging("auto")
    small.step()
    assert small.report.linear_iterations == 0
    monkeypatch.setattr(stepper, "MANY", 100)
    monkeypatch.setattr(stepper, "CROSSING", 20.0)
    large = hanging("auto")
    large.step()
    large.step()
    assert large.report.linear_iterations > 0
    floor = RigidBodyDescription(
        name="floor", shape=Shape(box=(1.0, 1.0, 0.02)), pose=Placement(translation=(0.0, 0.0, -0.1))
    )
    both = tuple(CollisionDescription(name=name, body=name) for name in ("bar", "floor"))
    touched = hanging("auto", rigid_bodies=(floor,), collisions=both)
    touched.step()
    touched.step()
    assert touched.report.linear_iterations == 0  # contacts take many solutions of one matrix


def test_statics_of_such_a_scene_are_solved() -> None:
    direct, iterated = (hanging(solver).equilibrium([]) for solver in ("supernodal", "iterative"))
    assert np.abs(direct.state.positions - iterated.state.positions).max() < 1e-9
