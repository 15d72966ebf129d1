"""Consistent mass: exact inertia of bodies with straight edges, and frequencies nearer to those of a beam."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.sparse.linalg import eigsh
from small_scenes import GRAVITY, body, jittered, machine, scene, shaken, slab

from softsim_core import Simulation
from softsim_core.base import Array, SceneError
from softsim_core.physics.dynamics import node_stiffness
from softsim_core.physics.fem.elements import TET10, element, register_element
from softsim_core.physics.mechanics import Model, rotation_exp
from softsim_core.physics.mesh import TetMesh, box_mesh
from softsim_core.scene import BodyDescription
from softsim_core.scene.building import build

DENSITY, LENGTH, EDGE, YOUNG = 1000.0, 0.2, 0.02, 1e6
ORDERS = pytest.mark.parametrize("order", [1, 2])


def solid(mesh: TetMesh, order: int, distribution: str = "consistent", **fields: Any) -> BodyDescription:
    bar = body(mesh, young_modulus=YOUNG, poisson_ratio=0.0)
    given = {"density": DENSITY, "total_mass": None, "order": order, "mass_distribution": distribution}
    return replace(bar, **(given | fields))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["tet4", "tet10"])
def test_the_mass_matrix_of_a_cell_is_the_integral_of_its_shapes(name: str) -> None:
    """Against sums over random points."""
    rng = np.random.default_rng(1)
    corners = rng.dirichlet(np.ones(4), 400_000)  # uniform in the cell
    edges = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
    shapes = corners
    if name == "tet10":
        middles = 4.0 * corners[:, edges[:, 0]] * corners[:, edges[:, 1]]
        shapes = np.concatenate([corners * (2.0 * corners - 1.0), middles], axis=1)
    matrix = element(name).mass_matrix
    assert matrix is not None
    np.testing.assert_allclose(matrix, shapes.T @ shapes / len(corners), atol=3e-4)
    assert matrix.sum() == pytest.approx(1.0, abs=1e-13)


def kinetic(model: Model, velocities: Array) -> float:
    """Twice the kinetic energy in [J]."""
    return float((velocities * model.momentum(velocities)).sum())


@ORDERS
@pytest.mark.parametrize("seed", [0, 1])
def test_mass_momentum_and_inertia_are_those_of_the_box(order: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = np.array([0.05, 0.03, 0.02])
    mesh = jittered(box_mesh(tuple(size), (2, 2, 2), (0.1, 0.2, 0.3)), 0.002, seed)
    model = build(scene(solid(mesh, order))).model
    mass, centre = DENSITY * size.prod(), np.array([0.1, 0.2, 0.3]) + 0.5 * size
    v, w = rng.normal(size=(2, 3))
    arms = model.rest - centre
    np.testing.assert_allclose(model.momentum(np.tile(v, (len(arms), 1))).sum(axis=0), mass * v, rtol=1e-12)
    inertia = mass / 12.0 * np.diag((size**2).sum() - size**2)
    assert kinetic(model, np.cross(w, arms)) == pytest.approx(w @ inertia @ w, rel=1e-11)
    spins = np.cross(arms, model.momentum(np.cross(w, arms))).sum(axis=0)
    np.testing.assert_allclose(spins, inertia @ w, rtol=1e-10)
    np.testing.assert_allclose(model.weight.sum(axis=0), mass * model.gravity, rtol=1e-12)
    lumped = build(scene(solid(mesh, order, "volume"))).model
    assert abs(kinetic(lumped, np.cross(w, arms)) / (w @ inertia @ w) - 1.0) > 0.02


def test_a_total_mass_is_kept() -> None:
    mesh = jittered(box_mesh((0.05, 0.03, 0.02), (2, 2, 2)), 0.002, 3)
    model = build(scene(solid(mesh, 2, density=None, total_mass=0.4))).model
    assert model.momentum(np.ones_like(model.rest)).sum(axis=0) == pytest.approx([0.4, 0.4, 0.4], rel=1e-12)


@ORDERS
def test_a_turned_body_falls_freely_and_keeps_its_shape(order: int, backend: str) -> None:
    mesh = box_mesh((0.03, 0.03, 0.03), (2, 2, 2))
    turned = TetMesh(mesh.points @ rotation_exp(np.array([0.4, -0.8, 0.3])).T, mesh.tets, mesh.name)
    simulation = Simulation(scene(solid(turned, order)), backend)  # type: ignore[arg-type]
    start = simulation.positions
    for _ in range(20):
        simulation.step()
    fallen = GRAVITY * simulation.dt**2 * 20 * 21 / 2.0
    drop = start - simulation.positions
    np.testing.assert_allclose(drop, np.tile([0.0, 0.0, fallen], (len(start), 1)), atol=1e-9)


def frequencies(order: int, distribution: str) -> Array:
    """The lowest six of a clamped bar with two cells across, in [Hz]."""
    bar = solid(box_mesh((LENGTH, EDGE, EDGE), (10, 2, 2)), order, distribution)
    built = build(scene(bar, attachments=(slab("clamp", "world", 0.0),)))
    model = built.model
    stiffness = node_stiffness(model, model.rest_state(), built.parameters)
    mass = sp.diags(model.mass) + (0.0 if model.coupling is None else model.coupling.matrix)
    own = (3 * model.free_nodes[:, None] + np.arange(3)).ravel()
    parts = [each.tocsr()[own][:, own].tocsc() for each in (stiffness, sp.kron(mass, sp.eye(3)))]
    squares = eigsh(parts[0], k=6, M=parts[1], sigma=0.0, return_eigenvectors=False)
    return np.sort(np.sqrt(squares) / (2.0 * np.pi))


def bending_frequency() -> float:
    """The first of a cantilever with shear and rotary inertia (Timoshenko, factor 5/6), in [Hz]."""
    area, second = EDGE**2, EDGE**4 / 12.0

    def end(frequency: float) -> float:
        omega = (2.0 * np.pi * frequency) ** 2
        rate = np.zeros((4, 4))  # of deflection, rotation, moment, shear force
        rate[0, 1], rate[0, 3] = 1.0, 1.0 / (5.0 / 6.0 * 0.5 * YOUNG * area)
        rate[1, 2] = 1.0 / (YOUNG * second)
        rate[2, 1], rate[2, 3] = -DENSITY * second * omega, -1.0
        rate[3, 0] = -DENSITY * area * omega
        return float(np.linalg.det(expm(LENGTH * rate)[2:, 2:]))

    return float(brentq(end, 2.0, 3.0))


def test_frequencies_are_nearer_to_those_of_a_beam() -> None:
    """Quadratic cells: bending, torsion and stretching, within 0.1 %, 2 % and 0.01 %."""
    speed = np.sqrt(YOUNG / DENSITY)
    stretching = speed / (4.0 * LENGTH)
    torsion = np.sqrt(0.1406 * 6.0 * 0.5) * speed / (4.0 * LENGTH)  # torsion constant 0.1406 a^4, polar a^4/6
    bounds = {bending_frequency(): 1e-3, torsion: 0.02, stretching: 1e-4}
    found = {kind: frequencies(2, kind) for kind in ("volume", "consistent")}
    for expected, bound in bounds.items():
        off = {kind: np.abs(each / expected - 1.0).min() for kind, each in found.items()}
        assert off["consistent"] < bound
        assert off["consistent"] < 0.7 * off["volume"], (expected, off)


@pytest.mark.numba
@pytest.mark.parametrize("method", ["implicit_euler", "bossak"])
@ORDERS
@pytest.mark.slow
def test_both_back_ends_move_alike(order: int, method: str) -> None:
    """Regions, joints of all kinds, springs and damping beside it."""
    pytest.importorskip("numba")
    described = machine()
    bodies = tuple(replace(each, mass_distribution="consistent", order=order) for each in described.bodies)  # type: ignore[arg-type]
    solver = replace(described.solver, time_integration=method, iterations=2)  # type: ignore[arg-type]
    described = replace(described, bodies=bodies, solver=solver)
    fast, readable = (Simulation(described, backend) for backend in ("numba", "scipy"))  # type: ignore[arg-type]
    for simulation in (fast, readable):
        shaken(simulation, 10, 2)
    np.testing.assert_allclose(fast.positions, readable.positions, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(fast.joint_efforts, readable.joint_efforts, rtol=1e-6, atol=1e-8)


def test_an_element_that_does_not_tell_its_mass_matrix_is_refused() -> None:
    register_element(replace(TET10, name="silent", mass_matrix=None))
    with pytest.raises(SceneError, match="mass_distribution consistent needs; set it to volume"):
        build(scene(solid(box_mesh((0.02, 0.02, 0.02), (1, 1, 1)), 2, element="silent")))
