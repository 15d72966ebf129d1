"""The step of second order: its order, what rings rings on, and what touches comes to rest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import DISTANCE, FLOOR, GRAVITY, downhill, loose, touching
from small_scenes import body, comes_back_bit_for_bit, machine, scene, slab

from softsim_core import Simulation
from softsim_core.base import Array, Placement, SceneError
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.dynamics import StepSettings, TimeStep, make_stepper
from softsim_core.physics.mechanics import Control, Model, State
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.scene import MaterialDescription, SceneDescription, SolverSettings
from softsim_core.scene.building import build

SMOOTH = "bossak"


def with_method(description: SceneDescription, method: str, **settings: Any) -> SceneDescription:
    solver = replace(description.solver, time_integration=method, **settings)
    return replace(description, solver=solver)


def time_step(model: Model, backend: str, spectral_radius: float | None = 0.8) -> TimeStep:
    """A step of the model alone, of second order unless the radius is None."""
    return TimeStep(
        model,
        Actuators(),
        StepSettings(spectral_radius=spectral_radius),
        lambda model, like: make_stepper(model, backend),  # type: ignore[arg-type]
        lambda _: None,
    )


def swung(method: str, steps: int, backend: str = "auto", duration_s: float = 0.08) -> State:
    """Where the machine is when joints of all kinds have moved smoothly and a side wind has risen."""
    described = with_method(machine(), method, rayleigh_stiffness=0.001)
    built = build(replace(described, dt=duration_s / steps))
    advancing = time_step(built.model, backend, 0.8 if method == SMOOTH else None)
    state = built.model.rest_state()
    begin, wind = state.joint_positions.copy(), np.zeros_like(built.model.rest)
    wind[:, 1] = 0.01
    for step in range(steps):
        risen = np.sin(0.5 * np.pi * (step + 1) / steps) ** 4
        targets = begin + risen * np.array([0.4, 0.2, 0.003, 0.004])
        advancing.step(state, Control(targets, risen * wind), built.parameters)
    return state


def places(state: State) -> Array:
    """All of it in [m], turns by a lever of 10 mm."""
    turns = 0.01 * np.append(state.frame_rotations.ravel(), state.joint_positions)
    return np.concatenate([state.positions.ravel(), state.frame_positions.ravel(), turns])


@pytest.mark.numba
@pytest.mark.slow
def test_both_back_ends_swing_alike() -> None:
    pytest.importorskip("numba")
    fast, readable = swung(SMOOTH, 40, "numba"), swung(SMOOTH, 40, "scipy")
    np.testing.assert_allclose(places(fast), places(readable), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(fast.joint_efforts, readable.joint_efforts, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(fast.velocities, readable.velocities, rtol=0.0, atol=1e-10)


def test_a_driven_joint_has_the_speed_of_its_commands() -> None:
    built = build(replace(with_method(machine(), SMOOTH), dt=0.002))
    model, state = built.model, built.model.rest_state()
    stepper = time_step(model, "scipy")
    driven = np.setdiff1d(np.arange(len(model.joints)), model.compliant_joints)
    assert len(model.frame_names) > 0
    assert len(driven) > 1
    begin = state.joint_positions.copy()
    for step in range(1, 5):
        before, targets = state.joint_positions.copy(), begin + 1e-4 * step**2 * np.arange(1.0, 5.0)
        stepper.step(state, Control(targets, np.zeros_like(model.rest)), built.parameters)
        speeds = (state.joint_positions - before)[driven] / model.dt
        reduced = state.reduced_velocities[6 * len(model.frame_names) + driven]
        np.testing.assert_allclose(reduced, speeds, rtol=1e-12)


def beam(method: str, dt: float, **settings: Any) -> SceneDescription:
    """A clamped one of 7 Hz that falls from straight."""
    bar = body(box_mesh((0.1, 0.02, 0.02), (8, 2, 2)), young_modulus=8e4, poisson_ratio=0.3)
    described = scene(bar, attachments=(slab("clamp", "world", 0.0),), gravity=(0.0, 0.0, -2.0), dt=dt)
    return with_method(described, method, **settings)


def swings(description: SceneDescription, duration_s: float = 1.5) -> tuple[float, float]:
    """Frequency in [Hz] and damping ratio of its tip."""
    simulation, heights = Simulation(description), []
    tip = int(np.argmax(simulation.positions[:, 0]))
    for _ in range(round(duration_s / simulation.dt)):
        simulation.step()
        heights.append(simulation.positions[tip, 2])
    z = np.array(heights)
    turns = np.flatnonzero((z[1:-1] - z[:-2]) * (z[2:] - z[1:-1]) <= 0.0) + 1
    left, middle, right = z[turns - 1], z[turns], z[turns + 1]
    offset = 0.5 * (left - right) / (left - 2.0 * middle + right)
    times, extremes = (turns + offset) * simulation.dt, middle - 0.25 * (left - right) * offset
    sizes = np.abs(np.diff(extremes))
    frequency = 0.5 * (len(times) - 1) / (times[-1] - times[0])
    return float(frequency), float(np.log(sizes[0] / sizes[-1]) / (np.pi * (len(sizes) - 1)))


@pytest.mark.slow
def test_a_beam_rings_as_long_as_its_damping_lets_it() -> None:
    """In steps of 10 ms; implicit Euler adds 0.2 to the damping ratio."""
    frequency, _ = swings(beam(SMOOTH, 0.001))
    coarse, own = swings(beam(SMOOTH, 0.01))
    assert coarse == pytest.approx(frequency, rel=0.025)
    assert 0.0 < own < 0.006
    assert swings(beam("implicit_euler", 0.01))[1] > 0.15
    omega = 2.0 * np.pi * frequency
    _, damped = swings(beam(SMOOTH, 0.01, rayleigh_mass=2.25, rayleigh_stiffness=1.2e-3), 0.8)
    assert damped == pytest.approx(2.25 / (2.0 * omega) + 0.5 * 1.2e-3 * omega, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "least", "most"), [("implicit_euler", 2.5, 4.5), (SMOOTH, 10.0, 22.0)])
def test_errors_fall_with_the_order_of_the_method(method: str, least: float, most: float) -> None:
    """Four times as many steps: a quarter of the error with implicit Euler, a sixteenth with the other."""
    bar = body(box_mesh((0.1, 0.02, 0.02), (6, 1, 1)), young_modulus=8e4)
    bar = replace(bar, order=2, material=MaterialDescription(law="yeoh", c1=1.4e4, poisson_ratio=0.45))
    described = scene(bar, attachments=(slab("clamp", "world", 0.0),), gravity=(0.0, 0.0, -2.0))
    ends = []
    for count in (20, 80, 1280):
        simulation = Simulation(replace(with_method(described, method), dt=0.16 / count))
        for _ in range(count):
            simulation.step()
        ends.append(simulation.positions[np.argmax(simulation.model.rest[:, 0])].copy())
    coarse, finer = (np.abs(end - ends[-1]).max() for end in ends[:-1])
    assert least < coarse / finer < most


@pytest.mark.slow
def test_a_radius_of_0_damps_high_frequencies_most() -> None:
    kept = [swings(beam(SMOOTH, 0.01, spectral_radius=radius))[1] for radius in (1.0, 0.8, 0.5, 0.0)]
    assert kept == sorted(kept)
    assert kept[0] < 0.005 < 0.02 < kept[-1]


def test_a_snapshot_brings_the_swing_back_bit_for_bit() -> None:
    simulation = Simulation(beam(SMOOTH, 0.01))
    for _ in range(7):
        simulation.step()
    assert comes_back_bit_for_bit(simulation)


@pytest.mark.slow
def test_it_rests_where_implicit_euler_does() -> None:
    ends = []
    for method in (SMOOTH, "implicit_euler"):
        simulation = Simulation(with_method(machine(), method, rayleigh_stiffness=0.02))
        simulation.command([0.3, 0.2, 0.002, 0.003])
        for _ in range(400):
            simulation.step()
        assert np.abs(simulation.velocities).max() < 1e-6
        ends.append(np.append(simulation.positions.ravel(), simulation.joint_efforts))
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-5, atol=1e-6)


def test_a_ball_that_lands_beside_a_swinging_beam_does_not_damp_it() -> None:
    bar = body(box_mesh((0.1, 0.02, 0.02), (8, 2, 2), (0.2, 0.0, 0.1)), young_modulus=2e5, poisson_ratio=0.3)
    ball = loose("ball", Shape(sphere=0.01), 0.02)
    described = touching(FLOOR, ball, soft=(bar,), attachments=(slab("clamp", "world", 0.2),))
    both = Simulation(with_method(described, SMOOTH))
    alone = Simulation(with_method(replace(described, rigid_bodies=(FLOOR,), collisions=()), SMOOTH))
    for _ in range(60):
        both.step()
        alone.step()
    assert len(both.contacts.points) > 0
    np.testing.assert_allclose(both.positions, alone.positions, atol=1e-12)


@pytest.mark.slow
def test_a_soft_block_lands_and_lies_still() -> None:
    block = body(box_mesh((0.03, 0.03, 0.03), (2, 2, 2), (0.0, 0.0, 0.05)), young_modulus=5e4)
    described = touching(FLOOR, soft=(block,), rayleigh_stiffness=0.002)
    simulation, least = Simulation(with_method(described, SMOOTH)), np.inf
    for _ in range(200):
        simulation.step()
        least = min(least, float(simulation.contacts.gaps.min(initial=np.inf)))
    assert least > -1e-6
    assert np.abs(simulation.velocities).max() < 1e-4
    still = Simulation(described)
    for _ in range(200):
        still.step()
    np.testing.assert_allclose(simulation.positions[:, 2], still.positions[:, 2], atol=1e-6)


def held_beam(method: str) -> tuple[float, float, float]:
    """Frequency in [Hz], damping ratio, least contact force in [N] of a beam on a peg that swings."""
    bar = body(box_mesh((0.1, 0.02, 0.02), (10, 2, 2)), young_modulus=2.5e4, poisson_ratio=0.3)
    place = Placement(translation=(0.045, 0.01, -0.005 - 0.1 * DISTANCE))  # bends it up
    peg = replace(FLOOR, name="peg", shape=Shape(box=(0.01, 0.06, 0.01)), pose=place)
    described = touching(
        peg, soft=(bar,), attachments=(slab("clamp", "world", 0.0),), gravity=(0.0, 0.0, -2.0)
    )
    simulation = Simulation(with_method(described, method))
    for _ in range(80):
        simulation.step()
    velocities = np.zeros_like(simulation.positions)
    velocities[:, 2] = -0.2 * np.clip(simulation.model.rest[:, 0] / 0.1 - 0.5, 0.0, None) ** 2
    simulation.set_velocities(velocities)
    tip, heights, forces = int(np.argmax(simulation.model.rest[:, 0])), [], []
    for _ in range(100):
        simulation.step()
        heights.append(simulation.positions[tip, 2])
        forces.append(simulation.contacts.forces[:, 2].sum())
    z = np.array(heights) - np.mean(heights[10:])
    before = np.flatnonzero(z[10:-1] * z[11:] < 0.0) + 10
    crossings = before + z[before] / (z[before] - z[before + 1])
    frequency = 0.5 * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * simulation.dt)
    swing = np.ptp(z[10:24]), np.ptp(z[50:64])
    damping = np.log(swing[0] / swing[1]) / (2.0 * np.pi * frequency * 40 * simulation.dt)
    return float(frequency), float(damping), float(np.abs(forces).min())


@pytest.mark.slow
def test_what_is_held_by_a_contact_rings_on() -> None:
    """In steps of 10 ms; in those of 5 ms it has 7.8 Hz and 0.01, most of it friction on the peg."""
    frequency, damping, least = held_beam(SMOOTH)
    assert least > 0.01
    assert frequency == pytest.approx(7.8, rel=0.08)
    assert damping < 0.06
    assert held_beam("implicit_euler")[1] > 0.2


@pytest.mark.parametrize("friction", [0.0, 0.2])
@pytest.mark.slow
def test_a_block_slides_down_a_slope_as_it_should(friction: float) -> None:
    block = body(box_mesh((0.03, 0.03, 0.03), (2, 2, 2), (0.0, 0.0, DISTANCE)), young_modulus=5e4)
    slope = touching(FLOOR, soft=(block,), gravity=downhill(0.4), friction=friction, rayleigh_stiffness=0.001)
    simulation = Simulation(with_method(slope, SMOOTH))
    for _ in range(60):
        simulation.step()
    gained = GRAVITY * (np.sin(0.4) - friction * np.cos(0.4)) * 60 * simulation.dt
    assert simulation.velocities[:, 0].mean() == pytest.approx(gained, rel=1e-3)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"time_integration": "leapfrog"}, "one of implicit_euler, bossak, not leapfrog"),
        ({"spectral_radius": 1.2}, "spectral_radius must be between 0 and 1, not 1.2"),
    ],
)
def test_other_methods_are_refused(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        SolverSettings(**settings)
