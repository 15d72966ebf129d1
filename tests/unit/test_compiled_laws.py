"""Compiled cells of each law beside the NumPy side: forces, blocks, what is held and what is remembered."""

from __future__ import annotations

import numpy as np
import pytest
from small_scenes import jittered

from softsim_core.base import Array
from softsim_core.physics.fem import (
    ElementGroup,
    LinearMove,
    cell_forces,
    cell_stiffness,
    element_group,
    memory_shape,
    remember,
    step_stress,
    step_stress_forces,
    step_stress_stiffness,
)
from softsim_core.physics.fem.elements import element
from softsim_core.physics.fem.materials import material, relaxing
from softsim_core.physics.mesh import box_mesh, quadratic

pytest.importorskip("numba")
pytestmark = pytest.mark.numba

HOOKE = {"young_modulus": 1e4, "poisson_ratio": 0.45}
LAWS: dict[str, tuple[str, dict[str, float]]] = {
    "corotational": ("corotational", HOOKE),
    "auxetic": ("corotational", {"young_modulus": 1e4, "poisson_ratio": -0.3}),
    "stable_neo_hookean": ("stable_neo_hookean", HOOKE),
    "yeoh": ("yeoh", {"c1": 2e3, "c2": 300.0, "c3": 40.0, "poisson_ratio": 0.45}),
    "ogden": ("ogden", {"m1": 5e3, "alpha1": 2.8, "m2": 2e3, "alpha2": -6.0, "poisson_ratio": 0.45}),
    "ogden of one term": ("ogden", {"m1": 5e3, "alpha1": 1.3, "poisson_ratio": 0.45}),
    "mooney_rivlin": ("mooney_rivlin", {"c10": 2e3, "c01": 1e3, "poisson_ratio": 0.45}),
}
laws = pytest.mark.parametrize("name", LAWS)
cells_of = pytest.mark.parametrize("cell", ["tet4", "tet10"])


def group_of(name: str, cell: str, terms: int = 0) -> tuple[ElementGroup, Array, Array]:
    """A jittered block of thirteen times as many cells as a batch has lanes and some, values, points."""
    mesh = jittered(box_mesh((0.03, 0.02, 0.02), (3, 2, 2)), 0.002, seed=5)
    mesh = quadratic(mesh) if cell == "tet10" else mesh
    named, constants = LAWS.get(name, (name, HOOKE))
    law, given = material(named), dict(constants)
    if terms:
        law = relaxing(law, terms)
        given |= {f"prony_share_{i + 1}": 0.2 + 0.1 * i for i in range(terms)}
        given |= {f"prony_time_{i + 1}": 0.05 * 10**i for i in range(terms)}
    count = np.arange(len(mesh.tets))
    group = element_group(element(cell), law, mesh.points, mesh.tets, 0 * count, count)
    return group, group.values([law.values(given)]), mesh.points


def filled(
    group: ElementGroup, p: Array, x: Array, velocities: Array, moved: Array | None, positive: bool,
    mean_share: float, held: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Forces f - 0.01 K v (n, 3), and the blocks of K (m, a, a, 3, 3), of the compiled cells.

    They have been filled before, with what another solve has moved, as in a step that is done again.
    """
    from softsim_core.physics.dynamics.numba_backend import (
        CellInputs,
        CellOutputs,
        CellPlaces,
        cell_batches,
        compiled_law,
        point_cells,
        tune,
    )

    count, a = group.cells.shape
    pairs = a * (a + 1) // 2
    places = CellPlaces(np.full((count, pairs), -1), np.zeros((count, a), np.int64), pairs * np.arange(count))
    cells = point_cells(group, cell_batches(group), np.arange(count))
    tune(cells, group, p)
    forces, kept = np.zeros_like(x), np.zeros((count * pairs, 3, 3))
    nothing = np.zeros((0, 1, 3, 3)) if held is None else held
    given = CellInputs(
        x, x[:0] if moved is None else moved, velocities, nothing, positive, 0.01, mean_share, 3.0
    )
    law = compiled_law(group.material)
    assert law is not None
    other = np.random.default_rng(5).normal(size=x.shape)
    law.run(
        given._replace(moved=0.001 * other, positive=False),
        cells,
        CellOutputs(places, np.zeros_like(x), np.zeros(1), np.zeros_like(kept)),
        None,
    )
    law.run(given, cells, CellOutputs(places, forces, np.zeros(1), kept), None)
    blocks, (first, second) = np.empty((count, a, a, 3, 3)), np.triu_indices(a)
    blocks[:, first, second] = kept.reshape(count, pairs, 3, 3) / 3.0
    blocks[:, second, first] = np.swapaxes(blocks[:, first, second], -1, -2)
    return forces, blocks


def assert_alike(
    group: ElementGroup, p: Array, x: Array, moved: Array | None, positive: bool, mean_share: float = 1.0
) -> None:
    """Blocks and forces of the compiled cells are those of fem.cells."""
    velocities = 0.3 * np.random.default_rng(8).normal(size=x.shape)
    forces, blocks = filled(group, p, x, velocities, moved, positive, mean_share)
    last = None if moved is None else LinearMove(x - moved, moved)
    expected = cell_stiffness(group, x, p, positive, last=last, mean_share=mean_share)
    np.testing.assert_allclose(blocks, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    of_cells = cell_forces(group, x, p) - 0.01 * np.einsum(
        "mabij,mbj->mai", expected, velocities[group.cells]
    )
    wanted = np.zeros_like(x)
    np.add.at(wanted, group.cells, of_cells)
    np.testing.assert_allclose(forces, wanted, rtol=0, atol=1e-11 * np.abs(of_cells).max())


@cells_of
@pytest.mark.parametrize("amount", [0.0, 0.002, 0.01])
def test_a_law_of_one_point(cell: str, amount: float) -> None:
    """Saint Venant-Kirchhoff, whose function of one point the step compiles, beside its methods in NumPy."""
    group, p, points = group_of("saint_venant_kirchhoff", cell)
    x = points + amount * np.random.default_rng(4).normal(size=points.shape)
    for positive in (False, True):
        assert_alike(group, p, x, None, positive)


@laws
@cells_of
@pytest.mark.parametrize("amount", [0.0, 1e-9, 0.002, 0.02])
def test_forces_and_blocks(name: str, cell: str, amount: float) -> None:
    """At rest, where all stretches are equal, and up to where most cells are inside out somewhere."""
    group, p, points = group_of(name, cell)
    rng = np.random.default_rng(3)
    x = points + amount * rng.normal(size=points.shape)
    for positive in (False, True):
        assert_alike(group, p, x, None, positive)


@laws
def test_the_pressure_that_the_last_solve_found(name: str) -> None:
    group, p, points = group_of(name, "tet10")
    rng = np.random.default_rng(4)
    x, moved = (points, 0.0 * points) + 0.002 * rng.normal(size=(2, *points.shape))
    assert_alike(group, p, x, moved, positive=False, mean_share=0.4)


@laws
@pytest.mark.parametrize("stretches", [(1.5, 1.5, 0.4), (2.0, 0.05, 0.05), (0.02, 1.0, 1.0), (0.7, 0.7, 0.7)])
def test_stretches_that_meet(name: str, stretches: tuple[float, float, float]) -> None:
    """The limit of equal principal stretches, also where powers are parabolas; then nearly equal ones."""
    group, p, points = group_of(name, "tet4")
    for apart in (0.0, 1e-12, 1e-6, 1e-3, 0.03):
        scale = np.array(stretches) * (1.0 + apart * np.array([0.0, 1.0, -1.0]))
        for positive in (False, True):
            assert_alike(group, p, points * scale, None, positive)


@laws
@cells_of
def test_blocks_are_the_slope_of_the_forces(name: str, cell: str) -> None:
    group, p, points = group_of(name, cell)
    rng = np.random.default_rng(5)
    x, way = points + 0.001 * rng.normal(size=points.shape), rng.normal(size=points.shape)
    still, step = np.zeros_like(x), 1e-8
    ahead, behind = (
        filled(group, p, x + sign * step * way, still, None, False, 1.0)[0] for sign in (1.0, -1.0)
    )
    blocks = filled(group, p, x, still, None, False, 1.0)[1]
    slope = np.zeros_like(x)
    np.add.at(slope, group.cells, np.einsum("mabij,mbj->mai", blocks, way[group.cells]))
    np.testing.assert_allclose(slope, (behind - ahead) / (2.0 * step), atol=1e-6 * np.abs(slope).max())


def test_cells_that_are_no_numbers_say_so() -> None:
    for name in ("corotational", "ogden", "yeoh"):
        group, p, points = group_of(name, "tet10")
        forces = filled(group, p, np.nan * points, 0.0 * points, None, True, 1.0)[0]
        assert np.isnan(forces).all()


@laws
@cells_of
@pytest.mark.slow
def test_what_is_held_and_remembered(name: str, cell: str) -> None:
    """Prony terms: memory, what it holds, and its forces and blocks; where cells are crushed, too."""
    from softsim_core.physics.dynamics.numba_backend import RelaxingCells

    group, p, points = group_of(name, cell, terms=2)
    compiled, rng = RelaxingCells(group), np.random.default_rng(6)
    ours, theirs = (np.zeros(memory_shape(group)) for _ in range(2))
    for amount in (0.0, 0.001, 0.01, 0.001):
        x = points + amount * rng.normal(size=points.shape)
        compiled.remember(p, ours, x, 0.02)
        remember(group, p, theirs, x, 0.02)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11 * np.abs(theirs).max() + 1e-9)
    held = np.empty_like(ours[..., 0, :, :])
    compiled.hold(p, ours, held, 0.02)
    np.testing.assert_allclose(held, step_stress(group, p, theirs, 0.02), atol=1e-11 * np.abs(theirs).max())
    velocities = rng.normal(size=x.shape)
    bare, held_too = (filled(group, p, x, velocities, None, True, 1.0, each) for each in (None, held))
    stiffness = step_stress_stiffness(group, held)
    wanted = np.zeros_like(x)
    np.add.at(wanted, group.cells, step_stress_forces(stiffness, group.cells, x + 0.01 * velocities))
    atol = 1e-10 * np.abs(bare[0]).max() + 1e-14 * np.abs(wanted).max()
    np.testing.assert_allclose(held_too[0] - bare[0], wanted, rtol=0, atol=atol)
    blocks = stiffness[..., None, None] * np.eye(3)
    np.testing.assert_allclose(held_too[1] - bare[1], blocks, atol=1e-10 * np.abs(bare[1]).max())
