"""Physical groups of Gmsh files: nodes by name, for attachments and added masses in the place of a box."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from softsim_core.base import ConfigError, SceneError
from softsim_core.physics.mesh import (
    TetMesh,
    boundary_faces,
    box_mesh,
    linear,
    quadratic,
    read_tets,
    write_tets,
)
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


TOUCHED = """
rigid_bodies: [{{name: plate, shape: {{box: [0.02, 0.1, 0.1]}}, pose: {{translation: [0.0702, 0.0, 0.0]}}}}]
collisions:
  - {{name: beam, body: beam, {faces}}}
  - {{name: plate, body: plate}}
"""
TIP_BOX = "boxes: [{center: [0.06, 0.01, 0.01], size: [0.0002, 0.03, 0.03]}]"


@pytest.mark.parametrize("order", [1, 2])
def test_a_group_of_faces_touches_as_a_box_around_them(order: int, tmp_path: Path) -> None:
    gmsh_file(tmp_path, order)
    places = []
    for faces in ("faces: tip", TIP_BOX):
        text = SCENE.format(**BOXES) + TOUCHED.format(faces=faces)
        (tmp_path / "beam.yaml").write_text(text)
        simulation = Simulation(load_scene(tmp_path / "beam.yaml"), backend="scipy")
        collisions = simulation._contacts
        assert collisions is not None
        (touching,) = (each for each in collisions.surfaces if each.name == "beam")
        assert len(touching.triangles) == 8 * (4 if order == 2 else 1)
        carried = collisions.carried
        nodes = np.take_along_axis(carried.nodes, carried.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
        places.append(np.sort(nodes[touching.vertices]))
    assert np.array_equal(*places)


@pytest.mark.parametrize(
    ("faces", "said"),
    [
        ("faces: tpi", "collision beam: body beam has no group 'tpi' of faces in its mesh; did you mean tip"),
        (f"faces: tip, {TIP_BOX}", "`faces` names all of its triangles"),
    ],
)
def test_a_wrong_group_of_faces_is_one_sentence(faces: str, said: str, tmp_path: Path) -> None:
    gmsh_file(tmp_path, 1)
    (tmp_path / "beam.yaml").write_text(SCENE.format(**BOXES) + TOUCHED.format(faces=faces))
    with pytest.raises((ConfigError, SceneError), match=said):
        Simulation(load_scene(tmp_path / "beam.yaml"), backend="scipy")


@pytest.mark.parametrize(
    ("key", "words", "said"),
    [
        ("wall", "group: clmp", "no group 'clmp'; did you mean clamp\\? its groups are .*clamp"),
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


CABLE = """
name: beam
dt: 0.01
bodies:
  - name: beam
    mesh: {{file: beam.msh}}
    material: {{young_modulus: 2.0e+5, poisson_ratio: 0.4}}
    total_mass: 0.02
attachments:
  - {{name: wall, body: beam, to: world, group: clamp}}
joints:
  - {{name: cable, kind: cable, cable: {{body: beam, {cable}}}}}
"""
ALONG = tuple((x, 0.0, 0.02) for x in np.linspace(0.01, 0.06, 6).round(9).tolist())


def cable_file(folder: Path, cable: str) -> Path:
    mesh = box_mesh(LENGTHS, (6, 2, 2))
    nodes = [int(np.argmin(np.linalg.norm(mesh.points - point, axis=1))) for point in ALONG]
    left = np.flatnonzero(np.isclose(mesh.points[:, 0], 0.0))
    groups = {"clamp": left, "tendon": np.array(nodes[::-1])}
    write_tets(folder / "beam.msh", replace(mesh, groups=groups))
    (folder / "beam.yaml").write_text(CABLE.format(cable=cable))
    return folder / "beam.yaml"


@pytest.mark.parametrize(("at", "order"), [(-0.02, 1), (0.08, -1)])
def test_a_cable_through_a_group_is_one_through_its_points(at: float, order: int, tmp_path: Path) -> None:
    """From the pull point on, whichever way the group is numbered."""
    ends = []
    for through in ("group: tendon", f"points: {[list(point) for point in ALONG[::order]]}"):
        file = cable_file(tmp_path, f"{through}, pull_point: [{at}, 0.0, 0.02]")
        simulation = Simulation(load_scene(file), backend="scipy")
        simulation.command([0.002])
        for _ in range(5):
            simulation.step()
        ends.append(simulation.positions.copy())
    assert np.array_equal(ends[0], ends[1])
    assert np.abs(ends[0] - read_tets(tmp_path / "beam.msh").points).max() > 1e-4


@pytest.mark.parametrize(
    ("cable", "said"),
    [
        ("group: tendn, pull_point: [0.0, 0.0, 0.0]", "no group 'tendn'; its groups are clamp, tendon"),
        ("group: tendon", "a group has no first point; give a pull_point"),
        (
            "group: tendon, points: [[0.0, 0.0, 0.0]], pull_point: [0.0, 0.0, 0.0]",
            "points or a group, not both",
        ),
        ("pull_point: [0.0, 0.0, 0.0]", "at least 1 points"),
    ],
)
def test_a_wrong_group_of_a_cable_is_one_sentence(cable: str, said: str, tmp_path: Path) -> None:
    with pytest.raises((ConfigError, SceneError), match=said) as refusal:
        Simulation(load_scene(cable_file(tmp_path, cable)), backend="scipy")
    assert "\n" not in str(refusal.value)
