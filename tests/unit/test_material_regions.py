"""Parts of a body that are made of something else: by a group of volumes, a box or a sphere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from softsim_core.base import ConfigError, SceneError
from softsim_core.physics.mesh import TetMesh, box_mesh, linear, quadratic, read_tets, subdivide_mesh
from softsim_core.scene import MaterialDescription, load_scene
from softsim_core.simulation import Simulation

LENGTHS = (0.06, 0.02, 0.02)
HALF = "box: {center: [0.015, 0.01, 0.01], size: [0.0302, 0.03, 0.03]}"
SCENE = """
name: beam
dt: 0.01
solver: {{rayleigh_mass: 20.0}}
bodies:
  - name: beam
    mesh: {{file: beam.msh}}
    material: {{young_modulus: 2.0e+5, poisson_ratio: 0.0}}
    density: 1000.0
    regions: [{regions}]
attachments:
  - {{name: wall, body: beam, to: world, box: {{center: [0.0, 0.01, 0.01], size: [0.0002, 0.03, 0.03]}}}}
"""
STIFF = "material: {young_modulus: 1.0e+6, poisson_ratio: 0.0}"


def outer_half(mesh: TetMesh) -> np.ndarray:
    return mesh.points[mesh.tets[:, :4]].mean(axis=1)[:, 0] > 0.5 * LENGTHS[0]


def gmsh_file(folder: Path, order: int = 1) -> TetMesh:
    """A beam in two blocks of tetrahedra, whose inner half is the group `bone`, the other `flesh`."""
    mesh = box_mesh(LENGTHS, (6, 2, 2))
    mesh = quadratic(mesh) if order == 2 else mesh
    outer, kind = outer_half(mesh), "tetra10" if order == 2 else "tetra"
    tags = [np.full(int(outer.sum()), 2), np.full(int((~outer).sum()), 1)]
    data = meshio.Mesh(
        mesh.points,
        [(kind, mesh.tets[outer]), (kind, mesh.tets[~outer])],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
    )
    data.field_data = {"bone": np.array([1, 3]), "flesh": np.array([2, 3])}
    meshio.write(folder / "beam.msh", data, file_format="gmsh22", binary=False)
    return read_tets(folder / "beam.msh")


def simulation(folder: Path, regions: str, backend: str = "scipy") -> Simulation:
    (folder / "beam.yaml").write_text(SCENE.format(regions=regions))
    return Simulation(load_scene(folder / "beam.yaml"), backend=backend)


@pytest.mark.parametrize("order", [1, 2])
def test_groups_of_volumes_are_read_and_stay(order: int, tmp_path: Path) -> None:
    mesh = gmsh_file(tmp_path, order)
    for each in (mesh, linear(mesh), quadratic(mesh), subdivide_mesh(mesh)):
        assert np.array_equal(each.cell_groups["flesh"], np.flatnonzero(outer_half(each)))
        assert np.array_equal(each.cell_groups["bone"], np.flatnonzero(~outer_half(each)))


def test_a_bar_of_two_materials_gives_way_as_springs_in_series(tmp_path: Path) -> None:
    """Pulled along by a force F: F l / (A E) of each half."""
    gmsh_file(tmp_path)
    moved = simulation(tmp_path, f"{{name: inner, group: bone, {STIFF}}}")
    moved.model.gravity[:] = 0.0
    tip = np.flatnonzero(np.isclose(moved.model.rest[:, 0], LENGTHS[0]))
    weights = np.zeros(len(moved.model.rest))
    boundary = moved.bodies[0].boundary
    faces = boundary[np.isin(boundary, tip).all(axis=1)]
    points = moved.model.rest
    for face in faces:
        normal = np.cross(points[face[1]] - points[face[0]], points[face[2]] - points[face[0]])
        weights[face] += np.linalg.norm(normal) / 6.0
    area, force = 4e-4, 0.1
    moved.forces[:, 0] = force * weights / weights.sum()
    stretched = moved.equilibrium().state.positions[tip, 0] - LENGTHS[0]
    expected = force / area * 0.5 * LENGTHS[0] * (1.0 / 1e6 + 1.0 / 2e5)
    np.testing.assert_allclose(stretched, expected, rtol=2e-3)


def test_a_group_a_box_and_the_same_material_everywhere(tmp_path: Path) -> None:
    gmsh_file(tmp_path)
    ends = []
    for regions in (
        f"{{name: inner, group: bone, {STIFF}}}",
        f"{{name: inner, {HALF}, {STIFF}}}",
        "{name: inner, group: bone, material: {young_modulus: 2.0e+5, poisson_ratio: 0.0}}",
        "",
    ):
        each = simulation(tmp_path, regions)
        for _ in range(10):
            each.step()
        ends.append(each.positions)
    assert np.array_equal(ends[0], ends[1])
    np.testing.assert_allclose(ends[2], ends[3], atol=1e-12)
    assert np.abs(ends[0] - ends[3]).max() > 1e-4


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize("law", ["corotational", "stable_neo_hookean"], ids=["one law", "two laws"])
def test_both_back_ends_agree(law: str, tmp_path: Path) -> None:
    pytest.importorskip("numba")
    gmsh_file(tmp_path)
    made_of = f"material: {{law: {law}, young_modulus: 1.0e+6, poisson_ratio: 0.3}}"
    runs = [
        simulation(tmp_path, f"{{name: inner, group: bone, {made_of}}}", each) for each in ("numba", "scipy")
    ]
    for each in runs:
        for _ in range(5):
            each.step()
    np.testing.assert_allclose(runs[0].positions, runs[1].positions, atol=1e-12)


def test_a_region_is_tuned_by_its_name(tmp_path: Path) -> None:
    gmsh_file(tmp_path)
    tuned = simulation(
        tmp_path, "{name: inner, group: bone, material: {young_modulus: 2.0e+5, poisson_ratio: 0.0}}"
    )
    assert [name for name, _ in tuned.scene.materials] == ["beam", "beam.inner"]
    tuned.set_material("beam.inner", young_modulus=1e6)
    stiff = simulation(tmp_path, f"{{name: inner, group: bone, {STIFF}}}")
    for each in (tuned, stiff):
        for _ in range(5):
            each.step()
    assert np.array_equal(tuned.positions, stiff.positions)
    changed = tuned.scene.bodies[0].regions[0].with_values({"young_modulus": 3e5})
    assert changed.material == MaterialDescription(young_modulus=3e5, poisson_ratio=0.0)


@pytest.mark.parametrize(
    ("regions", "said"),
    [
        (
            f"{{name: a, group: bon, {STIFF}}}",
            "no group of volumes 'bon'; did you mean bone\\? it has",
        ),
        (
            f"{{name: a, sphere: {{center: [1.0, 0.0, 0.0], radius: 0.01}}, {STIFF}}}",
            "no cell's middle lies inside",
        ),
        (
            f"{{name: a, group: bone, {STIFF}}}, {{name: b, {HALF}, {STIFF}}}",
            "regions a and b share 72 cells",
        ),
        (f"{{name: a, group: bone, {STIFF}}}, {{name: b, group: flesh, {STIFF}}}", "cover it whole"),
        (
            f"{{name: a, group: bone, {STIFF}}}, {{name: a, group: flesh, {STIFF}}}",
            "share the name a; rename one",
        ),
        (f"{{name: a, {STIFF}}}", "exactly one of group, box and sphere"),
        ("{name: a, group: bone, material: {young_modulus: -1.0, poisson_ratio: 0.0}}", "young_modulus"),
    ],
)
def test_wrong_regions_are_one_sentence(regions: str, said: str, tmp_path: Path) -> None:
    gmsh_file(tmp_path)
    with pytest.raises((ConfigError, SceneError), match=said) as refusal:
        simulation(tmp_path, regions)
    assert "\n" not in str(refusal.value)


def test_a_rod_takes_no_regions(tmp_path: Path) -> None:
    gmsh_file(tmp_path)
    body = simulation(tmp_path, f"{{name: inner, group: bone, {STIFF}}}").scene.bodies[0]
    rod = load_scene("emio").scene.bodies[0]
    with pytest.raises(SceneError, match="takes no regions"):
        replace(rod, regions=body.regions)


@pytest.mark.ros
def test_a_region_is_a_parameter_of_the_simulator_node(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    from softsim_ros.nodes.simulator import tunables, with_values

    gmsh_file(tmp_path)
    (tmp_path / "beam.yaml").write_text(SCENE.format(regions=f"{{name: inner, group: bone, {STIFF}}}"))
    robot = load_scene(tmp_path / "beam.yaml")
    assert tunables(robot)["inner.young_modulus"].value == 1e6
    body = with_values(robot, {"inner.young_modulus": 3e6}).scene.bodies[0]
    assert body.regions[0].material.young_modulus == 3e6
    assert body.material.young_modulus == 2e5
