"""Stress at the nodes: exact where it is linear, and what the page colours with."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_scenes import body, jittered, scene, slab

from softsim_core import Simulation
from softsim_core.base import Array
from softsim_core.physics.fem import elastic_forces
from softsim_core.physics.fem.materials import von_mises
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import BodyDescription, MaterialDescription

YOUNG, POISSON = 1e5, 0.3
SHEAR = YOUNG / (2.0 * (1.0 + POISSON))


def patch(law: str, order: int, seed: int = 0) -> Simulation:
    mesh = jittered(box_mesh((0.03, 0.02, 0.02), (3, 2, 2), (-0.01, -0.01, -0.01)), 0.002, seed)
    material = MaterialDescription(law=law, young_modulus=YOUNG, poisson_ratio=POISSON)
    return Simulation(scene(replace(body(mesh), material=material, order=order)))


def displaced(simulation: Simulation, moved: Array) -> Simulation:
    simulation._state.positions[:] = simulation.model.rest + moved
    return simulation


@pytest.mark.parametrize("law", ["corotational", "stable_neo_hookean"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_linear_stress_is_exact_at_every_node_of_quadratic_cells(law: str, seed: int) -> None:
    """Shear u_x = c y z: the stress is c mu z between x and y, and c mu y between x and z."""
    simulation, rate = patch(law, 2, seed), 1e-4
    _, y, z = simulation.model.rest.T
    displaced(simulation, np.stack([rate * y * z, 0.0 * y, 0.0 * y], axis=1))
    expected = np.zeros((len(y), 3, 3))
    expected[:, 0, 1] = expected[:, 1, 0] = rate * SHEAR * z
    expected[:, 0, 2] = expected[:, 2, 0] = rate * SHEAR * y
    scale = rate * SHEAR * 0.01
    np.testing.assert_allclose(simulation.stress(), expected, atol=2e-4 * scale)
    np.testing.assert_allclose(
        simulation.von_mises(), np.sqrt(3.0) * rate * SHEAR * np.hypot(y, z), atol=1e-3 * scale
    )


@pytest.mark.parametrize("order", [1, 2])
def test_a_uniform_stress_is_exact_on_any_cells(order: int) -> None:
    rng = np.random.default_rng(4)
    simulation = patch("stable_neo_hookean", order)
    gradient = 1e-6 * rng.normal(size=(3, 3))
    displaced(simulation, simulation.model.rest @ gradient.T)
    strain = 0.5 * (gradient + gradient.T)
    lame = 2.0 * SHEAR * POISSON / (1.0 - 2.0 * POISSON)
    expected = 2.0 * SHEAR * strain + lame * np.trace(strain) * np.eye(3)
    stress = simulation.stress()
    np.testing.assert_allclose(
        stress, np.broadcast_to(expected, stress.shape), atol=2e-4 * np.abs(expected).max()
    )
    np.testing.assert_allclose(simulation.von_mises(), von_mises(expected), rtol=1e-3)


def test_a_bent_quadratic_beam_is_coloured_by_its_outer_fibre() -> None:
    """Stress at the clamp 6 P (L - x) / b^3, at mid-length within 3 %; a mean over cells shows half of it."""
    length, edge, load = 0.1, 0.01, 1e-3
    bar = body(box_mesh((length, edge, edge), (10, 1, 1)), young_modulus=1e6, poisson_ratio=0.0)
    described: Any = scene(
        replace(bar, order=2), attachments=(slab("clamp", "world", 0.0),), gravity=(0.0, 0.0, 0.0)
    )
    simulation = Simulation(described)
    x, _, z = simulation.model.rest.T
    tip = np.flatnonzero(np.isclose(x, length))
    simulation.forces[tip, 2] = -load / len(tip)
    simulation.settle([])
    for height, sign in ((edge, 1.0), (0.0, -1.0)):
        nodes = np.isclose(z, height) & (np.abs(x - 0.5 * length) < 1e-6)
        expected = sign * 6.0 * load * 0.5 * length / edge**3
        np.testing.assert_allclose(simulation.stress()[nodes, 0, 0].mean(), expected, rtol=0.03)
        np.testing.assert_allclose(simulation.von_mises()[nodes].mean(), abs(expected), rtol=0.05)
    of_cells = simulation._mean_at_nodes @ simulation._stepper.von_mises(
        simulation._state, simulation.parameters
    )
    assert of_cells[nodes].mean() < 0.7 * abs(expected)


@pytest.mark.parametrize("backend", ["scipy", pytest.param("numba", marks=pytest.mark.numba)])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", ["corotational", "corotational_qr", "stable_neo_hookean"])
def test_the_stress_of_a_stretched_bar_is_its_force_over_the_area_it_has(
    law: str, order: int, backend: str
) -> None:
    """Stretched by half: the section is smaller, and so the Cauchy stress larger, by its change of area.

    That of the law of the reference simulator differs from cell to cell here.
    """
    side, stretch, young = 0.01, 1.5, 5e4
    bar = BodyDescription(
        name="bar",
        mesh=box_mesh((0.03, side, side), (3, 1, 1), (0.0, -0.005, -0.005)),
        order=order,
        material=MaterialDescription(law=law, young_modulus=young, poisson_ratio=0.3),
        density=1000.0,
    )
    simulation = Simulation(scene(bar, gravity=(0.0, 0.0, 0.0)), backend)  # type: ignore[arg-type]
    thin = 1.0 - 0.3 * (stretch - 1.0)
    places = simulation.model.rest * [stretch, thin, thin]
    simulation._state.positions[:] = places
    model, materials = simulation.model, simulation.parameters.materials
    pulled = -elastic_forces(model.groups, places, materials)
    right = places[:, 0] > places[:, 0].max() - 1e-9
    area = (side * thin) ** 2
    stress = simulation.stress().mean(axis=0)
    assert stress[0, 0] * area == pytest.approx(
        pulled[right, 0].sum(), rel=0.05 if law == "corotational_qr" else 1e-6
    )
    if law != "corotational_qr":
        np.testing.assert_allclose(simulation.von_mises(), von_mises(simulation.stress()), rtol=1e-6)
