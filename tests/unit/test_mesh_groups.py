"""Physical groups of Gmsh files: nodes by name, for attachments and added masses in the place of a box."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from softsim_core.errors import ConfigError, SceneError
from softsim_core.mesh import TetMesh, box_mesh, linear, quadratic, read_tets
from softsim_core.mesh.faces import boundary_faces
from softsim_core.scene import load_scene
from softsim_core.simulation import Simulation

LENGTHS = (0.06, 0.02, 0.02)
SCENE = """
name: beam
dt: 0.01
bodies:
  - name: beam
    mesh: {{file: beam.msh}}
    material: {{young_modulus: 2.0e+5, poisson_ratio: 0.4}}
    total_mass: 0.02
    added_masses: [{{mass: 0.01, {load}}}]
attachments:
  - {{name: wall, body: beam, to: world, {wall}}}
  - {{name: tip, body: beam, to: free, {tip}}}
effector: tip
"""
BOXES = {
    "load": "box: {center: [0.045, 0.01, 0.01], size: [0.0302, 0.03, 0.03]}",
    "wall": "box: {center: [0.0, 0.01, 0.01], size: [0.0002, 0.03, 0.03]}",
    "tip": "box: {center: [0.06, 0.01, 0.01], size: [0.0002, 0.03, 0.03]}",
}


def gmsh_file(folder: Path, order: int, named: bool = True) -> TetMesh:
    """A beam: its ends are groups of faces, its outer half is one of cells, a corner one of points."""
    mesh = box_mesh(LENGTHS, (6, 2, 2))
    mesh = quadratic(mesh) if order == 2 else mesh
    faces = boundary_faces(mesh)
    x = mesh.points[faces][..., 0]
    ends = [faces[np.isclose(x, at).all(axis=1)] for at in (0.0, LENGTHS[0])]
    outer = mesh.points[mesh.tets][..., 0].min(axis=1) > 0.5 * LENGTHS[0] - 1e-9
    kind = ("tetra10", "triangle6") if order == 2 else ("tetra", "triangle")
    tags = [
        np.where(outer, 4, 7),
        np.repeat([1, 2], [len(each) for each in ends]),
        np.array([9]),
    ]
    data = meshio.Mesh(
        mesh.points,
        [(kind[0], mesh.tets), (kind[1], np.concatenate(ends)), ("vertex", np.array([[0]]))],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
    )
    if named:
        ids = {"clamp": (1, 2), "tip": (2, 2), "heavy": (4, 3), "soft": (7, 3), "corner": (9, 0)}
        data.field_data = {name: np.array(each) for name, each in ids.items()}
    meshio.write(folder / "beam.msh", data, file_format="gmsh22", binary=False)
    return mesh


@pytest.mark.parametrize("order", [1, 2])
def test_groups_of_points_faces_and_cells_are_read_by_name(order: int, tmp_path: Path) -> None:
    mesh = gmsh_file(tmp_path, order)
    read = read_tets(tmp_path / "beam.msh")
    assert set(read.groups) == {"clamp", "tip", "heavy", "soft", "corner"}
    x = mesh.points[:, 0]
    assert np.array_equal(read.groups["clamp"], np.flatnonzero(np.isclose(x, 0.0)))
    assert np.array_equal(read.groups["tip"], np.flatnonzero(np.isclose(x, LENGTHS[0])))
    assert np.array_equal(read.groups["heavy"], np.flatnonzero(x > 0.5 * LENGTHS[0] - 1e-9))
    assert read.groups["corner"].tolist() == [0]
    assert set(read.surfaces) == {"clamp", "tip"}


def test_groups_without_names_go_by_their_numbers(tmp_path: Path) -> None:
    gmsh_file(tmp_path, 1, named=False)
    assert set(read_tets(tmp_path / "beam.msh").groups) == {"1", "2", "4", "7", "9"}


@pytest.mark.parametrize("order", [1, 2])
def test_groups_stay_when_a_mesh_changes_its_order(order: int, tmp_path: Path) -> None:
    gmsh_file(tmp_path, order)
    read = read_tets(tmp_path / "beam.msh")
    other = quadratic(read) if order == 1 else linear(read)
    at = np.flatnonzero(np.isclose(other.points[:, 0], 0.0))
    assert np.array_equal(np.sort(other.groups["clamp"]), at)


@pytest.mark.parametrize("order", [1, 2])
def test_a_scene_by_groups_moves_as_one_by_boxes(order: int, tmp_path: Path) -> None:
    gmsh_file(tmp_path, order)
    words = {"load": "group: heavy", "wall": "group: clamp", "tip": "group: tip"}
    ends = []
    for chosen in (BOXES, words):
        (tmp_path / "beam.yaml").write_text(SCENE.format(**chosen))
        simulation = Simulation(load_scene(tmp_path / "beam.yaml"), backend="scipy")
        for _ in range(5):
            simulation.step()
        ends.append(simulation.positions.copy())
    assert np.array_equal(ends[0], ends[1])
    assert np.abs(ends[0] - read_tets(tmp_path / "beam.msh").points).max() > 1e-5


@pytest.mark.parametrize(
    ("key", "words", "said"),
    [
        ("wall", "group: clmp", "no group 'clmp'; its groups are .*clamp"),
        ("load", "group: none", "no group 'none'"),
        ("wall", "group: clamp, box: {center: [0, 0, 0], size: [1, 1, 1]}", "box, sphere, end and group"),
        ("load", "sphere: {center: [0, 0, 0], radius: 1}, group: heavy", "exactly one of"),
        ("tip", "group: soft", "share"),
    ],
)
def test_a_wrong_group_is_one_sentence(key: str, words: str, said: str, tmp_path: Path) -> None:
    gmsh_file(tmp_path, 1)
    (tmp_path / "beam.yaml").write_text(SCENE.format(**{**BOXES, key: words}))
    with pytest.raises((ConfigError, SceneError), match=said) as refusal:
        Simulation(load_scene(tmp_path / "beam.yaml"), backend="scipy")
    assert "\n" not in str(refusal.value)


def test_a_mesh_of_arrays_has_groups_of_its_own(tmp_path: Path) -> None:
    gmsh_file(tmp_path, 1)
    (tmp_path / "beam.yaml").write_text(SCENE.format(**{**BOXES, "wall": "group: mine"}))
    robot = load_scene(tmp_path / "beam.yaml")
    mesh = replace(read_tets(tmp_path / "beam.msh"), groups={"mine": np.array([0, 1, 2])})
    body = replace(robot.scene.bodies[0], mesh=mesh)
    simulation = Simulation(replace(robot.scene, bodies=(body,)), backend="scipy")
    before = simulation.positions.copy()
    simulation.step()
    still = np.flatnonzero((simulation.positions == before).all(axis=1))
    assert still.tolist() == [0, 1, 2]
