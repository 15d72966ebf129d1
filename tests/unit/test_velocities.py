"""Velocities and loads that are given: at the start, while a simulation runs, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from small_scenes import machine, scene, slab

from softsim_core import Simulation
from softsim_core.base import CommandError, Placement, SceneError
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.scene import BodyDescription, MaterialDescription, RigidBodyDescription, SceneDescription

NO_GRAVITY = (0.0, 0.0, 0.0)


def bar(**fields: Any) -> BodyDescription:
    mesh = box_mesh((0.04, 0.02, 0.02), (4, 2, 2))
    material = MaterialDescription(young_modulus=1e5, poisson_ratio=0.3)
    return BodyDescription(name="bar", mesh=mesh, material=material, density=1000.0, **fields)


def box(**fields: Any) -> RigidBodyDescription:
    return RigidBodyDescription(name="box", shape=Shape(box=(0.01, 0.02, 0.03)), **fields)


def test_a_body_flies_with_its_first_velocity(backend: str) -> None:
    flying = scene(bar(velocity=(0.3, 0.0, -0.1)), gravity=NO_GRAVITY)
    simulation = Simulation(flying, backend)  # type: ignore[arg-type]
    first = simulation.positions
    for _ in range(20):
        simulation.step()
    assert simulation.positions - first == pytest.approx(
        np.tile([0.06, 0.0, -0.02], (len(first), 1)), abs=1e-12
    )
    simulation.reset()
    assert simulation.velocities == pytest.approx(np.tile([0.3, 0.0, -0.1], (len(first), 1)))


def test_a_free_frame_moves_along_and_what_is_fixed_stays(backend: str) -> None:
    frame = slab("frame", "free", 0.04, "bar")
    simulation = Simulation(
        scene(bar(velocity=(0.3, 0.0, 0.0)), gravity=NO_GRAVITY, attachments=(frame,)),
        backend,  # type: ignore[arg-type]
    )
    first = simulation.frames()["frame"].position
    for _ in range(20):
        simulation.step()
    moved = simulation.frames()["frame"].position - first
    assert moved == pytest.approx((0.06, 0.0, 0.0), abs=1e-12)
    held = Simulation(scene(bar(velocity=(0.3, 0.0, 0.0)), attachments=(slab("held", "world", 0.0, "bar"),)))
    at_rest = np.isclose(held.positions[:, 0], 0.0)
    assert not held.velocities[at_rest].any()
    assert held.velocities[~at_rest, 0] == pytest.approx(0.3)


def test_a_spun_body_keeps_its_angular_momentum(backend: str) -> None:
    simulation = Simulation(scene(bar(), gravity=NO_GRAVITY), backend)  # type: ignore[arg-type]
    simulation.set_body_velocity("bar", (0.1, 0.2, 0.3), (0.0, 0.0, 2.0))
    mass = simulation.model.mass
    centre = mass @ simulation.positions / mass.sum()
    arm = simulation.positions - centre
    expected = np.array([0.1, 0.2, 0.3]) + np.cross((0.0, 0.0, 2.0), arm)
    assert simulation.velocities == pytest.approx(expected, abs=1e-15)
    assert mass @ simulation.velocities == pytest.approx(mass.sum() * np.array([0.1, 0.2, 0.3]))


def test_node_velocities_are_set_but_of_what_follows_something() -> None:
    simulation = Simulation(machine())
    wanted = np.random.default_rng(0).normal(size=simulation.positions.shape)
    simulation.set_velocities(wanted)
    free = simulation.model.free_nodes
    assert np.array_equal(simulation.velocities[free], wanted[free])
    others = np.setdiff1d(np.arange(len(wanted)), free)
    assert not simulation.velocities[others].any()


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (np.zeros((3, 2)), r"shape \(3, 2\) refused: expected shape \(45, 3\) in m/s"),
        (np.full((45, 3), np.nan), r"value at \[0, 0\] is not finite"),
        ([["fast"] * 3] * 45, "must be numbers in m/s"),
        (None, "refused|must be numbers"),
    ],
)
def test_velocities_that_are_none_are_refused(values: Any, told: str) -> None:
    simulation = Simulation(scene(bar()))
    with pytest.raises(CommandError, match=told):
        simulation.set_velocities(values)
    with pytest.raises(CommandError, match="unknown body that moves by itself 'nobody'; known: bar"):
        simulation.set_body_velocity("nobody")
    assert not simulation.velocities.any()


def test_velocities_of_other_number_types_are_taken(backend: str) -> None:
    simulation = Simulation(scene(bar()), backend)  # type: ignore[arg-type]
    simulation.set_velocities(np.ones((45, 3), dtype=np.float32))
    simulation.set_velocities(np.ones((45, 3), dtype=np.int32)[:, ::-1])
    simulation.step()
    assert np.isfinite(simulation.positions).all()


def test_rigid_bodies_are_thrown_spun_and_pushed(backend: str) -> None:
    thrown = box(mass=0.5, velocity=(1.0, 0.0, 0.0), angular_velocity=(0.0, 0.0, 4.0))
    simulation = Simulation(
        SceneDescription(name="throw", gravity=NO_GRAVITY, rigid_bodies=(thrown,)), backend
    )  # type: ignore[arg-type]
    assert simulation.rigid_names == ("box",)
    assert simulation.rigid_velocities == pytest.approx(np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 4.0]]))
    simulation.rigid_forces[0] = [0.0, 2.0, 0.0, 0.0, 0.0, 1e-4]
    steps, dt = 50, simulation.dt
    for _ in range(steps):
        simulation.step()
    inertia = 0.5 * (0.01**2 + 0.02**2) / 12.0
    spin = 4.0 + 1e-4 / inertia * steps * dt
    assert simulation.rigid_velocities[0] == pytest.approx(
        [1.0, 2.0, 0.0, 0.0, 0.0, spin], rel=1e-9, abs=1e-9
    )
    assert simulation.rigid_poses[0].position == pytest.approx(
        [steps * dt, 4.0 * dt**2 * steps * (steps + 1) / 2.0, 0.0], rel=1e-9, abs=1e-12
    )
    simulation.set_body_velocity("box", angular_velocity=(0.0, 1.0, 0.0))
    assert simulation.rigid_velocities[0] == pytest.approx([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])


def test_a_rigid_body_goes_on_from_where_it_is_put(backend: str) -> None:
    falling = SceneDescription(name="fall", rigid_bodies=(box(mass=0.5, velocity=(1.0, 0.0, 0.0)),))
    simulation = Simulation(falling, backend)  # type: ignore[arg-type]
    simulation.step()
    before = simulation.rigid_velocities
    simulation.place_rigid_body("box", (3.0, 4.0, 5.0), (0.6 * 1.0005, 0.0, 0.0, 0.8 * 1.0005))
    assert simulation.rigid_poses[0].position == pytest.approx([3.0, 4.0, 5.0])
    assert simulation.rigid_poses[0].quaternion_xyzw == pytest.approx([0.6, 0.0, 0.0, 0.8])
    assert simulation.rigid_velocities == pytest.approx(before)
    simulation.step()
    fallen = 9.81 * simulation.dt**2 * 2.0
    assert simulation.rigid_poses[0].position == pytest.approx([3.0 + simulation.dt, 4.0, 5.0 - fallen])


@pytest.mark.parametrize(
    ("body", "position", "quaternion", "told"),
    [
        ("ball", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "unknown rigid body with mass 'ball'; known: box"),
        ("box", (0.0, 0.0), (0.0, 0.0, 0.0, 1.0), r"position of shape \(2,\) refused"),
        ("box", (0.0, 0.0, np.nan), (0.0, 0.0, 0.0, 1.0), "not finite"),
        ("box", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "quaternion of length 0 refused: expected 1"),
        ("box", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.1), "quaternion of length 1.1 refused"),
    ],
)
def test_places_that_are_none_are_refused(body: str, position: Any, quaternion: Any, told: str) -> None:
    simulation = Simulation(SceneDescription(name="stay", rigid_bodies=(box(mass=0.5),)))
    before = simulation.snapshot()
    with pytest.raises(CommandError, match=told):
        simulation.place_rigid_body(body, position, quaternion)
    assert simulation.snapshot() == before


def test_a_moment_in_world_axes_turns_a_tilted_body() -> None:
    tilted = box(mass=0.5, pose=Placement(rotation_deg=(20.0, 30.0, 40.0)))
    simulation = Simulation(SceneDescription(name="turn", gravity=NO_GRAVITY, rigid_bodies=(tilted,)))
    simulation.rigid_forces = [[0.0, 0.0, 0.0, 1e-5, -2e-5, 3e-5]]
    rigid = simulation.model.rigid
    for _ in range(100):
        simulation.step()
    rotation = simulation._state.rigid_rotations[0]
    momentum = rotation @ rigid.inertia[0] @ rotation.T @ simulation.rigid_velocities[0, 3:]
    assert momentum == pytest.approx(np.array([1e-5, -2e-5, 3e-5]) * simulation.time, rel=1e-9)


def test_loads_and_velocities_are_part_of_a_snapshot() -> None:
    simulation = Simulation(SceneDescription(name="throw", rigid_bodies=(box(mass=0.5),)))
    simulation.rigid_forces[:] = 0.3
    simulation.step()
    saved = simulation.snapshot()
    simulation.step()
    later = simulation.snapshot()
    simulation.rigid_forces[:] = 0.0
    simulation.restore(saved)
    simulation.step()
    assert simulation.snapshot() == later
    simulation.reset()
    assert not simulation.rigid_forces.any()


def test_loads_of_a_wrong_shape_are_refused() -> None:
    simulation = Simulation(SceneDescription(name="throw", rigid_bodies=(box(mass=0.5),)))
    with pytest.raises(CommandError, match=r"rigid_forces of shape \(6,\) refused: expected shape \(1, 6\)"):
        simulation.rigid_forces = np.zeros(6)


def test_what_is_carried_has_no_velocity_of_its_own() -> None:
    with pytest.raises(SceneError, match="remove `velocity`"):
        box(velocity=(1.0, 0.0, 0.0))
    with pytest.raises(SceneError, match="velocity must be finite"):
        bar(velocity=(np.nan, 0.0, 0.0))
