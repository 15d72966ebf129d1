"""Bars and cantilevers of linear tetrahedra: stretch is exact, bending locks and converges."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from closed_forms import BEAM_LOCKING, tip_deflection, uniaxial_stretch
from small_scenes import body, scene, slab

from softsim_core.physics.dynamics import solve_static
from softsim_core.physics.mechanics import Control
from softsim_core.physics.mesh import TetMesh, box_mesh
from softsim_core.scene.building import build

LENGTH, HEIGHT, YOUNG = 0.1, 0.01, 1e6


def one_way_box(cells: int) -> TetMesh:
    """Beam of cubes, all cut along the same space diagonal: the mesh of the table in closed_forms."""
    counts = (10 * cells, cells, cells)
    axes = [
        np.linspace(0.0, length, n + 1) for length, n in zip((LENGTH, HEIGHT, HEIGHT), counts, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    node = np.arange(len(points)).reshape([n + 1 for n in counts])
    tets = []
    for cell, path in product(product(*map(range, counts)), permutations(range(3))):
        corner = list(cell)
        tet = [node[tuple(corner)]]
        for axis in path:
            corner[axis] += 1
            tet.append(node[tuple(corner)])
        tets.append(tet)
    return TetMesh(points, np.array(tets))


def deflection_ratio(mesh: TetMesh, poisson_ratio: float) -> float:
    """Tip deflection of a lightly loaded cantilever over that of the Euler-Bernoulli beam."""
    beam = body(mesh, young_modulus=YOUNG, poisson_ratio=poisson_ratio)
    built = build(scene(beam, gravity=(0.0, 0.0, 0.0), attachments=(slab("wall", "world", 0.0),)))
    expected = 1e-3 * LENGTH
    tip = np.flatnonzero(mesh.points[:, 0] > LENGTH - 1e-9)
    forces = np.zeros_like(mesh.points)
    forces[tip, 2] = expected / tip_deflection(1.0, LENGTH, HEIGHT, HEIGHT, YOUNG) / len(tip)
    solution = solve_static(
        built.model, built.model.rest_state(), Control(np.zeros(0), forces), built.parameters
    )
    return float((solution.state.positions - mesh.points)[tip, 2].mean() / expected)


@pytest.mark.filterwarnings("ignore:.*negative orientation")
@pytest.mark.parametrize(("poisson_ratio", "layers"), BEAM_LOCKING)
def test_locking_of_the_one_way_mesh_is_the_documented_one(poisson_ratio: float, layers: int) -> None:
    ratio = deflection_ratio(one_way_box(layers), poisson_ratio)
    assert ratio == pytest.approx(BEAM_LOCKING[poisson_ratio, layers], rel=0.015)


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.45])
def test_cantilever_converges_to_the_beam(poisson_ratio: float) -> None:
    """The error falls at least with the first power of the cell size; our mirrored cells lock less."""
    layers = np.array([1, 2, 3, 4])
    ratios = np.array([
        deflection_ratio(box_mesh((LENGTH, HEIGHT, HEIGHT), (10 * n, n, n)), poisson_ratio) for n in layers
    ])  # fmt: skip
    assert (np.diff(ratios) > 0.0).all()
    assert (ratios < 1.01).all()
    assert (ratios > [0.25, 0.55, 0.70, 0.80]).all()
    assert np.polyfit(np.log(layers), np.log(1.0 - ratios), 1)[0] < -1.0


@pytest.mark.parametrize(("law", "force", "tolerance"), [("polar", 2.0, 1e-9), ("qr", 2e-3, 1e-3)])
def test_bar_under_a_pull(law: str, force: float, tolerance: float) -> None:
    """Uniform stretch is exact on any mesh (`qr`: small strain); forces spread as the shape functions say."""
    mesh = box_mesh((LENGTH, HEIGHT, HEIGHT), (4, 1, 1))
    bar = body(mesh, young_modulus=YOUNG, poisson_ratio=0.0)
    built = build(scene(bar, law=law, gravity=(0.0, 0.0, 0.0), attachments=(slab("wall", "world", 0.0),)))
    forces = np.zeros_like(mesh.points)
    area = HEIGHT**2
    end = mesh.points[:, 0] > LENGTH - 1e-9
    for tet in mesh.tets:
        face = tet[end[tet]]
        if len(face) == 3:
            a, b, c = mesh.points[face]
            forces[face, 0] += force / area * 0.5 * np.linalg.norm(np.cross(b - a, c - a)) / 3.0
    assert forces.sum() == pytest.approx(force)
    solution = solve_static(
        built.model, built.model.rest_state(), Control(np.zeros(0), forces), built.parameters
    )
    strain = uniaxial_stretch(force, area, YOUNG)
    moved = solution.state.positions - mesh.points
    np.testing.assert_allclose(moved / strain, mesh.points * [1.0, 0.0, 0.0], rtol=0, atol=tolerance * LENGTH)
