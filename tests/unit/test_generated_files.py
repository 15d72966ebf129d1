"""Foreign names in generated files: a line break in them is no line, a colon no key, a hash no comment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from softsim_core.base import ConfigError
from softsim_core.lab.meshing import guess
from softsim_core.mjcf import ImportedScene, write_imported
from softsim_core.physics.mesh import TetMesh
from softsim_core.scene import SceneDescription
from softsim_core.scene.arm import read_urdf
from softsim_core.scene.io import comment, parse_yaml, scalar
from softsim_ros.cli.robots import arm_text

FOREIGN = (
    "a\narm: {urdf: evil.xacro}",
    "a\r- b",
    "x\u2028arm: 1",
    "x\x85arm: 1",
    "a: b",
    "a # b",
    "[a, b",
    "}",
    "*a",
    "no",
    "1e3",
    "",
    " a ",
    "\x1b[31m",
    "'\"",
    "x" * 2000,
)


@pytest.mark.parametrize("text", FOREIGN)
def test_a_comment_stays_one_and_a_value_one_value(text: str) -> None:
    lines = comment(text, text).splitlines()
    assert len(lines) == 2
    assert all(line.startswith("# ") and line.isprintable() for line in lines)
    written = f"key: {{inner: {scalar(text)}, other: 1}}\nlist: [{scalar(text)}]\n"
    expected = {"key": {"inner": text, "other": 1}, "list": [text]}
    assert yaml.safe_load(comment(text) + written) == expected
    assert len(scalar(text).splitlines()) == 1


@pytest.mark.parametrize("text", FOREIGN)
def test_what_was_left_out_of_a_model_adds_no_key(text: str, tmp_path: Path) -> None:
    remarks = (f"geom {text} of body: is not taken over",)
    keys = []
    for noted, origin in (((), "model.xml"), (remarks, f"{text}.xml")):
        imported = ImportedScene(SceneDescription(name="model"), {}, noted, {}, {})
        keys.append(yaml.safe_load(write_imported(imported, tmp_path, origin).read_text(encoding="utf-8")))
    assert keys[0] == keys[1]


def test_names_of_links_and_joints_are_printable(tmp_path: Path) -> None:
    pytest.importorskip("urdf_parser_py")
    file = tmp_path / "arm.urdf"
    for name in ("a&#10;    - robot: evil.yaml", "a&#x85;b", "a&#x202e;b"):
        file.write_text(f'<robot name="r"><link name="{name}"/></robot>')
        with pytest.raises(ConfigError, match="printable characters"):
            read_urdf(file)


def test_a_robot_on_an_arm_has_the_keys_that_were_meant(tmp_path: Path) -> None:
    pytest.importorskip("urdf_parser_py")
    file = tmp_path / "arm: {urdf: x}\n.urdf"
    link, joint = "tip} #, [x", "- turn: it"
    file.write_text(
        f'<robot name="r"><link name="root"/><link name="{link}"/><joint name="{joint}" type="continuous">'
        f'<parent link="root"/><child link="{link}"/><axis xyz="0 0 1"/></joint></robot>'
    )
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 5.0]])
    assumed = guess(TetMesh(corners, np.array([[0, 1, 2, 3]])))
    data = parse_yaml(arm_text("mine", file, read_urdf(file), link, assumed), Path("mine.yaml"))
    assert set(data) == {"name", "arm", "sensors", "keys"}
    assert set(data["arm"]) == {"urdf", "start", "tools"}
    assert data["arm"]["tools"][0]["on"] == link
    assert data["sensors"][0]["on"] == joint
    assert data["keys"]["left"]["joints"] == [joint]
