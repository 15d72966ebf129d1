"""Linear tetrahedra: rigid motions cost nothing, tangents are derivatives, patches are exact."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from closed_forms import hooke_stress
from numpy.random import Generator
from small_scenes import body, jittered, scene

from softsim_core.base import Array
from softsim_core.physics.dynamics import solve_static
from softsim_core.physics.fem import (
    ElementGroup,
    cauchy_stress,
    cell_energy,
    cell_forces,
    cell_stiffness,
    deformation_gradients,
    element_group,
    von_mises_stress,
)
from softsim_core.physics.fem.elements import element
from softsim_core.physics.fem.materials import lame, material, von_mises
from softsim_core.physics.mechanics import FIXED, Control, rotation_exp
from softsim_core.physics.mesh import boundary, box_mesh
from softsim_core.scene import MaterialDescription
from softsim_core.scene.building import build

LAWS = ("corotational", "corotational_qr", "stable_neo_hookean")
WITH_POTENTIAL = ("corotational", "stable_neo_hookean")
YOUNG, POISSON = 3.0, 0.3
VALUES = np.array([[YOUNG, POISSON]])


def random_element(rng: Generator, law: str) -> tuple[Array, ElementGroup]:
    """A random, not too flat tetrahedron: corners (4, 3) and its group."""
    one = np.zeros(1, np.int64)
    while True:
        corners = rng.normal(size=(4, 3))
        group = element_group(element("tet4"), material(law), corners, np.array([[0, 1, 2, 3]]), one, one)
        if group.volumes[0] > 0.2:
            return corners, group


def random_rotation(rng: Generator) -> Array:
    return rotation_exp(rng.uniform(-np.pi, np.pi, 3))


def stress_and_forces(group: ElementGroup, corners: Array) -> tuple[Array, Array]:
    """Stress (3, 3) and forces on the corners (4, 3)."""
    stress = cauchy_stress(group, corners, VALUES)
    return stress[0, 0], cell_forces(group, corners, VALUES)[0]


def energy(group: ElementGroup, corners: Array) -> float:
    return float(cell_energy(group, corners, VALUES)[0])


def numerical_tangent(group: ElementGroup, corners: Array) -> Array:
    """-df/dx (12, 12) by central differences."""
    tangent, step = np.empty((12, 12)), 1e-6
    for k in range(12):
        move = np.zeros(12)
        move[k] = step
        ahead = stress_and_forces(group, corners + move.reshape(4, 3))[1]
        behind = stress_and_forces(group, corners - move.reshape(4, 3))[1]
        tangent[:, k] = -(ahead - behind).ravel() / (2.0 * step)
    return tangent


def as_matrix(blocks: Array) -> Array:
    return blocks[0].transpose(0, 2, 1, 3).reshape(12, 12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(5))
def test_rigid_motions_cost_nothing(law: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, group = random_element(rng, law)
    moved = rest @ random_rotation(rng).T + rng.normal(size=3)
    stress, forces = stress_and_forces(group, moved)
    assert np.abs(stress).max() < 1e-11 * YOUNG
    assert np.abs(forces).max() < 1e-11 * YOUNG
    assert abs(energy(group, moved)) < 1e-14


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(5))
def test_stress_turns_with_the_body(law: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, group = random_element(rng, law)
    bent = rest + 0.3 * rng.normal(size=(4, 3))
    turn = random_rotation(rng)
    stress, forces = stress_and_forces(group, bent)
    turned_stress, turned_forces = stress_and_forces(group, bent @ turn.T + rng.normal(size=3))
    np.testing.assert_allclose(turned_stress, turn @ stress @ turn.T, atol=1e-12)
    np.testing.assert_allclose(turned_forces, forces @ turn.T, atol=1e-12)
    assert von_mises(turned_stress[None])[0] == pytest.approx(von_mises(stress[None])[0], rel=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_forces_of_an_element_balance(law: str) -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        rest, group = random_element(rng, law)
        bent = rest + 0.4 * rng.normal(size=(4, 3))
        _, forces = stress_and_forces(group, bent)
        assert np.abs(forces.sum(axis=0)).max() < 1e-13
        if law in WITH_POTENTIAL:  # derived from a potential that no rotation changes
            assert np.abs(np.cross(bent, forces).sum(axis=0)).max() < 1e-12


@pytest.mark.parametrize("law", WITH_POTENTIAL)
def test_force_is_the_slope_of_the_energy(law: str) -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        rest, group = random_element(rng, law)
        bent, way = rest + 0.3 * rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
        slope = (energy(group, bent + 1e-6 * way) - energy(group, bent - 1e-6 * way)) / 2e-6
        _, forces = stress_and_forces(group, bent)
        assert -(forces * way).sum() == pytest.approx(slope, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("turned", [False, True])
def test_positive_stiffness_is_the_tangent_of_an_unstrained_element(law: str, turned: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        rest, group = random_element(rng, law)
        corners = rest @ random_rotation(rng).T if turned else rest
        stiffness = as_matrix(cell_stiffness(group, corners, VALUES, positive=True))
        scale = np.abs(stiffness).max()
        np.testing.assert_allclose(stiffness, numerical_tangent(group, corners), atol=1e-8 * scale)
        np.testing.assert_allclose(stiffness, stiffness.T, atol=1e-14 * scale)
        assert np.linalg.eigvalsh(stiffness)[:6] == pytest.approx(np.zeros(6), abs=1e-12 * scale)  # rigid
        assert np.linalg.eigvalsh(stiffness)[6] > 1e-3 * scale


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("inverted", [False, True])
def test_exact_tangent_is_the_derivative_of_the_force(law: str, inverted: bool) -> None:
    rng = np.random.default_rng(4)
    checked = 0
    while checked < 10:
        rest, group = random_element(rng, law)
        corners = rest @ random_rotation(rng).T + 0.5 * rng.normal(size=(4, 3))
        singular_values = np.linalg.svd(deformation_gradients(group, corners)[0, 0])[1]
        sign = np.sign(np.linalg.det(deformation_gradients(group, corners)[0, 0]))
        if (sign < 0.0) != inverted or singular_values[1] + sign * singular_values[2] < 0.2:
            continue  # near a jump of the polar rotation, or not of the kind asked for
        if np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])) < 0.5:
            continue  # near a jump of the frame
        tangent = as_matrix(cell_stiffness(group, corners, VALUES))
        scale = np.abs(tangent).max()
        np.testing.assert_allclose(tangent, numerical_tangent(group, corners), atol=1e-7 * scale)
        if law in WITH_POTENTIAL:
            np.testing.assert_allclose(tangent, tangent.T, atol=1e-13 * scale)
        checked += 1


def deformed(rng: Generator, stretches: Array) -> tuple[Array, ElementGroup]:
    """An element with given principal stretches (3,), turned at random: corners (4, 3) and its group."""
    rest, group = random_element(rng, "corotational")
    return rest @ (random_rotation(rng) @ np.diag(stretches) @ random_rotation(rng)).T, group


STRETCHES = [
    *np.random.default_rng(7).uniform(0.4, 1.6, (20, 3)),
    *np.random.default_rng(8).uniform(0.95, 1.05, (20, 3)),
    np.array([1.2, 1.2, 1.2]),
    np.array([0.8, 0.8, 0.8]),
    np.array([1.1, 0.95, 0.95]),
    np.array([0.9, 1.05, 1.05]),
    np.array([1.5, 0.7, -0.3]),
    np.array([0.5, 0.4, -0.2]),
    np.array([2.5, 2.5, 2.0]),
    np.array([1.0, 1.0, 1.0]),
]
"""None to three negative modes; equal stretches; inside out; far overstretched."""


@pytest.mark.parametrize("stretches", STRETCHES, ids=str)
def test_clamped_tangent_takes_negative_eigenvalues_of_the_hessian_as_zero(stretches: Array) -> None:
    """By the eigenvalues of dP/dF (9, 9), itself taken from four unit elements: h_a runs over the axes."""
    corners, group = deformed(np.random.default_rng(9), stretches)
    gradients = group.gradients[0, 0]
    spread = np.kron(gradients, np.eye(3))  # node positions from F, by rows: x_a = F g_a, transposed
    inverse = np.linalg.pinv(spread)
    hessian = inverse @ as_matrix(cell_stiffness(group, corners, VALUES)) @ inverse.T
    values, modes = np.linalg.eigh(0.5 * (hessian + hessian.T))
    expected = spread @ (modes * np.maximum(values, 0.0)) @ modes.T @ spread.T
    clamped = as_matrix(cell_stiffness(group, corners, VALUES, positive=True))
    np.testing.assert_allclose(clamped, expected, atol=1e-11 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize("way", ["clamped", "exact", "frozen"])
def test_compiled_elements_are_those_of_numpy(way: str) -> None:
    """Forces ahead of x and stiffness of one element, clamped, exact and frozen."""
    pytest.importorskip("numba")
    rng = np.random.default_rng(10)
    for stretches in STRETCHES:
        corners, group = deformed(rng, stretches)
        move = 1e-2 * rng.normal(size=(4, 3))
        if way == "frozen":
            rotation = group.material.rotations(deformation_gradients(group, corners))[0, 0]
            expected = as_matrix(frozen_stiffness(group, rotation))
        else:
            expected = as_matrix(cell_stiffness(group, corners, VALUES, positive=way == "clamped"))
        forces = stress_and_forces(group, corners)[1] - (expected @ move.ravel()).reshape(4, 3)
        found, stiffness = compiled_element(group, corners, move, way)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(stiffness, expected, atol=1e-11 * scale)
        np.testing.assert_allclose(found, forces, atol=1e-11 * scale)


def frozen_stiffness(group: ElementGroup, rotation: Array) -> Array:
    """Blocks (1, 4, 4, 3, 3) of Hooke's law in turned axes: V (lam h_a h_b + mu h_b h_a + mu h_a.h_b I)."""
    h = group.gradients[0, 0] @ rotation.T
    lam, mu = (float(each) for each in lame(VALUES[0]))
    outer = np.einsum("ai,bj->abij", h, h)
    blocks = lam * outer + mu * np.swapaxes(outer, 2, 3) + mu * (h @ h.T)[..., None, None] * np.eye(3)
    return np.asarray(group.volumes[0] * blocks[None])


@cache
def compiled_batch(way: str) -> Any:
    """A kernel around the vector code."""
    from numba import njit

    from softsim_core.physics.dynamics.numba_backend import elements, nearest_rotations

    rotations, turning, frozen = elements.polar_rotations, elements.turning_batch, elements.frozen_batch
    exact, is_frozen = way == "exact", way == "frozen"

    @njit
    def run(x, ahead, nodes, gradients, lame, room, turn, forces, blocks):  # type: ignore[no-untyped-def]
        turned = np.empty((12, room.shape[1]))
        if rotations(x, nodes, gradients, 0, room, turn):
            nearest_rotations(room, turn)
        elements.turn_gradients(turn, gradients, 0, turned)
        if is_frozen:
            frozen(ahead, 1.0, nodes, lame, 0, turned, forces, blocks)
        else:
            turning(ahead, exact, 1.0, nodes, lame, 0, room, turn, turned, forces, blocks)

    return run


def compiled_element(group: ElementGroup, corners: Array, move: Array, way: str) -> tuple[Array, Array]:
    """Forces (4, 3) and stiffness (12, 12) of an element in the first lane of a batch, alone in it."""
    from softsim_core.physics.linalg import LANES

    nodes = np.repeat(np.arange(4)[None, :, None], LANES, axis=2)
    gradients = np.repeat(group.gradients.reshape(1, 12, 1), LANES, axis=2)
    moduli = np.zeros((1, 2, LANES))
    moduli[0, :, 0] = np.array(lame(VALUES[0])) * group.volumes[0]
    forces, blocks = np.zeros((4, 4)), np.zeros((30, LANES, 4))
    room, turn = np.zeros((2, 9, LANES))
    compiled_batch(way)(corners, corners + move, nodes, gradients, moduli, room, turn, forces, blocks)
    stiffness, pair = np.zeros((4, 3, 4, 3)), 0
    for a in range(4):
        for b in range(a, 4):
            block = blocks[3 * pair : 3 * pair + 3, 0, :3]
            stiffness[a, :, b], stiffness[b, :, a] = block, block.T
            pair += 1
    return forces[:, :3], stiffness.reshape(12, 12)


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
        ("corotational", 1e-6, 1e-9),
        ("corotational", 0.2, 1e-9),  # one rotation for all elements: exact at any strain
        ("stable_neo_hookean", 1e-6, 1e-9),
        ("stable_neo_hookean", 0.2, 1e-9),
        ("corotational_qr", 1e-6, 1e-5),  # every element has its own frame: exact at small strain
    ],
)
def test_patch(law: str, size: float, tolerance: float) -> None:
    """Boundary moved by a linear field: inner nodes follow it, and the stress is the same everywhere."""
    mesh = jittered(box_mesh((1.0, 0.8, 0.6), (4, 3, 3)), 0.06, seed=5)
    made_of = MaterialDescription(law=law, young_modulus=YOUNG, poisson_ratio=POISSON)
    built = build(scene(replace(body(mesh), material=made_of), gravity=(0.0, 0.0, 0.0)))
    region_of_node = built.model.region_of_node.copy()
    region_of_node[np.unique(boundary(mesh))] = FIXED
    model = replace(built.model, region_of_node=region_of_node)
    assert len(model.free_nodes) == 3 * 2 * 2
    gradient = size * np.random.default_rng(6).uniform(-1.0, 1.0, (3, 3))
    expected = model.rest @ (np.eye(3) + gradient).T
    state = model.rest_state()
    state.positions[region_of_node == FIXED] = expected[region_of_node == FIXED]
    inputs = Control(np.zeros(0), np.zeros_like(model.rest))
    solved = solve_static(model, state, inputs, built.parameters, tolerance=1e-14).state.positions
    np.testing.assert_allclose(solved, expected, rtol=0, atol=tolerance * size)

    group = model.groups[0]
    stress = cauchy_stress(group, solved, VALUES)[:, 0]
    scale = np.abs(stress).max()
    np.testing.assert_allclose(stress, np.broadcast_to(stress[0], stress.shape), atol=10 * tolerance * scale)
    shown = von_mises_stress(model.groups, solved, built.parameters.materials)
    np.testing.assert_allclose(shown, np.full(len(stress), von_mises(stress[0])), rtol=20 * tolerance)
    if size < 1e-3:
        assert np.abs(stress[0] - hooke_stress(gradient, YOUNG, POISSON)).max() < 1e-5 * scale
