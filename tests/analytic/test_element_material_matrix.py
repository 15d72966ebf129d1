"""Every element with every material law in both back ends: what each pair has to show.

A law or an element that is registered and stands in no table here fails the first test.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from example_files import example
from small_scenes import body, jittered, machine, scene, slab

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics import make_stepper, reduced_stiffness, solve_static
from softsim_core.physics.fem import (
    ElementGroup,
    cauchy_stress,
    cell_energy,
    cell_forces,
    cell_stiffness,
    deformation_gradients,
    elastic_forces,
    element_group,
)
from softsim_core.physics.fem.elements import element, element_names, register_element
from softsim_core.physics.fem.materials import Material, material, material_names
from softsim_core.physics.mechanics import Control, State, rotation_exp
from softsim_core.physics.mesh import TetMesh, boundary, box_mesh, quadratic, whole_cells
from softsim_core.scene import BodyDescription, MaterialDescription
from softsim_core.scene.building import BuiltScene, build

KNOWN_AT_START = element_names(), material_names()
HOOKE = {"young_modulus": 2e4, "poisson_ratio": 0.35}
VALUES = {
    "corotational": HOOKE,
    "corotational_qr": HOOKE,
    "stable_neo_hookean": HOOKE,
    "saint_venant_kirchhoff": HOOKE,
    "yeoh": {"c1": 3.7e3, "c2": 400.0, "c3": 30.0, "poisson_ratio": 0.35, "stiffness_factor": 1.0},
    "ogden": {
        "m1": 1e4,
        "alpha1": 2.8,
        "m2": 4.8e3,
        "alpha2": -6.0,
        "poisson_ratio": 0.35,
        "stiffness_factor": 1.0,
    },
    "mooney_rivlin": {"c10": 2.5e3, "c01": 1.2e3, "poisson_ratio": 0.35, "stiffness_factor": 1.0},
}
"""Parameters of each law in the matrix; forces are compared with these moduli."""
YOUNG = 2e4
ELEMENTS = ("tet4", "tet10", "hex8", "tet4_four_points")
"""The package's, and one with several quadrature points from examples/my_element.py."""
LAWS = tuple(VALUES)


def knows_modes(law: str) -> bool:
    """Whether it gives its positive tangent as modes, too."""
    return type(material(law)).positive_modes is not Material.positive_modes


pairs = pytest.mark.parametrize(("cell", "law"), [(cell, law) for cell in ELEMENTS for law in LAWS])
some_pairs = pytest.mark.parametrize(
    ("cell", "law"),
    [(ELEMENTS[0], law) for law in LAWS] + [(cell, LAWS[0]) for cell in ELEMENTS[1:]],
)
"""Each law and each element once, for what takes many steps."""


@pytest.fixture(autouse=True, scope="module")
def _four_points() -> None:
    register_element(example("my_element").FOUR_POINTS)


def test_the_matrix_holds_every_implementation() -> None:
    assert set(KNOWN_AT_START[0]) <= set(ELEMENTS)
    assert set(KNOWN_AT_START[1]) <= {*LAWS, "rod"}  # see test_rods


@cache
def mesh(cell: str) -> TetMesh:
    """An irregular block with inner nodes."""
    if cell == "tet10":
        return quadratic(jittered(box_mesh((0.04, 0.03, 0.03), (2, 2, 2)), 0.002, seed=5))
    if cell == "hex8":
        return jittered(box_mesh((0.04, 0.03, 0.03), (4, 3, 3), hexahedra=True), 0.002, seed=5)
    return jittered(box_mesh((0.04, 0.03, 0.03), (4, 3, 3)), 0.002, seed=5)


def cells(cell: str) -> IndexArray:
    """Nodes of its cells, shape (m, a)."""
    kind = element(cell).kind or "tetra"
    return whole_cells(mesh(cell), (kind,))[0][kind]


@cache
def group(cell: str, law: str) -> ElementGroup:
    own = cells(cell)
    none = np.zeros(len(own), np.int64)
    return element_group(element(cell), material(law), mesh(cell).points, own, none, np.arange(len(own)))


def parameters(cell: str, law: str) -> Array:
    return np.tile(np.array(list(VALUES[law].values())), (len(cells(cell)), 1))


def bent(cell: str, seed: int, amount: float) -> Array:
    """Node positions moved at random by up to `amount` edge lengths (0.01 m), and turned as a whole."""
    rng = np.random.default_rng(seed)
    points = mesh(cell).points + 0.01 * amount * rng.uniform(-1.0, 1.0, mesh(cell).points.shape)
    return np.asarray(points @ rotation_exp(rng.uniform(-2.0, 2.0, 3)).T)


def built(cell: str, law: str, **fields: object) -> BuiltScene:
    made_of = MaterialDescription(law=law, **VALUES[law])
    return build(scene(replace(body(mesh(cell)), material=made_of, element=cell), **fields))


def in_cells(each: BodyDescription, cell: str, made_of: MaterialDescription) -> BodyDescription:
    """A body in cells of that kind."""
    return replace(each, material=made_of, element=cell, order=2 if cell == "tet10" else None)


@pairs
def test_patch(cell: str, law: str) -> None:
    """A linear displacement: the same stress everywhere, and no force on inner nodes."""
    size = 1e-7 if law == "corotational_qr" else 0.1  # frames of cells differ beyond small strain
    rng = np.random.default_rng(6)
    gradient = np.eye(3) + size * rng.uniform(-1.0, 1.0, (3, 3))
    positions, one = mesh(cell).points @ gradient.T, group(cell, law)
    stress = cauchy_stress(one, positions, parameters(cell, law))
    scale = np.abs(stress).max()
    tolerance = 1e-5 if law == "corotational_qr" else 1e-9
    np.testing.assert_allclose(stress, np.broadcast_to(stress[0, 0], stress.shape), atol=tolerance * scale)
    inner = np.setdiff1d(np.arange(len(positions)), boundary(mesh(cell)))
    forces = elastic_forces((one,), positions, [VALUES[law]])
    assert np.abs(forces[inner]).max() < tolerance * np.abs(forces).max()


@pairs
@pytest.mark.parametrize("seed", range(3))
def test_rigid_motions_cost_nothing(cell: str, law: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    moved = mesh(cell).points @ rotation_exp(rng.uniform(-np.pi, np.pi, 3)).T + rng.normal(size=3)
    assert np.abs(cell_forces(group(cell, law), moved, parameters(cell, law))).max() < 1e-10 * YOUNG * 1e-4


@pairs
def test_stiffness_is_the_slope_of_the_force(cell: str, law: str) -> None:
    positions, one, p = bent(cell, 1, 0.25), group(cell, law), parameters(cell, law)
    blocks, step = cell_stiffness(one, positions, p), 1e-8
    way = np.random.default_rng(2).normal(size=positions.shape)
    ahead, behind = (cell_forces(one, positions + sign * step * way, p) for sign in (1.0, -1.0))
    slope = np.einsum("mabij,mbj->mai", blocks, way[one.cells])
    np.testing.assert_allclose(slope, (behind - ahead) / (2.0 * step), atol=1e-6 * np.abs(slope).max())


@pairs
def test_force_is_the_slope_of_the_energy(cell: str, law: str) -> None:
    positions, one, p = bent(cell, 3, 0.25), group(cell, law), parameters(cell, law)
    if not one.material.has_potential:
        pytest.skip(f"{law} has no potential")
    way, step = np.random.default_rng(4).normal(size=positions.shape), 1e-7
    ahead, behind = (cell_energy(one, positions + sign * step * way, p).sum() for sign in (1.0, -1.0))
    work = (cell_forces(one, positions, p) * way[one.cells]).sum()
    assert -work == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5)


@pairs
@pytest.mark.parametrize("amount", [0.0, 0.5, 3.0])
def test_positive_stiffness_has_no_negative_eigenvalue(cell: str, law: str, amount: float) -> None:
    """At rest, bent, and crumpled with elements inside out; symmetric."""
    blocks = cell_stiffness(group(cell, law), bent(cell, 5, amount), parameters(cell, law), positive=True)
    size = 3 * blocks.shape[1]
    matrices = blocks.transpose(0, 1, 3, 2, 4).reshape(-1, size, size)
    scale = np.abs(matrices).max(axis=(1, 2), keepdims=True)
    assert (np.abs(matrices - matrices.swapaxes(1, 2)) <= 1e-12 * scale).all()
    assert (np.linalg.eigvalsh(matrices) >= -1e-12 * scale[:, 0]).all()


@pytest.mark.parametrize("cell", ELEMENTS)
@pytest.mark.parametrize("law", [law for law in LAWS if knows_modes(law)])
@pytest.mark.parametrize("amount", [0.0, 0.5, 3.0])
def test_modes_of_a_law_are_its_positive_tangent(cell: str, law: str, amount: float) -> None:
    """As tensors, and put on the nodes: a law that knows them is the same law."""
    one, p = group(cell, law), parameters(cell, law)[:, None]
    deformation = deformation_gradients(one, bent(cell, 6, amount))
    modes = one.material.positive_modes(deformation, p)
    assert modes is not None
    tangent = one.material.positive_tangent(deformation, p)
    np.testing.assert_allclose(modes.dense(), tangent, atol=1e-12 * np.abs(tangent).max())
    weighted = one.weights[..., None, None, None, None] * tangent
    expected = np.einsum("mqaj,mqijkl,mqbl->mabik", one.gradients, weighted, one.gradients, optimize=True)
    if element(cell).mean_volume:  # it volume takes a part of the bulk
        return
    found = cell_stiffness(one, bent(cell, 6, amount), parameters(cell, law), positive=True)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


@pairs
@pytest.mark.slow
def test_one_step_is_the_same_in_both_back_ends(cell: str, law: str) -> None:
    """Of a scene with everything that exists, at a state thrown about."""
    pytest.importorskip("numba")
    description = machine(hexahedra=cell == "hex8")
    made_of = MaterialDescription(law=law, **VALUES[law])
    description = replace(
        description,
        bodies=tuple(in_cells(each, cell, made_of) for each in description.bodies),
    )
    ready = build(description)
    model, rng = ready.model, np.random.default_rng(7)
    states = model.rest_state(), model.rest_state()
    free = model.free_nodes
    moves = rng.normal(size=(2, len(free), 3))
    speeds = rng.normal(size=model.reduced_size)
    inputs = Control(states[0].joint_positions + 0.01, rng.normal(scale=0.01, size=model.rest.shape))
    for backend, state in zip(("numba", "scipy"), states, strict=True):
        state.positions[free] += 5e-4 * moves[0]
        state.velocities[free] += 0.1 * moves[1]
        state.reduced_velocities[:] = 0.1 * speeds
        model.place_regions(state)
        make_stepper(model, backend).step(state, inputs, ready.parameters)
    scale = np.abs(states[1].velocities).max()
    np.testing.assert_allclose(states[0].velocities, states[1].velocities, atol=1e-9 * scale)
    np.testing.assert_allclose(
        states[0].reduced_velocities,
        states[1].reduced_velocities,
        atol=1e-9 * np.abs(states[1].reduced_velocities).max(),
    )
    efforts = np.abs(states[1].joint_efforts).max()
    np.testing.assert_allclose(states[0].joint_efforts, states[1].joint_efforts, atol=1e-8 * efforts)


@pytest.mark.slow
@pairs
def test_stiffness_of_the_frames_is_the_same_in_both_back_ends(cell: str, law: str) -> None:
    """The condensed static tangent of frames and joints, which inverse control asks for."""
    pytest.importorskip("numba")
    if not material(law).has_potential:
        pytest.skip(f"the compiled tangent of {law} is an approximation")
    description = machine(hexahedra=cell == "hex8", effector="middle")
    made_of = MaterialDescription(law=law, **VALUES[law])
    ready = build(
        replace(
            description,
            bodies=tuple(in_cells(each, cell, made_of) for each in description.bodies),
        )
    )
    model = ready.model
    state, forces = model.rest_state(), np.zeros_like(model.rest)
    state.positions[model.free_nodes] += 1e-4 * np.random.default_rng(8).normal(
        size=(len(model.free_nodes), 3)
    )
    ours, theirs = (
        reduced_stiffness(make_stepper(model, backend), state, ready.parameters, forces)
        for backend in ("numba", "scipy")
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.slow
@some_pairs
def test_energy_does_not_grow_in_free_vibration(cell: str, law: str, backend: str) -> None:
    ready = built(cell, law, attachments=(slab("held", "world", 0.0),), gravity=(0.0, 0.0, 0.0))
    model, state = ready.model, ready.model.rest_state()
    free = model.free_nodes
    x = model.rest[free, 0]
    state.positions[free, 2] += 4.0 * x**2
    stepper, still = make_stepper(model, backend), Control(np.zeros(0), np.zeros_like(model.rest))
    energies = []
    for _ in range(60):
        energies.append(_energy(ready, state))
        stepper.step(state, still, ready.parameters)
    growth = np.diff(energies)
    assert growth[growth > 0.0].sum() < 1e-9 * energies[0]
    assert energies[-1] < 0.5 * energies[0]


def _energy(ready: BuiltScene, state: State) -> float:
    """Kinetic plus elastic energy in [J]."""
    kinetic = 0.5 * (ready.model.mass[:, None] * state.velocities**2).sum()
    elastic = sum(
        cell_energy(one, state.positions, one.values(ready.parameters.materials)).sum()
        for one in ready.model.groups
    )
    return float(kinetic + elastic)


@some_pairs
@pytest.mark.slow
def test_motion_comes_to_rest_where_statics_say(cell: str, law: str, backend: str) -> None:
    ready = built(cell, law, attachments=(slab("held", "world", 0.0),), rayleigh_mass=16.0)
    model, state = ready.model, ready.model.rest_state()
    stepper, inputs = make_stepper(model, backend), Control(np.zeros(0), np.zeros_like(model.rest))
    for _ in range(250):
        stepper.step(state, inputs, ready.parameters)
    solved = solve_static(model, model.rest_state(), inputs, ready.parameters).state.positions
    sag = np.abs(solved - model.rest).max()
    assert sag > 1e-4
    np.testing.assert_allclose(state.positions, solved, atol=1e-8)
