"""More Newton iterations of a step: they lead to the one that is not linearised; the report tells how far.

The oracle solves the nonlinear equation of the step with forces and mass alone, by scipy.optimize.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import FLOOR, loose, touching
from scipy.optimize import root
from small_scenes import body, comes_back_bit_for_bit, machine, scene, shaken, slab

from softsim_core import Simulation, load_scene
from softsim_core.base import Array, Box, SceneError
from softsim_core.physics.dynamics import FreeTurning, make_stepper
from softsim_core.physics.fem import elastic_forces, stiffness_matrix
from softsim_core.physics.mechanics import Control
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.scene import (
    AttachmentDescription,
    LayerDescription,
    MaterialDescription,
    SceneDescription,
    SolverSettings,
)
from softsim_core.scene.building import build

MANY = 30
RUBBER = MaterialDescription(law="yeoh", c1=1.5e4, poisson_ratio=0.49)
BELOW = Box(center=(0.03, 0.0, 0.0), size=(0.1, 0.1, 1e-5))
PAPER = LayerDescription(name="paper", thickness=1e-4, young_modulus=1e8, box=BELOW)
LAWS: dict[str, dict[str, Any]] = {
    "tet4": {},
    "tet10": {"material": RUBBER, "order": 2},
    "on_paper": {"material": RUBBER, "order": 2, "layers": (PAPER,)},
}


def iterated(description: SceneDescription, most: int, tolerance: float = 1e-12) -> SceneDescription:
    solver = replace(description.solver, iterations=most, iteration_tolerance=tolerance, substeps=1)
    return replace(description, solver=solver)


def beam(element: str, **fields: Any) -> SceneDescription:
    bar = body(box_mesh((0.06, 0.015, 0.015), (4, 1, 1)), young_modulus=8e4)
    return scene(
        replace(bar, **LAWS[element]),
        attachments=(slab("clamp", "world", 0.0),),
        **{"rayleigh_mass": 2.0, **fields},
    )


def bent(description: SceneDescription, load: float, backend: str) -> Simulation:
    """A step from straight, already falling at 1 m/s at the tip, under a load in [N] across it."""
    simulation = Simulation(description, backend)  # type: ignore[arg-type]
    x = simulation.positions[:, 0] / 0.06
    simulation.set_velocities(np.stack([0.0 * x, 0.0 * x, -(x**2)], axis=1))
    simulation.forces[x > 0.99, 2] = -load / np.count_nonzero(x > 0.99)
    simulation.step()
    return simulation


def end_of_nonlinear_step(simulation: Simulation, load: float) -> Array:
    """Node positions at the end of the step of `bent`, by the equation itself."""
    model, h, parameters = simulation.model, simulation.dt, simulation.parameters
    free, x = model.free_nodes, model.rest[:, 0] / 0.06
    start = np.zeros_like(model.rest)
    start[free, 2] = -(x[free] ** 2)
    forces = model.weight.copy()
    forces[x > 0.99, 2] -= load / np.count_nonzero(x > 0.99)

    def off(moved: Array) -> Array:
        rates = np.zeros_like(model.rest)
        rates[free] = moved.reshape(-1, 3) / h
        places = model.rest + h * rates
        pulled = forces + elastic_forces(model.groups, places, parameters.materials)
        if parameters.rayleigh_stiffness > 0.0:
            state = model.rest_state()
            state.positions[:] = places
            exact = bool(state.extra)  # what is nearly incompressible is not clamped, and keeps its volume
            solids, thin = ([each for each in model.groups if each.fills == kind] for kind in (True, False))
            stiffness = stiffness_matrix(
                solids, places, parameters.materials, positive=not exact, mean_share=0.0
            )
            begun = FreeTurning(model).fit_rigidly(model.rest, places)  # turning is no strain
            strained = (places - begun).ravel() / h
            pulled -= parameters.rayleigh_stiffness * (stiffness @ strained).reshape(-1, 3)
            change = elastic_forces(thin, places, parameters.materials)
            change -= elastic_forces(thin, begun, parameters.materials)
            pulled += parameters.rayleigh_stiffness / h * change
        pulled -= parameters.rayleigh_mass * model.momentum(rates)
        return np.asarray((model.momentum(rates - start) / h - pulled)[free].ravel())

    first = (simulation.positions - model.rest)[free].ravel()
    solution = root(off, 0.9 * first, method="hybr", options={"xtol": 1e-13})
    assert np.abs(solution.fun).max() < 1e-9, solution.message
    places = model.rest.copy()
    places[free] += solution.x.reshape(-1, 3)
    return np.asarray(places)


@pytest.mark.parametrize(
    ("element", "load", "damping"),
    [
        ("tet4", 0.3, 0.0),
        ("tet4", 0.3, 3e-3),
        ("tet10", 0.02, 0.0),
        ("tet10", 0.02, 3e-4),
        ("on_paper", 0.02, 3e-4),
    ],
)
@pytest.mark.slow
def test_many_iterations_reach_the_nonlinear_step(
    element: str, load: float, damping: float, backend: str
) -> None:
    description = beam(element, rayleigh_stiffness=damping)
    simulation = bent(iterated(description, MANY), load, backend)
    once = bent(iterated(description, 1), load, backend)
    expected = end_of_nonlinear_step(simulation, load)
    assert np.abs(expected - simulation.model.rest).max() > 0.006  # a tenth of its length
    assert np.abs(once.positions - expected).max() > 1e-4
    np.testing.assert_allclose(simulation.positions, expected, rtol=0.0, atol=1e-10)
    assert 2 < simulation.report.iterations < MANY
    rates = (simulation.positions - simulation.model.rest) / simulation.dt
    np.testing.assert_allclose(simulation.velocities, rates, atol=1e-9)


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize("robot", ["emio", "pneu_finger"])
def test_what_is_stiff_along_itself_is_iterated_with_much_damping(robot: str) -> None:
    """Rods, and paper with thread: their damping by K v would be for turning, too, and no iteration end."""
    damped = {"rayleigh_stiffness": 0.01, "iteration_tolerance": 1e-10}
    once, often = (load_scene(robot, {"solver": {**damped, "iterations": most}}) for most in (1, 6))
    errors: list[list[float]] = []
    for each in (once, often):
        simulation = Simulation(each)
        upper = [joint.limits.upper for joint in simulation.robot.joints]
        simulation.command(np.array(upper) * 0.2 * (-1.0) ** np.arange(len(upper)))
        errors.append([])
        for _ in range(3):
            simulation.step()
            errors[-1].append(simulation.report.linearisation_error)
    assert min(errors[0]) > 1e-5
    assert max(errors[1]) < 1e-7


@pytest.mark.numba
def test_damping_of_paper_leaves_the_spin_of_a_free_body() -> None:
    bar = replace(body(box_mesh((0.06, 0.02, 0.02), (3, 1, 1))), **LAWS["on_paper"])
    settings = SolverSettings(time_integration="bossak", rayleigh_stiffness=5e-3)
    simulation = Simulation(replace(scene(bar, gravity=(0.0, 0.0, 0.0), dt=5e-3), solver=settings))
    simulation.set_body_velocity(simulation.bodies[0].name, angular_velocity=(3.0, 10.0, 5.0))
    mass, momenta = simulation.model.mass[:, None], []
    for _ in range(61):
        arms = simulation.positions - (mass * simulation.positions).sum(axis=0) / mass.sum()
        momenta.append((mass * np.cross(arms, simulation.velocities)).sum(axis=0))
        simulation.step()
    assert simulation.report.iterations == 2  # as bossak has it for what hangs on nothing
    assert np.linalg.norm(momenta[-1] - momenta[0]) < 0.01 * np.linalg.norm(momenta[0])


@pytest.mark.parametrize("load", [0.002, 0.01, 0.02])
@pytest.mark.parametrize("element", LAWS)
def test_the_error_of_a_step_is_told(element: str, load: float, backend: str) -> None:
    """Of the first iteration it is within a factor of 2, from micrometres to millimetres."""
    once = bent(iterated(beam(element), 1), load, backend)
    told = once.report.linearisation_error
    many = bent(iterated(beam(element), MANY), load, backend)
    apart = np.linalg.norm(once.positions - many.positions, axis=1).max()
    assert 0.5 < told / apart < 2.0, (told, apart)
    assert many.report.linearisation_error < 1e-10


def test_an_iteration_that_strays_is_taken_back(backend: str) -> None:
    """A load under which the matrix of the second iteration is not positive: the step is no worse for it.

    An implementation that notices takes a clamped matrix and goes on; else the iteration is taken back.
    """
    once, many = (bent(iterated(beam("tet10"), most), 0.1, backend) for most in (1, MANY))
    if many.report.fallback:
        assert many.report.linearisation_error < 1e-3 * once.report.linearisation_error
        return
    np.testing.assert_array_equal(many.positions, once.positions)
    np.testing.assert_array_equal(many.velocities, once.velocities)
    assert many.report.linearisation_error > 0.01


def test_asking_for_the_error_changes_nothing() -> None:
    asked, silent = Simulation(machine()), Simulation(machine())
    for _ in range(5):
        shaken(asked, 1, 3)
        shaken(silent, 1, 3)
        assert asked.report.linearisation_error > 0.0
    assert asked.snapshot() == silent.snapshot()
    last = silent.report
    silent.step()
    assert np.isnan(last.linearisation_error)  # too late


def test_one_iteration_is_the_bare_step(backend: str) -> None:
    simulation = Simulation(machine(), backend)  # type: ignore[arg-type]
    built = build(machine())
    state, bare = built.model.rest_state(), make_stepper(built.model, backend)  # type: ignore[arg-type]
    control = Control(state.joint_positions.copy(), np.zeros_like(built.model.rest))
    for _ in range(5):
        simulation.step()
        bare.step(state, control, built.parameters)
    np.testing.assert_array_equal(simulation.positions, state.positions)
    assert simulation.report.iterations == 1


@pytest.mark.numba
@pytest.mark.parametrize("method", ["implicit_euler", "bossak"])
@pytest.mark.slow
def test_back_ends_iterate_alike_with_joints_frames_and_springs(method: str) -> None:
    pytest.importorskip("numba")
    described = iterated(machine(), 8)
    described = replace(described, solver=replace(described.solver, time_integration=method))  # type: ignore[arg-type]
    fast, readable = (Simulation(described, backend) for backend in ("numba", "scipy"))  # type: ignore[arg-type]
    plain = Simulation(iterated(described, 1))
    for simulation in (fast, readable, plain):
        shaken(simulation, 15, 5)
    np.testing.assert_allclose(fast.positions, readable.positions, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(fast.joint_efforts, readable.joint_efforts, rtol=1e-6, atol=1e-8)
    assert fast.report.linearisation_error < 1e-9 < plain.report.linearisation_error


def test_a_drive_with_inertia_and_a_lead_feel_all_of_it(backend: str) -> None:
    """A stiff block far from its limit of strain: one iteration and many tell the same efforts."""
    described = machine(rayleigh_stiffness=1e-4)
    ends = []
    for most in (1, 6):
        simulation = Simulation(iterated(described, most), backend)  # type: ignore[arg-type]
        for _ in range(3):
            simulation.command(simulation.joint_targets + np.array([1e-3, 1e-3, 1e-5, 1e-5]))
            simulation.step()
        ends.append(simulation.joint_efforts)
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.02)


@pytest.mark.slow
def test_contacts_hold_in_each_iteration(backend: str) -> None:
    """A soft block and a ball on it: pressed down, the floor is not passed, and all lies still at last."""
    block = body(box_mesh((0.03, 0.03, 0.03), (2, 2, 2), (-0.015, -0.015, 0.002)), young_modulus=1e4)
    ball = loose("ball", Shape(sphere=0.008), 0.044, 0.02)
    described = touching(FLOOR, ball, soft=(block,), rayleigh_stiffness=0.002)
    many = Simulation(iterated(described, 5, 1e-9), backend)  # type: ignore[arg-type]
    once = Simulation(described, backend)  # type: ignore[arg-type]
    worst = told = 0.0
    for _ in range(40):
        many.step()
        once.step()
        assert many.contacts.gaps.min(initial=0.0) > -1e-6
        assert many.contacts.residual < 1e-6
        told = max(told, once.report.linearisation_error)
        worst = max(worst, many.report.linearisation_error)
    assert many.report.iterations > 1
    assert worst < 2.5e-6 < 4e-6 < told  # the worst: the step that strikes, whose fourth iteration strays
    assert comes_back_bit_for_bit(many)
    for _ in range(60 if many.compiled else 0):
        many.step()
        once.step()
    np.testing.assert_allclose(many.positions[:, 2], once.positions[:, 2], atol=1e-3 if many.compiled else 1)


def test_reading_the_error_leaves_the_contacts_told() -> None:
    block = body(box_mesh((0.03, 0.03, 0.03), (2, 2, 2), (-0.015, -0.015, 0.0005)), young_modulus=1e4)
    simulation, other = (Simulation(touching(FLOOR, soft=(block,))) for _ in range(2))
    for _ in range(10):
        simulation.step()
        other.step()
    assert simulation.report.linearisation_error > 0.0
    np.testing.assert_array_equal(simulation.contacts.forces, other.contacts.forces)
    np.testing.assert_array_equal(simulation.contacts.gaps, other.contacts.gaps)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [({"iterations": 0}, "iterations must be 1 to 1000"), ({"iteration_tolerance": -1.0}, "must be >= 0 m")],
)
def test_other_numbers_are_refused(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        SolverSettings(**settings)


@pytest.mark.filterwarnings("ignore:.* lengths are in m", "ignore:.* moduli are in Pa")
def test_how_far_a_step_is_iterated_does_not_depend_on_size(backend: str) -> None:
    """Lengths and gravity in proportion, moduli with their square, masses with their cube."""

    def bent_places(scale: float) -> Array:
        mesh = box_mesh((0.06 * scale, 0.015 * scale, 0.015 * scale), (4, 1, 1))
        bar = body(mesh, young_modulus=8e4 * scale**2, total_mass=0.01 * scale**3)
        end = Box(center=(0.0, 0.0, 0.0), size=(1e-3 * scale, 9.0, 9.0))
        clamp = AttachmentDescription(name="clamp", body="body", to="world", box=end)
        gravity = (0.0, 0.0, -200.0 * scale)
        described = scene(bar, attachments=(clamp,), gravity=gravity, rayleigh_mass=2.0)
        described = replace(described, solver=replace(described.solver, iterations=MANY, substeps=1))
        simulation = Simulation(described, backend)  # type: ignore[arg-type]
        for _ in range(5):
            simulation.step()
        return np.asarray(simulation.positions / scale)

    usual = bent_places(1.0)
    assert bent_places(2.0**-10) == pytest.approx(usual, abs=1e-9)
