"""Files of cable points: both formats, and one sentence for each way to be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import ConfigError
from softsim_core.physics.actuation.cable import read_cable_points


def test_the_reference_path(reference_dir: Path) -> None:
    points = read_cable_points(reference_dir / "data" / "cable_gripper" / "cable.json")
    assert points.shape == (14, 3)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(140.3060, abs=1e-4)


def test_yaml_and_json_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[[1, 2.5, 3], [4, 5, 6e-1]]")
    (tmp_path / "a.yaml").write_text("- [1, 2.5, 3]\n- [4, 5, 0.6]\n")
    points = read_cable_points(tmp_path / "a.json")
    np.testing.assert_array_equal(points, read_cable_points(tmp_path / "a.yaml"))
    np.testing.assert_array_equal(points, [[1.0, 2.5, 3.0], [4.0, 5.0, 0.6]])


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.json", "{}", r"must be a list of points \[x, y, z\], not {}"),
        ("a.json", "[]", "must be a list of points"),
        ("a.yaml", "", "must be a list of points .*, not empty"),
        ("a.json", "[[1, 2, 3], [1, 2]]", r"\[1\]: must be a list of 3 finite numbers, not \[1, 2\]"),
        ("a.json", "[[1, 2, NaN]]", r"\[0\]: must be a list of 3 finite numbers"),
        ("a.yaml", "- [1, 2, true]", r"\[0\]: must be a list of 3 finite numbers"),
        ("a.json", '[[1, 2, "3"]]', r"\[0\]: must be a list of 3 finite numbers"),
        ("a.json", "[[1, 2, 3], [1, 2, 3]]", r"\[1\]: lies where the point before it lies"),
        ("a.json", "[[1, 2, 3]", "is not JSON"),
        ("a.yaml", "- [1, 2", "YAML syntax"),
        ("a.csv", "1,2,3", r"ends in \.json, \.yaml or \.yml"),
    ],
)
def test_refusals(tmp_path: Path, name: str, text: str, sentence: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=sentence) as caught:
        read_cable_points(tmp_path / name)
    assert name in str(caught.value)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_cable_points(tmp_path / "none.json")
