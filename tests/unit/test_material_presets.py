"""Elastomers by name: what they are made of, how scenes name them, what is refused and warned of."""

from __future__ import annotations

import math
import pickle
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
from small_scenes import scene

from softsim_core import Simulation, load_scene
from softsim_core.base import ConfigError, SceneError
from softsim_core.physics.fem.materials import elastomer, elastomer_names
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import BodyDescription, MaterialDescription
from softsim_core.scene.io import load_yaml

BLOCK = """
name: block
bodies:
  - name: block
    mesh: {file: %s}
    material: %s
    total_mass: 0.1
"""


def written(tmp_path: Path, material: str) -> Path:
    mesh = Path(__file__).resolve().parents[2] / "configs/meshes/finger_low.vtk"
    file = tmp_path / "block.yaml"
    file.write_text(BLOCK % (mesh, material))
    return file


def test_nineteen_elastomers_are_known_and_their_source_is_named() -> None:
    assert len(elastomer_names()) == 19
    for name in elastomer_names():
        assert "ODbL" in elastomer(name).source


@pytest.mark.parametrize("name", ["Dragon Skin 20", "dragon-skin 20", "DRAGONSKIN20"])
def test_a_name_is_found_however_it_is_written(name: str) -> None:
    material = MaterialDescription(preset=name, stiffness_factor=1.75)
    assert (material.preset, material.law) == ("Dragon Skin 20", "yeoh")
    assert material.values["c1"] == 66550.0
    assert material.plain() == {"preset": "Dragon Skin 20", "stiffness_factor": 1.75}
    assert pickle.loads(pickle.dumps(material)) == material
    assert material.with_values(c1=7e4).plain()["c1"] == 7e4


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("Dragon Skin 10", "unknown material 'Dragon Skin 10'; did you mean Dragon Skin 10 MEDIUM"),
        ("Dragonskin 2O", "did you mean Dragon Skin 20"),
        ("steel", "unknown material 'steel'; known: .* and \\d+ more \\(all: softsim material\\)"),
        ("", "unknown material ''"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest_ones(name: str, sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        MaterialDescription(preset=name)


def test_a_preset_has_no_constants_for_every_law() -> None:
    with pytest.raises(SceneError, match="no constants for the law 'mooney_rivlin'; fitted: yeoh, ogden"):
        MaterialDescription(preset="Dragon Skin 20", law="mooney_rivlin")


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("Dragon Skin 20", {"preset": "Dragon Skin 20"}),
        ("{preset: Ecoflex 00-30, law: ogden}", {"preset": "Ecoflex 00-30", "law": "ogden"}),
        (
            "{preset: Ecoflex 00-30, stiffness_factor: 2, poisson_ratio: 0.45}",
            {"preset": "Ecoflex 00-30", "stiffness_factor": 2.0, "poisson_ratio": 0.45},
        ),
    ],
)
def test_scene_files_name_presets(tmp_path: Path, text: str, plain: dict[str, object]) -> None:
    assert load_yaml(written(tmp_path, text)).scene.bodies[0].material.plain() == plain


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("Ecoflex", "material: unknown material 'Ecoflex'; did you mean Ecoflex 00-10"),
        ("{preset: 3}", "preset: must be the name of a material, not 3"),
        ("{preset: RTV615, law: corotational}", "law: RTV615: no constants for the law 'corotational'"),
        ("{preset: RTV615, stiffness_factor: 0}", "stiffness_factor: must be > 0, not 0"),
        ("{preset: RTV615, young_modulus: 1.0}", "young_modulus"),
        ("[1]", "must be the name of a preset or a mapping of parameters"),
    ],
)
def test_mistakes_in_scene_files_name_their_key(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence) as caught:
        load_yaml(written(tmp_path, text))
    assert len(caught.value.problem) < 300


def test_a_preset_is_laid_over_a_material_and_changed_in_its_turn(tmp_path: Path) -> None:
    for named in ("Dragon Skin 20", {"preset": "Dragon Skin 20"}):
        over = {"bodies": [{"name": "silicone", "material": named}]}
        robot = load_scene("tripod", kind="robots", overrides=over)
        assert robot.scene.bodies[0].material == MaterialDescription(preset="Dragon Skin 20")
    file = written(tmp_path, "Dragon Skin 20")
    factor = {"bodies": [{"name": "block", "material": {"stiffness_factor": 1.5}}]}
    changed = load_yaml(file, factor).scene.bodies[0].material
    assert changed == MaterialDescription(preset="Dragon Skin 20", stiffness_factor=1.5)


def block(**fields: object) -> BodyDescription:
    mesh = box_mesh((0.1, 0.1, 0.1), (2, 2, 2))
    return BodyDescription(name="block", mesh=mesh, **fields)  # type: ignore[arg-type]


def test_density_comes_from_the_preset_where_it_is_known() -> None:
    known = MaterialDescription(preset="Dragon Skin 10 MEDIUM", poisson_ratio=0.4, stiffness_factor=1.75)
    assert block(material=known).density == 1070.0
    assert Simulation(scene(block(material=known)), backend="scipy").model.mass.sum() == pytest.approx(1.07)
    assert block(material=known, density=1000.0).density == 1000.0
    with pytest.raises(SceneError, match="give exactly one of `density`"):
        block(material=MaterialDescription(preset="RTV615"))


def test_the_stiffness_of_the_table_is_warned_of_until_a_factor_is_given() -> None:
    for factor, warned in ((1.0, True), (1.8, False)):
        material = MaterialDescription(preset="Ecoflex 00-30", poisson_ratio=0.4, stiffness_factor=factor)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            Simulation(scene(block(material=material, density=1000.0)), backend="scipy")
        assert any("stiffness of Ecoflex 00-30 is too low" in str(one.message) for one in caught) == warned


def test_the_factor_of_a_preset_is_tuned_while_it_runs() -> None:
    made_of = MaterialDescription(preset="Ecoflex 00-30", poisson_ratio=0.4, stiffness_factor=1.5)
    simulation = Simulation(scene(block(material=made_of, density=1000.0)), backend="scipy")
    simulation.set_material("block", stiffness_factor=2.0)
    assert simulation.material("block") == made_of.with_values(stiffness_factor=2.0)
    with pytest.raises(ValueError, match="stiffness_factor = nan must be > 0"):
        simulation.set_material("block", stiffness_factor=math.nan)


def test_every_constant_of_a_preset_has_a_slider_and_a_ros_parameter_that_hold_its_value() -> None:
    pytest.importorskip("rclpy")
    from softsim_ros.nodes.simulator import tunables as parameters
    from softsim_ros.nodes.viewer import tunables as sliders

    made_of = MaterialDescription(preset="Dragon Skin 20", poisson_ratio=0.4999)
    robot = load_scene("tripod")
    robot = robot.with_scene(bodies=tuple(replace(each, material=made_of) for each in robot.scene.bodies))
    found = parameters(robot)
    for slider in sliders(robot):
        if slider.name in robot.scene.bodies[0].material.values:
            assert slider.lower < slider.upper
            assert slider.lower <= slider.start <= slider.upper
            low, high = found[slider.name].about.within
            assert low <= found[slider.name].value <= high
    assert {"stiffness_factor", "c3", "poisson_ratio"} <= {slider.name for slider in sliders(robot)}
