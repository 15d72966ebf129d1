"""Stable neo-Hookean rubber: closed forms, inversion, contact, mixed scenes, the Tripod and its inverse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_forms import hooke_stress
from contact_scenes import FLOOR, touching
from numpy.linalg import norm
from small_scenes import body, scene, slab

from softsim_core import Pose, Simulation, load_scene
from softsim_core.base import Array
from softsim_core.control.inverse import InverseController, effector
from softsim_core.physics.dynamics import make_stepper
from softsim_core.physics.fem.materials import material
from softsim_core.physics.mechanics import Control
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import BodyDescription, MaterialDescription
from softsim_core.scene.building import build

LAW = material("stable_neo_hookean")
YOUNG, POISSON = 1e5, 0.4
START, SHIFT = np.full(3, -1.4965), 0.035
"""Joints in [rad] and base shift in [m] of the Tripod at the end of its start move."""


def rubber(name: str = "body", cells: int = 2, **values: float) -> BodyDescription:
    values = {"young_modulus": YOUNG, "poisson_ratio": POISSON, **values}
    block = body(
        box_mesh((0.04, 0.04, 0.04), (cells, cells, cells), (-0.02, -0.02, 0.0), name), name, total_mass=0.05
    )
    return replace(block, material=MaterialDescription(law="stable_neo_hookean", **values))


def uniaxial(stretch: float) -> tuple[float, float]:
    """Stretch across and first Piola stress along a free bar of `stretch`, written out from the energy alone.

    Psi(a, b) = mu / 2 (a^2 + 2 b^2 - ln(a^2 + 2 b^2 + 1)) + lambda / 2 (a b^2 - alpha)^2 with dPsi/db = 0.
    """
    lame_mu = YOUNG / (2.0 * (1.0 + POISSON))
    lame_lam = YOUNG * POISSON / ((1.0 + POISSON) * (1.0 - 2.0 * POISSON))
    mu, lam = 4.0 / 3.0 * lame_mu, lame_lam + 5.0 / 6.0 * lame_mu
    alpha = 1.0 + 0.75 * mu / lam
    low, high = 0.2, 2.0
    for _ in range(200):
        b = 0.5 * (low + high)
        rest = 1.0 - 1.0 / (stretch**2 + 2.0 * b**2 + 1.0)
        slope = mu * rest + lam * (stretch * b**2 - alpha) * stretch
        low, high = (b, high) if slope < 0.0 else (low, b)
    return b, mu * rest * stretch + lam * (stretch * b**2 - alpha) * b**2


@pytest.mark.parametrize("stretch", [0.5, 0.8, 1.3, 2.0])
def test_a_pulled_bar_is_that_of_the_closed_form(stretch: float) -> None:
    """The solver finds how thin it gets, and the force that holds it, at large strain."""
    bar = rubber()
    held = (slab("left", "world", 0.02, stiffness=1e7), slab("right", "world", -0.02, stiffness=1e7))
    ready = build(scene(bar, attachments=held, gravity=(0.0, 0.0, 0.0)))
    across, expected = uniaxial(stretch)
    deformation = np.diag([stretch, across, across])
    stress = LAW.stress(deformation, np.array([YOUNG, POISSON]))
    assert stress[0, 0] == pytest.approx(expected, rel=1e-9)
    assert np.abs(stress - np.diag(np.diag(stress))).max() < 1e-9 * YOUNG
    assert np.abs(stress[[1, 2], [1, 2]]).max() < 1e-9 * YOUNG
    assert ready.model.groups[0].material is LAW


def test_small_strain_is_hookes() -> None:
    gradient = 1e-6 * np.random.default_rng(0).uniform(-1.0, 1.0, (3, 3))
    stress = LAW.stress(np.eye(3) + gradient, np.array([YOUNG, POISSON]))
    np.testing.assert_allclose(
        stress, hooke_stress(gradient, YOUNG, POISSON), atol=1e-5 * np.abs(stress).max()
    )


@pytest.mark.parametrize("seed", range(2))
def test_a_crumpled_block_finds_its_shape(backend: str, seed: int) -> None:
    """Nodes thrown about by up to 0.8 edge lengths, a seventh of the elements and more inside out."""
    ready = build(scene(rubber(), rayleigh_mass=5.0, gravity=(0.0, 0.0, 0.0)))
    model, rng = ready.model, np.random.default_rng(seed)
    state = model.rest_state()
    state.positions[:] += rng.uniform(-0.016, 0.016, state.positions.shape)
    cells = state.positions[model.groups[0].cells]
    turned = np.linalg.det(cells[:, 1:] - cells[:, :1]) * np.linalg.det(
        model.rest[model.groups[0].cells][:, 1:] - model.rest[model.groups[0].cells][:, :1]
    )
    assert (turned < 0.0).mean() > 0.14
    stepper, still = make_stepper(model, backend), Control(np.zeros(0), np.zeros_like(model.rest))
    for _ in range(200):
        stepper.step(state, still, ready.parameters)
    apart = norm(state.positions[:, None] - state.positions, axis=-1)
    np.testing.assert_allclose(apart, norm(model.rest[:, None] - model.rest, axis=-1), atol=1e-6)


def test_it_falls_on_a_floor_and_stays_there() -> None:
    block = rubber(young_modulus=3e4)
    block = replace(block, mesh=box_mesh((0.04, 0.04, 0.04), (2, 2, 2), (-0.02, -0.02, 0.01)))
    simulation = Simulation(touching(FLOOR, soft=(block,), rayleigh_stiffness=0.01))
    for _ in range(150):
        simulation.step()
    assert np.abs(simulation.velocities).max() < 1e-4
    assert -0.001 < simulation.positions[:, 2].min() < 0.002
    assert simulation.positions[:, 2].max() > 0.035


def test_two_laws_in_one_scene_move_as_each_alone(backend: str) -> None:
    """Bodies that do not touch do not feel each other's law."""
    other = replace(
        body(box_mesh((0.04, 0.04, 0.04), (2, 2, 2), (0.1, -0.02, 0.0), "other"), "other"), total_mass=0.05
    )
    held = {"body": slab("a", "world", -0.02), "other": slab("b", "world", 0.1, "other")}
    together = Simulation(scene(rubber(), other, attachments=tuple(held.values())), backend=backend)  # type: ignore[arg-type]
    alone = [
        Simulation(scene(each, attachments=(held[each.name],)), backend=backend)  # type: ignore[arg-type]
        for each in (rubber(), other)
    ]
    for _ in range(20):
        for simulation in (together, *alone):
            simulation.step()
    assert len(together.model.groups) == 2
    expected = np.concatenate([each.positions for each in alone])
    np.testing.assert_allclose(together.positions, expected, atol=1e-12)
    stress = np.concatenate([each.von_mises() for each in alone])
    np.testing.assert_allclose(together.von_mises(), stress, rtol=1e-6, atol=1e-6 * stress.max())


def tripod(law: str) -> Simulation:
    made_of = {"law": law, "young_modulus": 250e3, "poisson_ratio": 0.45}
    overrides = {"bodies": [{"name": "silicone", "material": made_of}]}
    return Simulation(replace(load_scene("tripod", kind="robots", overrides=overrides), start=None))


def pose_at(simulation: Simulation, joints: Array) -> Array:
    solution = simulation.equilibrium(joints, SHIFT)
    return np.asarray(solution.state.frame_positions[0])


@pytest.mark.slow
@pytest.mark.parametrize(("angle", "apart_mm"), [(-1.4965, 1.5), (-1.0, 0.6), (-0.5, 1.5)])
def test_poses_of_the_tripod_are_near_those_of_the_corotational_law(angle: float, apart_mm: float) -> None:
    """Its silicone bends more than it stretches, so the laws differ by little."""
    joints = np.full(3, angle)
    ours, linear = (pose_at(tripod(law), joints) for law in ("stable_neo_hookean", "corotational"))
    assert 1e3 * norm(ours - linear) < apart_mm


@pytest.mark.slow
@pytest.mark.numba
def test_the_tripod_of_rubber_reaches_a_goal() -> None:
    pytest.importorskip("numba")
    made_of = {"law": "stable_neo_hookean", "young_modulus": 250e3, "poisson_ratio": 0.45}
    overrides = {"bodies": [{"name": "silicone", "material": made_of}]}
    controller = InverseController(load_scene("tripod", kind="robots", overrides=overrides))
    controller.start(START, SHIFT)
    pose = effector(controller.model)
    controller.set_goal(Pose(pose.position + np.array([0.002, -0.001, 0.004]), pose.quaternion_xyzw))
    for _ in range(50):
        report = controller.tick()
    assert report.status == "reached"
    assert report.residual_m < 1e-4
