"""A scene is measured by its description; a message that describes too much is refused before it is built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from softsim_core.base import ConfigError, MeshFile, SceneError
from softsim_core.physics.mesh import box_mesh, quadratic
from softsim_core.scene import (
    BodyDescription,
    MaterialDescription,
    RobotDescription,
    SceneDescription,
    check_size,
    load_scene,
    scene_size,
)
from softsim_core.scene.building import builder
from softsim_core.scene.io import read_description, write_description

ROD = """
name: rods
bodies:
  - name: rod
    rod:
      centreline: [[0, 0, 0], [0.3, 0, 0]]
      section: {{shape: rectangle, size: [0.01, 0.01]}}
      {rod}
    {body}
    density: 1000.0
"""
SLENDER = "material: {law: rod, young_modulus: 1000000.0, poisson_ratio: 0.45}"
SWEPT = "element: {}\n    material: {{young_modulus: 1000000.0, poisson_ratio: 0.45}}"


def rod(tmp_path: Path, keys: str, body: str = SLENDER) -> RobotDescription:
    file = tmp_path / "rods.yaml"
    file.write_text(ROD.format(rod=keys, body=body))
    return load_scene(file)


@pytest.mark.parametrize(
    ("keys", "body"),
    [
        ("elements: 5", SLENDER),
        ("elements: 5\n      start_clamp: {length: 0.001}\n      end_clamp: {length: 0.001}", SLENDER),
        ("elements: 3\n      across: [2, 4]", SWEPT.format("tet4")),
        ("elements: 3\n      across: [2, 4]", SWEPT.format("tet10")),
    ],
)
def test_the_size_told_is_the_size_built(keys: str, body: str, tmp_path: Path) -> None:
    scene = rod(tmp_path, keys, body).scene
    (built,) = builder.rest_bodies(scene)
    size = scene_size(scene)
    assert (size.nodes, size.cells, size.largest) == (len(built.mesh.points), built.cell_count, "rod")


def test_meshes_of_arrays_and_of_large_files_count(tmp_path: Path) -> None:
    mesh = box_mesh((1.0, 1.0, 1.0), (3, 3, 3), (0.0, 0.0, 0.0), "box")
    material = MaterialDescription(young_modulus=1e5, poisson_ratio=0.4)

    def size(**body: Any) -> tuple[int, int]:
        description = BodyDescription(name="box", material=material, density=1000.0, **body)
        found = scene_size(SceneDescription(name="box", bodies=(description,)))
        return found.nodes, found.cells

    assert size(mesh=mesh) == (64, 162)
    assert size(mesh=mesh, order=2) >= (len(quadratic(mesh).points), 162)
    assert scene_size(load_scene("tripod_high").scene).nodes > 1000


@pytest.mark.parametrize(
    ("keys", "body", "needs"),
    [
        ("elements: 100000", SLENDER, "GB (600003 nodes and 100000 cells, most of them in body rod)"),
        ("across: [1000, 1000]", SWEPT.format("tet4"), "(9018009 nodes and 48000000 cells"),
        ("elements: 100000\n      across: [1000, 1000]", SWEPT.format("tet10"), "GB are allowed"),
    ],
)  # fmt: skip
def test_a_scene_from_a_message_is_measured_before_it_is_built(
    keys: str, body: str, needs: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    from softsim_ros.nodes.simulator import SceneBuilder

    robot = rod(tmp_path, keys, body)
    for door in (
        lambda: SceneBuilder(lambda: pytest.fail("built"), None).build(robot),  # type: ignore[arg-type]
        lambda: check_size(robot.scene),
    ):
        with pytest.raises(SceneError) as caught:
            door()
        assert needs in str(caught.value)
        assert "start with SOFTSIM_MOST_MEMORY=" in str(caught.value)
    shown = read_description(write_description(robot))
    assert (shown.name, shown.scene.bodies) == ("rods", ())
    monkeypatch.setenv("SOFTSIM_MOST_MEMORY", "1e10")
    check_size(robot.scene)


def test_the_budget_is_a_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOFTSIM_MOST_MEMORY", "much")
    with pytest.raises(SceneError, match="SOFTSIM_MOST_MEMORY='much' in the environment is refused"):
        check_size(rod(tmp_path, "elements: 1").scene)


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        ({"dt": 1e-300}, "dt: must be 1e-09 to 1e+09 s"),
        ({"dt": 1e300}, "dt: must be 1e-09 to 1e+09 s"),
        ({"solver": {"iterations": 1_000_000_000}}, "solver.iterations: must be 1 to 1000"),
        ({"contact": {"iterations": 1_000_000_000}}, "contact.iterations: must be 1 to 100000"),
        ({"bodies": [{"name": "rod", "rod": {"elements": 1_000_000_000}}]}, "elements: must be 1 to 100000"),
        ({"bodies": [{"name": "rod", "rod": {"across": [3000, 1]}}]}, "must be two numbers from 1 to 1000"),
    ],
)  # fmt: skip
def test_keys_that_would_never_end_have_bounds(
    overrides: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    rod(tmp_path, "elements: 1")
    with pytest.raises(ConfigError) as caught:
        load_scene(tmp_path / "rods.yaml", overrides)
    assert sentence in str(caught.value)


@pytest.mark.parametrize("name", ["tripod", "cable_gripper", "pneu_arm", "pneu_finger", "emio"])
def test_installed_robots_are_far_below_the_budget(name: str) -> None:
    assert scene_size(load_scene(name).scene).gigabytes < 0.5


def test_a_scene_message_has_no_file_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    text = write_description(load_scene("tripod_high"))
    monkeypatch.setattr("softsim_core.scene.size.read_tets", lambda file: pytest.fail(f"{file} opened"))
    assert read_description(text).scene.bodies


def test_a_file_that_is_not_there_is_left_to_who_builds() -> None:
    mesh = MeshFile(file=Path("/nowhere/mesh.vtk"))
    material = MaterialDescription(young_modulus=1e5, poisson_ratio=0.4)
    body = BodyDescription(name="box", mesh=mesh, material=material, density=1000.0)
    assert scene_size(SceneDescription(name="box", bodies=(body,))).nodes == 0
