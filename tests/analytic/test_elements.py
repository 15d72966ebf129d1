"""Corotational tetrahedra: rigid motions cost nothing, tangents are derivatives, patches are exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_forms import hooke_stress
from numpy.random import Generator
from small_scenes import body, jittered, scene

from softsim_core.arrays import Array
from softsim_core.dynamics.statics import solve_static
from softsim_core.dynamics.stepper import Inputs
from softsim_core.fem.corotational import (
    deformation_gradients,
    element_rotations,
    exact_tangent_blocks,
    polar_rotations,
    stiffness_blocks,
    stresses,
    von_mises,
)
from softsim_core.fem.material import LinearMaterial
from softsim_core.fem.tetrahedra import Tetrahedra, rest_tetrahedra
from softsim_core.mechanics.model import HELD
from softsim_core.mechanics.pose import rotation_exp
from softsim_core.mesh import boundary, box_mesh
from softsim_core.scene.builder import build

LAWS = ("polar", "qr")
YOUNG, POISSON = 3.0, 0.3
LAME = np.array([LinearMaterial(YOUNG, POISSON).lame])


def random_element(rng: Generator) -> tuple[Array, Tetrahedra]:
    """A random, not too flat tetrahedron: corners (4, 3) and its rest data."""
    while True:
        corners = rng.normal(size=(4, 3))
        element = rest_tetrahedra(corners, np.array([[0, 1, 2, 3]]))
        if element.volumes[0] > 0.2:
            return corners, element


def random_rotation(rng: Generator) -> Array:
    return rotation_exp(rng.uniform(-np.pi, np.pi, 3))


def stress_and_forces(element: Tetrahedra, corners: Array, law: str) -> tuple[Array, Array]:
    """Stress (3, 3) and forces on the corners (4, 3)."""
    rotation = element_rotations(corners[None], element.gradients, law)
    rotated = element.gradients @ np.swapaxes(rotation, 1, 2)
    stress = stresses(corners[None], rotated, LAME)
    return stress[0], -element.volumes[0] * rotated[0] @ stress[0]


def energy(element: Tetrahedra, corners: Array) -> float:
    """Elastic energy of the polar law: V (lambda / 2 tr(E)^2 + mu E : E), E = R^T F - I."""
    deformation = deformation_gradients(corners[None], element.gradients)[0]
    strain = polar_rotations(deformation[None])[0].T @ deformation - np.eye(3)
    lam, mu = LAME[0]
    return float(element.volumes[0] * (0.5 * lam * np.trace(strain) ** 2 + mu * (strain * strain).sum()))


def numerical_tangent(element: Tetrahedra, corners: Array, law: str) -> Array:
    """-df/dx (12, 12) by central differences."""
    tangent, step = np.empty((12, 12)), 1e-6
    for k in range(12):
        move = np.zeros(12)
        move[k] = step
        ahead = stress_and_forces(element, corners + move.reshape(4, 3), law)[1]
        behind = stress_and_forces(element, corners - move.reshape(4, 3), law)[1]
        tangent[:, k] = -(ahead - behind).ravel() / (2.0 * step)
    return tangent


def as_matrix(blocks: Array) -> Array:
    return blocks[0].transpose(0, 2, 1, 3).reshape(12, 12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(5))
def test_rigid_motions_cost_nothing(law: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, element = random_element(rng)
    moved = rest @ random_rotation(rng).T + rng.normal(size=3)
    stress, forces = stress_and_forces(element, moved, law)
    assert np.abs(stress).max() < 1e-13 * YOUNG
    assert np.abs(forces).max() < 1e-12 * YOUNG
    assert energy(element, moved) < 1e-24


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(5))
def test_stress_turns_with_the_body(law: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, element = random_element(rng)
    bent = rest + 0.3 * rng.normal(size=(4, 3))
    turn = random_rotation(rng)
    stress, forces = stress_and_forces(element, bent, law)
    turned_stress, turned_forces = stress_and_forces(element, bent @ turn.T + rng.normal(size=3), law)
    np.testing.assert_allclose(turned_stress, turn @ stress @ turn.T, atol=1e-12)
    np.testing.assert_allclose(turned_forces, forces @ turn.T, atol=1e-12)
    assert von_mises(turned_stress[None])[0] == pytest.approx(von_mises(stress[None])[0], rel=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_forces_of_an_element_balance(law: str) -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        rest, element = random_element(rng)
        bent = rest + 0.4 * rng.normal(size=(4, 3))
        _, forces = stress_and_forces(element, bent, law)
        assert np.abs(forces.sum(axis=0)).max() < 1e-13
        if law == "polar":  # derived from a potential that no rotation changes
            assert np.abs(np.cross(bent, forces).sum(axis=0)).max() < 1e-12


def test_polar_force_is_the_slope_of_the_energy() -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        rest, element = random_element(rng)
        bent, way = rest + 0.3 * rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
        slope = (energy(element, bent + 1e-6 * way) - energy(element, bent - 1e-6 * way)) / 2e-6
        _, forces = stress_and_forces(element, bent, "polar")
        assert -(forces * way).sum() == pytest.approx(slope, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("turned", [False, True])
def test_warped_stiffness_is_the_tangent_of_an_unstrained_element(law: str, turned: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        rest, element = random_element(rng)
        corners = rest @ random_rotation(rng).T if turned else rest
        rotated = element.gradients @ np.swapaxes(
            element_rotations(corners[None], element.gradients, law), 1, 2
        )
        stiffness = as_matrix(stiffness_blocks(rotated, element.volumes, LAME))
        scale = np.abs(stiffness).max()
        np.testing.assert_allclose(stiffness, numerical_tangent(element, corners, law), atol=1e-8 * scale)
        np.testing.assert_allclose(stiffness, stiffness.T, atol=1e-14 * scale)
        assert np.linalg.eigvalsh(stiffness)[:6] == pytest.approx(np.zeros(6), abs=1e-12 * scale)  # rigid
        assert np.linalg.eigvalsh(stiffness)[6] > 1e-3 * scale


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("inverted", [False, True])
def test_exact_tangent_is_the_derivative_of_the_force(law: str, inverted: bool) -> None:
    rng = np.random.default_rng(4)
    checked = 0
    while checked < 10:
        rest, element = random_element(rng)
        corners = rest @ random_rotation(rng).T + 0.5 * rng.normal(size=(4, 3))
        singular_values = np.linalg.svd(deformation_gradients(corners[None], element.gradients)[0])[1]
        sign = np.sign(np.linalg.det(deformation_gradients(corners[None], element.gradients)[0]))
        if (sign < 0.0) != inverted or singular_values[1] + sign * singular_values[2] < 0.2:
            continue  # near a jump of the polar rotation, or not of the kind asked for
        if np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])) < 0.5:
            continue  # near a jump of the frame
        tangent = as_matrix(
            exact_tangent_blocks(corners[None], element.gradients, element.volumes, LAME, law)
        )
        scale = np.abs(tangent).max()
        np.testing.assert_allclose(tangent, numerical_tangent(element, corners, law), atol=1e-7 * scale)
        if law == "polar":
            np.testing.assert_allclose(tangent, tangent.T, atol=1e-13 * scale)
        checked += 1


@pytest.mark.parametrize(
    ("stress", "expected"),
    [
        (np.diag([7.0, 0.0, 0.0]), 7.0),  # pull
        (np.diag([0.0, -7.0, 0.0]), 7.0),  # push
        (np.diag([5.0, 5.0, 5.0]), 0.0),  # pressure
        (np.array([[0.0, 2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), 2.0 * np.sqrt(3.0)),  # shear
        (np.diag([3.0, 3.0, 0.0]), 3.0),  # both ways in a plane
        (np.diag([1.0, 0.0, -1.0]), np.sqrt(3.0)),
    ],
)
def test_von_mises_of_known_stresses(stress: Array, expected: float) -> None:
    turn = random_rotation(np.random.default_rng(0))
    assert von_mises(stress[None])[0] == pytest.approx(expected, abs=1e-12)
    assert von_mises((turn @ stress @ turn.T)[None])[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("law", "size", "tolerance"),
    [
        ("polar", 1e-6, 1e-9),
        ("polar", 0.2, 1e-9),  # one rotation for all elements: exact at any strain
        ("qr", 1e-6, 1e-5),  # every element has its own frame: exact in the limit of small strain
    ],
)
def test_patch(law: str, size: float, tolerance: float) -> None:
    """Boundary moved by a linear field: inner nodes follow it, and the stress is the same everywhere."""
    mesh = jittered(box_mesh((1.0, 0.8, 0.6), (4, 3, 3)), 0.06, seed=5)
    built = build(
        scene(body(mesh, young_modulus=YOUNG, poisson_ratio=POISSON), law=law, gravity=(0.0, 0.0, 0.0))
    )
    zone_of_node = built.model.zone_of_node.copy()
    zone_of_node[np.unique(boundary(mesh))] = HELD
    model = replace(built.model, zone_of_node=zone_of_node)
    assert len(model.free_nodes) == 3 * 2 * 2
    gradient = size * np.random.default_rng(6).uniform(-1.0, 1.0, (3, 3))
    expected = model.rest @ (np.eye(3) + gradient).T
    state = model.rest_state()
    state.positions[zone_of_node == HELD] = expected[zone_of_node == HELD]
    inputs = Inputs(np.zeros(0), np.zeros_like(model.rest))
    solved = solve_static(model, state, inputs, built.parameters, tolerance=1e-14).state.positions
    np.testing.assert_allclose(solved, expected, rtol=0, atol=tolerance * size)

    corners = solved[model.elements.nodes]
    rotation = element_rotations(corners, model.elements.gradients, law)
    stress = stresses(
        corners, model.elements.gradients @ np.swapaxes(rotation, 1, 2), LAME.repeat(len(corners), 0)
    )
    scale = np.abs(stress).max()
    np.testing.assert_allclose(stress, np.broadcast_to(stress[0], stress.shape), atol=10 * tolerance * scale)
    if size < 1e-3:
        assert np.abs(stress[0] - hooke_stress(gradient, YOUNG, POISSON)).max() < 1e-5 * scale
