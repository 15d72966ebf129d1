"""Masses of the nodes: by volume or equal, from a density or a total."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from small_scenes import GRAVITY, jittered, scene, slab

from softsim_core import Simulation, load_scene
from softsim_core.base import Array, SceneError
from softsim_core.physics.mechanics import Model, rotation_exp
from softsim_core.physics.mesh import TetMesh, box_mesh
from softsim_core.scene import BodyDescription, MaterialDescription
from softsim_core.scene.building import build

EDGE, DENSITY = 0.03, 1000.0
MASS = DENSITY * EDGE**3


def heavy(mesh: TetMesh, **mass: Any) -> BodyDescription:
    material = MaterialDescription(young_modulus=1e5, poisson_ratio=0.3)
    return BodyDescription(name="body", mesh=mesh, material=material, **mass)


def cube(cells: int) -> TetMesh:
    return box_mesh((EDGE, EDGE, EDGE), (cells, cells, cells), (0.01, -0.02, 0.005))


def inertia(model: Model) -> Array:
    """About the centre of mass in [kg m^2], shape (3, 3)."""
    arm = model.rest - model.mass @ model.rest / model.mass.sum()
    second = (model.mass[:, None] * arm).T @ arm
    return np.asarray(np.trace(second) * np.eye(3) - second)


@pytest.mark.parametrize("given", [{"density": DENSITY}, {"total_mass": MASS}])
def test_a_cube_has_the_mass_centre_and_inertia_of_its_lumped_cells(given: dict[str, float]) -> None:
    """Mass by volume of n cells an edge: 1 + 2 / n^2 times a solid cube's inertia on average of the axes."""
    solid = MASS * EDGE**2 / 6.0
    excess = []
    for cells in (3, 6, 12):
        model = build(scene(heavy(cube(cells), **given))).model
        assert model.mass.sum() == pytest.approx(MASS, rel=1e-12)
        centre = model.mass @ model.rest / MASS
        assert centre == pytest.approx(np.array([0.01, -0.02, 0.005]) + 0.5 * EDGE, abs=1e-4)
        excess.append(np.trace(inertia(model)) / 3.0 / solid - 1.0)
    assert excess[0] == pytest.approx(2.0 / 9.0, abs=0.05)
    assert np.array(excess[:-1]) / excess[1:] == pytest.approx(4.0, abs=0.3)  # second order


def test_equal_masses_make_a_coarse_cube_too_sluggish() -> None:
    model = build(scene(heavy(cube(3), total_mass=MASS, mass_distribution="equal"))).model
    assert model.mass == pytest.approx(MASS / 64.0)
    assert inertia(model) == pytest.approx(5.0 / 3.0 * MASS * EDGE**2 / 6.0 * np.eye(3), rel=1e-9)


def test_moments_are_those_of_the_element_quarters() -> None:
    """Total and centre of mass of any mesh are exact, as each element's quarters keep them."""
    mesh = jittered(cube(4), 0.002, seed=3)
    model = build(scene(heavy(mesh, density=DENSITY))).model
    corners = mesh.points[mesh.tets]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    assert model.mass.sum() == pytest.approx(DENSITY * volumes.sum(), rel=1e-12)
    assert model.mass @ model.rest == pytest.approx(DENSITY * volumes @ corners.mean(axis=1), rel=1e-9)


def test_a_turned_body_falls_freely_and_keeps_its_shape(backend: str) -> None:
    mesh = cube(2)
    turned = TetMesh(mesh.points @ rotation_exp(np.array([0.4, -0.8, 0.3])).T, mesh.tets, mesh.name)
    simulation = Simulation(scene(heavy(turned, density=DENSITY)), backend)  # type: ignore[arg-type]
    for _ in range(50):
        simulation.step()
    fallen = GRAVITY * simulation.dt**2 * 50 * 51 / 2.0
    assert turned.points - simulation.positions == pytest.approx(
        np.tile([0.0, 0.0, fallen], (len(turned.points), 1)), abs=1e-9
    )


@pytest.mark.parametrize("jitter", [0.0, 0.0015])
def test_a_support_carries_the_weight_of_what_hangs_on_it(jitter: float) -> None:
    """The weight that the springs of a soft fixing carry is the density times the volume times g."""
    mesh = jittered(box_mesh((0.06, 0.02, 0.02), (6, 3, 3)), jitter, seed=5)
    held = slab("held", "world", 0.0, stiffness=1e4)
    simulation = Simulation(scene(heavy(mesh, density=DENSITY), attachments=(held,)), "scipy")
    sunk = simulation.equilibrium([]).state.positions[:, 2] - mesh.points[:, 2]
    carried = -1e4 * sunk[np.isclose(mesh.points[:, 0], 0.0)].sum()
    corners = mesh.points[mesh.tets]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6.0
    assert carried == pytest.approx(DENSITY * volume * GRAVITY, rel=1e-6)


@pytest.mark.parametrize("given", [{}, {"density": 1.0, "total_mass": 1.0}])
def test_exactly_one_mass_is_given(given: dict[str, float]) -> None:
    with pytest.raises(SceneError, match=r"exactly one of `density` in kg/m\^3 and `total_mass` in kg"):
        heavy(cube(1), **given)


@pytest.mark.parametrize("density", [0.0, -1.0, float("nan"), float("inf")])
def test_a_density_is_positive(density: float) -> None:
    with pytest.raises(SceneError, match=r"density must be > 0 kg/m\^3"):
        heavy(cube(1), density=density)


@pytest.mark.parametrize("name", ["tripod", "cable_gripper", "held_centre", "cable_finger"])
def test_scenes_of_the_reference_keep_equal_masses(name: str) -> None:
    assert {body.mass_distribution for body in load_scene(name).scene.bodies} == {"equal"}
