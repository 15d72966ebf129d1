"""Groups of nodes in Gmsh files that we write, read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from softsim_core.physics.mesh import box_mesh, quadratic, read_tets, write_tets


@pytest.mark.parametrize("order", [1, 2])
def test_groups_come_back_by_name(order: int, tmp_path: Path) -> None:
    mesh = box_mesh((0.03, 0.02, 0.01), (3, 2, 1))
    mesh = quadratic(mesh) if order == 2 else mesh
    groups = {"on the left": np.flatnonzero(np.isclose(mesh.points[:, 0], 0.0)), "one": np.array([4])}
    read = read_tets(write_tets(tmp_path / "mesh.msh", replace(mesh, groups=groups)))
    assert np.array_equal(read.points, mesh.points)
    assert np.array_equal(read.tets, mesh.tets)
    assert {name: nodes.tolist() for name, nodes in read.groups.items()} == {
        name: nodes.tolist() for name, nodes in groups.items()
    }
    other = meshio.read(tmp_path / "mesh.msh")  # and by another reader
    assert other.field_data["one"].tolist() == [2, 0]


def test_a_mesh_without_groups_has_none(tmp_path: Path) -> None:
    mesh = box_mesh((0.03, 0.02, 0.01), (3, 2, 1))
    assert read_tets(write_tets(tmp_path / "mesh.msh", mesh)).groups == {}
