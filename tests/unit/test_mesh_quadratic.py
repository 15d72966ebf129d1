"""Meshes of order 2: nodes on edges, the linear tetrahedra between them, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from small_scenes import jittered

from softsim_core.base import MeshError
from softsim_core.physics.fem.elements import MIDDLES, TET10
from softsim_core.physics.mesh import (
    MIDDLES as MIDDLES_OF_MESHES,
    TetMesh,
    boundary,
    box_mesh,
    check_tets,
    embed,
    enclosed_volume,
    is_closed,
    linear,
    quadratic,
    read_tets,
    subdivide_mesh,
    write_tets,
)


def block() -> TetMesh:
    """An irregular block of quadratic cells, some of them turned round."""
    mesh = jittered(box_mesh((0.04, 0.03, 0.03), (2, 2, 2)), 0.004, seed=4)
    tets = mesh.tets.copy()
    tets[::3] = tets[::3][:, [1, 0, 2, 3]]
    return quadratic(replace(mesh, tets=tets))


def bulged() -> TetMesh:
    """Its boundary curved: nodes on edges moved outward."""
    mesh, corners = block(), np.unique(block().tets[:, :4])
    outside = np.setdiff1d(boundary(mesh), corners)
    middle = mesh.points.mean(axis=0)
    points = mesh.points.copy()
    points[outside] += 0.03 * (points[outside] - middle)
    return replace(mesh, points=points)


def test_meshes_and_elements_agree_on_the_order_of_nodes() -> None:
    np.testing.assert_array_equal(MIDDLES_OF_MESHES, MIDDLES)
    one = quadratic(TetMesh(TET10.reference[:4], np.array([[0, 1, 2, 3]])))
    np.testing.assert_allclose(one.points[one.tets[0]], TET10.reference)


def test_each_edge_gets_one_node_in_its_middle_and_loses_it_again() -> None:
    mesh = block()
    assert mesh.order == 2
    assert quadratic(mesh) is mesh
    ends = mesh.points[mesh.tets[:, :4]][:, MIDDLES]
    np.testing.assert_allclose(mesh.points[mesh.tets[:, 4:]], ends.mean(axis=2), atol=1e-15)
    assert len(np.unique(mesh.tets)) == len(mesh.points)
    back = linear(mesh)
    assert back.order == 1
    np.testing.assert_array_equal(back.points[back.tets], mesh.points[mesh.tets[:, :4]])
    assert linear(back) is back is subdivide_mesh(back)


@pytest.mark.parametrize("mesh", [block(), bulged()], ids=["flat", "curved"])
def test_eight_parts_fill_each_cell_and_their_boundary_is_closed(mesh: TetMesh) -> None:
    parts = subdivide_mesh(mesh)
    assert len(parts.tets) == 8 * len(mesh.tets)
    corners = parts.points[parts.tets]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    triangles = boundary(mesh)
    assert is_closed(triangles)
    assert len(triangles) == 4 * len(boundary(linear(mesh)))
    assert volumes.sum() == pytest.approx(enclosed_volume(mesh.points, triangles))
    assert check_tets(mesh).volume == pytest.approx(volumes.sum())


def test_points_follow_all_nodes_of_a_cell() -> None:
    mesh = bulged()
    points = np.random.default_rng(2).uniform(0.004, 0.026, (100, 3))
    bound = embed(points, mesh)
    np.testing.assert_allclose(np.einsum("pk,pki->pi", bound.weights, mesh.points[bound.nodes]), points)
    assert not bound.outside.any()
    assert (bound.nodes >= len(linear(mesh).points)).any()


def test_a_cell_that_folds_is_refused() -> None:
    mesh = block()
    points = mesh.points.copy()
    points[mesh.tets[3, 4]] = mesh.points[mesh.tets[3, 3]]
    with pytest.raises(MeshError, match="so curved that they fold"):
        check_tets(replace(mesh, points=points))


@pytest.mark.parametrize(
    ("suffix", "form"), [(".vtk", None), (".vtu", "vtu"), (".msh", "gmsh"), (".inp", "abaqus")]
)
def test_files_keep_quadratic_cells(tmp_path: Path, suffix: str, form: str | None) -> None:
    mesh, file = bulged(), tmp_path / f"block{suffix}"
    if form is None:
        write_tets(file, mesh)
    else:
        meshio.write(file, meshio.Mesh(mesh.points, {"tetra10": mesh.tets}), file_format=form)
    read = read_tets(file)
    np.testing.assert_allclose(read.points[read.tets], mesh.points[mesh.tets], atol=1e-12)


def test_a_file_of_both_orders_is_refused(tmp_path: Path) -> None:
    mesh, file = block(), tmp_path / "both.vtu"
    cells = [("tetra10", mesh.tets[:5]), ("tetra", mesh.tets[5:, :4])]
    meshio.write(file, meshio.Mesh(mesh.points, cells))
    with pytest.raises(MeshError, match="mixes linear and quadratic cells"):
        read_tets(file)
