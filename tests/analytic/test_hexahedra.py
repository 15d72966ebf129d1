"""Bodies of hexahedra, alone and beside tetrahedra, wedges and pyramids: bending, parts, files, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from mixed_meshes import mixed
from small_scenes import body, scene, slab

from softsim_core import Simulation
from softsim_core.base import Array, Box, MeshError, MeshFile, SceneError
from softsim_core.physics.fem import elastic_forces
from softsim_core.physics.mesh import TetMesh, boundary, box_mesh, cell_mesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    FibresDescription,
    JointDescription,
    MaterialDescription,
    MaterialRegionDescription,
)
from softsim_core.scene.building import build

LENGTH, WIDTH = 0.2, 0.02
CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])


def sag(mesh: TetMesh, poisson_ratio: float, **fields: Any) -> float:
    """Mean height in [m] of the free end of a beam under a tenth of its weight."""
    beam = replace(body(mesh, "beam", 1e5, poisson_ratio, 0.02), **fields)
    held = slab("held", "world", 0.0, "beam")
    simulation = Simulation(scene(beam, attachments=(held,), gravity=(0.0, 0.0, -0.1)))
    moved = simulation.equilibrium().state.positions - simulation.model.rest
    return float(moved[np.isclose(simulation.model.rest[:, 0], LENGTH), 2].mean())


def bar(cells: tuple[int, int, int], **fields: Any) -> TetMesh:
    return box_mesh((LENGTH, WIDTH, WIDTH), cells, **fields)


@pytest.mark.slow
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.499])
def test_a_cantilever_bends_as_one_of_fine_quadratic_tetrahedra(poisson_ratio: float) -> None:
    expected = sag(bar((40, 4, 4)), poisson_ratio, order=2)
    coarse, fine = (sag(bar(cells, hexahedra=True), poisson_ratio) for cells in ((30, 2, 2), (60, 3, 3)))
    assert fine == pytest.approx(expected, rel=0.01)
    assert abs(fine - expected) < abs(coarse - expected)
    linear = sag(bar((60, 3, 3)), min(poisson_ratio, 0.45))
    assert abs(linear - expected) > 10 * abs(fine - expected)  # tetrahedra of the same nodes are too stiff


@pytest.mark.slow
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.499])
def test_a_block_that_is_pressed_by_a_quarter_resists_as_one_of_quadratic_tetrahedra(
    poisson_ratio: float,
) -> None:
    def force(cells: int, **fields: Any) -> float:
        side = 0.04
        cube = box_mesh((side,) * 3, (cells,) * 3, (-0.02, -0.02, 0.0), hexahedra="order" not in fields)
        law = MaterialDescription(law="stable_neo_hookean", young_modulus=2e4, poisson_ratio=poisson_ratio)
        pressed = replace(body(cube), material=law, **fields)
        low, high = (Box(center=(0.0, 0.0, z), size=(1.0, 1.0, 1e-4)) for z in (0.0, side))
        attachments = (
            AttachmentDescription(name="low", body="body", to="world", box=low),
            AttachmentDescription(name="high", body="body", to="press", box=high),
        )
        press = JointDescription(name="press", kind="prismatic", axis=(0.0, 0.0, 1.0))
        simulation = Simulation(
            scene(pressed, joints=(press,), attachments=attachments, gravity=(0.0, 0.0, 0.0))
        )
        start = None
        for way in (-0.005, -0.01):
            start = simulation.equilibrium([way], start=start).state
        assert start is not None
        return float(start.joint_efforts[0])

    assert force(6) == pytest.approx(force(3, order=2), rel=0.03)


def read(tmp_path: Path, mesh: meshio.Mesh) -> MeshFile:
    meshio.write(tmp_path / "cells.vtk", mesh)
    return MeshFile(file=tmp_path / "cells.vtk")


def block(mesh: MeshFile | TetMesh, **fields: Any) -> BodyDescription:
    material = MaterialDescription(young_modulus=2e4, poisson_ratio=0.45, law="stable_neo_hookean")
    return BodyDescription(name="block", mesh=mesh, material=material, total_mass=1.0, **fields)


def patch(description: BodyDescription) -> set[str]:
    """Displace a body linearly, expect no force on inner nodes, and return the names of its elements."""
    model = build(scene(description)).model
    assert sum(group.volumes.sum() for group in model.groups) == pytest.approx(1.0, rel=1e-9)
    gradient = np.eye(3) + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, (3, 3))
    values = [{"young_modulus": 2e4, "poisson_ratio": 0.45}]
    forces = elastic_forces(model.groups, model.rest @ gradient.T, values)
    inner = ((model.rest > 1e-6) & (model.rest < 1.0 - 1e-6)).all(axis=1)
    assert inner.any()
    assert np.abs(forces[inner]).max() < 1e-9 * np.abs(forces).max()
    return {group.element.name for group in model.groups}


@pytest.mark.parametrize("seed", range(6))
def test_hexahedra_of_any_shape_pass_the_patch_test(tmp_path: Path, seed: int) -> None:
    assert patch(block(read(tmp_path, mixed(seed, ("hexahedron",))))) == {"hex8"}


@pytest.mark.parametrize("seed", range(3))
def test_hexahedra_beside_split_cells_are_split_with_a_warning(tmp_path: Path, seed: int) -> None:
    """Four nodes of a face and two triangles of three take different parts of a load: no patch test holds."""
    with pytest.warns(UserWarning, match="cells of kind hexahedron share faces with cells that are split"):
        assert patch(block(read(tmp_path, mixed(seed)))) == {"tet4"}


def test_hexahedra_apart_from_tetrahedra_are_whole(tmp_path: Path) -> None:
    """Two blocks that are one body; both back ends move them alike."""
    pytest.importorskip("numba")
    whole = box_mesh((0.5, 1.0, 1.0), (2, 3, 3), hexahedra=True)
    tets = box_mesh((0.5, 1.0, 1.0), (2, 2, 2), (0.0, 2.0, 0.0))
    cells = [
        ("hexahedron", whole.blocks["hexahedron"].cells),
        ("tetra", tets.tets + len(whole.points)),
    ]
    file = read(tmp_path, meshio.Mesh(np.concatenate([whole.points, tets.points]), cells))
    held, ends = slab("held", "world", 0.0, "block"), []
    for backend in ("numba", "scipy"):
        simulation = Simulation(scene(block(file), attachments=(held,)), backend=backend)
        assert {group.element.name for group in simulation.model.groups} == {"hex8", "tet4"}
        for _ in range(10):
            simulation.step()
        ends.append(np.concatenate([simulation.positions.ravel(), 1e-6 * simulation.von_mises()]))
    moved = np.abs(simulation.positions - simulation.model.rest).max()
    assert moved > 1e-4
    assert simulation.von_mises().min() > 0.0
    assert np.abs(ends[0] - ends[1]).max() < 1e-8 * moved


@pytest.mark.parametrize(
    ("fields", "element", "cells"),
    [
        ({}, "hex8", 8),
        ({"element": "hex8"}, "hex8", 8),
        ({"element": "tet4"}, "tet4", 48),
        ({"order": 1}, "tet4", 48),
        ({"order": 2}, "tet10", 48),
    ],
)
def test_hexahedra_are_whole_unless_the_body_asks_for_tetrahedra(
    tmp_path: Path, fields: dict[str, Any], element: str, cells: int
) -> None:
    cube = box_mesh((1.0, 1.0, 1.0), (2, 2, 2), hexahedra=True)
    file = read(tmp_path, meshio.Mesh(cube.points, [("hexahedron", cube.blocks["hexahedron"].cells)]))
    for mesh in (cube, file):
        (group,) = build(scene(block(mesh, **fields))).model.groups
        assert (group.element.name, len(group.cells)) == (element, cells)
        assert group.volumes.sum() == pytest.approx(1.0)


def test_an_element_that_no_cell_of_the_mesh_fits_is_refused() -> None:
    message = r"body block: the element tet10 has 10 nodes, and the cells of its mesh have 4, 8; choose"
    with pytest.raises(SceneError, match=message):
        build(scene(block(box_mesh((1.0, 1.0, 1.0), (1, 1, 1), hexahedra=True), element="tet10")))


def test_regions_take_whole_hexahedra_by_box_and_by_group(tmp_path: Path) -> None:
    cube = box_mesh((1.0, 1.0, 1.0), (2, 1, 1), hexahedra=True)
    halves = replace(cube, cell_groups={"left": np.arange(6), "right": np.arange(6, 12)})
    stiff = MaterialDescription(young_modulus=1e6, poisson_ratio=0.3)
    for where in ({"group": "right"}, {"box": Box(center=(0.75, 0.5, 0.5), size=(0.4, 1.0, 1.0))}):
        region = MaterialRegionDescription(name="stiff", material=stiff, **where)
        groups = build(scene(block(halves, regions=(region,)))).model.groups
        found = {group.parameter_set[0]: cube.points[group.cells][..., 0].min() for group in groups}
        assert found == {0: 0.0, 1: 0.5}


def cells_of(corners: Array) -> TetMesh:
    return cell_mesh(corners, np.empty((0, 4), np.int64), {"hexahedron": np.arange(8)[None]}, "cell")


def test_a_cell_that_is_turned_inside_out_at_a_point_is_refused() -> None:
    dented = CUBE.astype(float)
    dented[6] = 0.3
    with pytest.raises(MeshError, match="cell 0 has no volume, or is folded"):
        build(scene(block(cells_of(dented))))


def test_a_mirrored_cell_is_the_same_body() -> None:
    there = build(scene(block(cells_of(CUBE.astype(float))))).model
    mirrored = build(scene(block(cells_of(CUBE * [1.0, 1.0, -1.0])))).model
    assert mirrored.groups[0].element.name == "hex8"
    np.testing.assert_allclose(mirrored.mass, there.mass)


def test_the_surface_and_the_pictures_are_those_of_the_tetrahedra() -> None:
    cube = box_mesh((1.0, 1.0, 1.0), (2, 2, 2), hexahedra=True)
    simulation = Simulation(scene(block(cube)))
    np.testing.assert_array_equal(simulation.tets, cube.tets)
    np.testing.assert_array_equal(simulation.bodies[0].boundary, boundary(cube))


@pytest.mark.parametrize("hexahedra", [False, True])
def test_fibres_run_through_all_regions_of_a_body(hexahedra: bool) -> None:
    """Cells of two laws are two groups."""
    bar = box_mesh((1.0, 0.2, 0.2), (10, 2, 2), hexahedra=hexahedra)
    region = MaterialRegionDescription(
        name="linear",
        material=MaterialDescription(young_modulus=2e4, poisson_ratio=0.4, law="corotational"),
        box=Box(center=(0.75, 0.1, 0.1), size=(0.5, 1.0, 1.0)),
    )
    fibres = FibresDescription(name="along", stiffness=1e4, direction=(1.0, 0.0, 0.0))
    model = build(scene(block(bar, regions=(region,), fibres=(fibres,)))).model
    covered = sum(len(group.cells) for group in model.groups if not group.fills)
    assert covered == sum(len(group.cells) for group in model.filling) == (40 if hexahedra else 240)
