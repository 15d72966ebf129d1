"""Rigid bodies without contact: momentum, energy, and motions that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from softsim_core import Simulation
from softsim_core.base import Array, Placement
from softsim_core.physics.mechanics import RigidBodies, State, rotation_exp
from softsim_core.physics.mesh import Shape
from softsim_core.scene import RigidBodyDescription, SceneDescription

NO_GRAVITY = np.zeros(3)


def one_body(inertia: Array, spin: Array, rotation: Array | None = None) -> tuple[RigidBodies, State]:
    """A body of 1 kg at the origin that spins in world axes [rad/s]."""
    rest = np.eye(3) if rotation is None else rotation
    bodies = RigidBodies(("body",), np.ones(1), inertia[None], np.zeros((1, 3)), rest[None])
    state = State(0, 0, 0, 1)
    state.rigid_rotations[0] = rest
    state.rigid_velocities[0, 3:] = spin
    return bodies, state


def fly(bodies: RigidBodies, state: State, dt: float) -> None:
    """One step without contact."""
    before = State(0, 0, 0, 1)
    before.copy_from(state)
    bodies.predict(state, NO_GRAVITY, dt)
    bodies.advance(state, before, dt)
    bodies.finish(state, before)


def momentum(bodies: RigidBodies, state: State) -> Array:
    """Angular momentum in world axes in [kg m^2/s], shape (3,)."""
    rotation = state.rigid_rotations[0]
    return np.asarray(rotation @ bodies.inertia[0] @ rotation.T @ state.rigid_velocities[0, 3:])


def energy(bodies: RigidBodies, state: State) -> float:
    """Of the rotation in [J]."""
    return 0.5 * float(momentum(bodies, state) @ state.rigid_velocities[0, 3:])


def random_inertia(random: np.random.Generator) -> Array:
    """Of twenty random points of mass about their centre: full, and possible for a solid."""
    points = random.normal(size=(20, 3)) * random.uniform(0.2, 1.0, 3)
    points -= points.mean(axis=0)
    return np.asarray(np.trace(points.T @ points) * np.eye(3) - points.T @ points) / 20.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_momentum_and_energy_stay(seed: int) -> None:
    random = np.random.default_rng(seed)
    spin = random.normal(size=3)
    spin *= random.choice([1.0, 10.0, 100.0]) / np.linalg.norm(spin)
    bodies, state = one_body(random_inertia(random), spin, rotation_exp(random.normal(size=3)))
    first, whole = momentum(bodies, state), energy(bodies, state)
    energies = []
    for _ in range(1000):
        fly(bodies, state, 0.01)
        energies.append(energy(bodies, state) / whole)
    assert np.abs(momentum(bodies, state) - first).max() <= 1e-10 * np.linalg.norm(first)
    assert np.abs(np.array(energies) - 1.0).max() < 1e-10
    assert state.rigid_rotations[0] @ state.rigid_rotations[0].T == pytest.approx(np.eye(3), abs=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("spin", [1e3, 9e3])
def test_a_spin_far_beyond_the_step_does_not_blow_up(spin: float) -> None:
    bodies, state = one_body(np.diag([1.0, 2.0, 2.7]), spin * np.array([0.6, 0.64, 0.48]))
    first, whole = momentum(bodies, state), energy(bodies, state)
    for _ in range(20):
        fly(bodies, state, 0.01)
    assert momentum(bodies, state) == pytest.approx(first, rel=1e-9)
    assert energy(bodies, state) == pytest.approx(whole, rel=1e-9)


def test_rotation_is_of_second_order() -> None:
    inertia, spin = np.diag([1.0, 2.0, 2.7]), np.array([2.0, 3.0, -1.0])
    held = inertia @ spin

    def slope(_: float, entries: Array) -> Array:
        rotation = entries.reshape(3, 3)
        rate = np.linalg.solve(rotation @ inertia @ rotation.T, held)
        return np.cross(rate, rotation.T).T.ravel()

    exact = solve_ivp(slope, (0.0, 1.0), np.eye(3).ravel(), rtol=1e-12, atol=1e-12).y[:, -1].reshape(3, 3)
    errors = []
    for steps in (50, 100, 200):
        bodies, state = one_body(inertia, spin)
        for _ in range(steps):
            fly(bodies, state, 1.0 / steps)
        errors.append(np.abs(state.rigid_rotations[0] - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx(2.0, abs=0.1)


def test_a_symmetric_top_precesses_about_its_momentum() -> None:
    """Its axis circles the angular momentum l with the rate |l| / I_across."""
    across, along = 0.002, 0.003
    bodies, state = one_body(np.diag([across, across, along]), np.array([3.0, 0.0, 8.0]))
    held = momentum(bodies, state)
    steps, dt = 1000, 0.001
    for _ in range(steps):
        fly(bodies, state, dt)
    rate = np.linalg.norm(held) / across
    turned = rotation_exp(steps * dt * rate * held / np.linalg.norm(held)) @ np.array([0.0, 0.0, 1.0])
    assert state.rigid_rotations[0][:, 2] == pytest.approx(turned, abs=2e-4)


@pytest.mark.slow
def test_a_body_spun_about_its_middle_axis_flips() -> None:
    """Dzhanibekov: the axis turns over again and again; about the outer axes it stays."""
    inertia = np.diag([1.0, 2.0, 3.0])
    for axis, flips in ((0, False), (1, True), (2, False)):
        spin = np.full(3, 1e-3)
        spin[axis] = 5.0
        bodies, state = one_body(inertia, spin)
        along = []
        for _ in range(1000):
            fly(bodies, state, 0.01)
            along.append(state.rigid_rotations[0][axis, axis])
        assert (min(along) < -0.99) == flips
        assert (min(along) > 0.99) == (not flips)


def test_a_tumbling_box_of_a_scene_keeps_its_momentum(backend: str) -> None:
    box = RigidBodyDescription(
        name="box",
        shape=Shape(box=(0.02, 0.04, 0.06)),
        mass=0.05,
        pose=Placement(rotation_deg=(10.0, 20.0, 30.0)),
        velocity=(0.1, -0.2, 3.0),
        angular_velocity=(4.0, 9.0, -2.0),
    )
    simulation = Simulation(SceneDescription(name="tumble", dt=0.01, rigid_bodies=(box,)), backend)  # type: ignore[arg-type]
    rigid = simulation.model.rigid

    def moment() -> Array:
        rotation = simulation._state.rigid_rotations[0]
        return np.asarray(rotation @ rigid.inertia[0] @ rotation.T @ simulation.rigid_velocities[0, 3:])

    first = moment()
    for _ in range(1000):
        simulation.step()
    assert np.abs(moment() - first).max() <= 1e-10 * np.linalg.norm(first)
    fall = (0.1, -0.2, 3.0 - 9.81 * simulation.time)
    assert simulation.rigid_velocities[0, :3] == pytest.approx(fall, rel=1e-12)
