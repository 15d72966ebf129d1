"""Parameters hidden in made measurements are found, with honest errors; what rows do not tell is said."""

from __future__ import annotations

import json
import shlex
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

import numpy as np
import pytest
import yaml

from softsim_core import ConfigError, DataError, SceneError, load_scene
from softsim_core.base import Array
from softsim_core.lab.identification import (
    QUANTILE,
    Calibration,
    CalibrationDescription,
    ParameterDescription,
    calibrate,
    data_of,
    load_calibration,
    model_replay,
    problem,
    replace_expressions,
)
from softsim_core.simulation import Simulation
from softsim_ros.cli import main

pytestmark = pytest.mark.slow

ROBOT = """
name: arm
bodies:
  - name: rod
    rod:
      centreline: [[0, 0, 0], [0.2, 0, 0]]
      section: {shape: ellipse, size: [0.006, 0.006]}
      elements: 4
    material: {law: rod, young_modulus: 2.0e+6, poisson_ratio: 0.4}
    density: 1100
    added_masses: [{mass: 0.005, end: end}]
joints: [{name: servo}]
attachments:
  - {name: base, body: rod, to: servo, end: start}
  - {name: tip, body: rod, to: free, end: end, frame: {translation: [0.2, 0, 0]}}
effector: tip
"""
DATA_SET = """
name: bench
robot: arm.yaml
sessions:
  - name: first
    file: first.csv
    commands: {columns: [theta_rad], unit: rad}
    sensors: [{name: marker, columns: [x_mm, y_mm, z_mm], unit: mm, at: effector}]
"""
TRUE = {"zero": 0.08, "young": 2.6}
ZERO = {"name": "zero", "start": 0.0, "lower": -0.3, "upper": 0.3, "unit": "rad"}
YOUNG = {"name": "young", "start": 2.0, "lower": 0.5, "upper": 6.0, "unit": "MPa"}
OVERLAY = {
    "joints": [{"name": "servo", "rest": "= -zero"}],
    "bodies": [{"name": "rod", "material": {"young_modulus": "= 1e6 * young"}}],
}


@cache
def poses() -> tuple[Array, Array]:
    """Commands, and where the tip of the true arm is."""
    robot = load_scene_text(replace_expressions(OVERLAY, TRUE))
    simulation = Simulation(robot, "scipy")
    commands = np.linspace(-1.1, 1.1, 13)
    places = []
    for each in commands.tolist():
        simulation.settle([each])
        places.append(simulation.frames()["tip"].position)
    return commands, np.array(places)


def load_scene_text(overlay: dict[str, Any]) -> Any:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "arm.yaml"
        file.write_text(ROBOT)
        return load_scene(file, overlay)


def bench(folder: Path, noise: float = 2e-4, seed: int = 0, **changes: Any) -> Path:
    """A folder with robot, data set and calibration."""
    commands, places = poses()
    measured = places + noise * np.random.default_rng(seed).standard_normal(places.shape)
    rows = np.column_stack([commands, 1e3 * measured])
    np.savetxt(folder / "first.csv", rows, "%.9g", ",", header="theta_rad,x_mm,y_mm,z_mm", comments="")
    (folder / "arm.yaml").write_text(ROBOT)
    (folder / "dataset.yaml").write_text(DATA_SET)
    given = {"name": "arm", "data_set": ".", "parameters": [ZERO, YOUNG], "overlay": OVERLAY, **changes}
    (folder / "calibration.yaml").write_text(yaml.safe_dump(given))
    return folder


def fitted(folder: Path) -> Calibration:
    description, file = load_calibration(folder)
    return calibrate(description, data_of(description, file, None))


@cache
def found() -> Calibration:
    """Thirteen poses of the arm, with noise of 0.2 mm."""
    return fitted(bench(Path(mkdtemp())))


def test_hidden_numbers_are_found() -> None:
    result = found()
    assert result.found.all()
    assert not result.at_bounds.any()
    assert (np.abs(result.values - list(TRUE.values())) < 4.0 * result.errors).all()
    assert (result.errors < [2e-3, 0.05]).all()
    assert result.before["first"] > 5e-3
    assert result.after["first"] == pytest.approx(np.sqrt(8.0 / np.pi) * 2e-4, rel=0.4)  # of normal noise
    assert result.rows == {"first": 13}


def test_several_processes_find_the_same_slopes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replays shared among processes give the same bytes as in one; stability checks change none."""
    part = (found().values - found().problem.low) / found().problem.span
    slopes = []
    for long in (0.0, np.inf):
        monkeypatch.setattr(problem, "LONG", long)
        found().problem.around = None
        slopes.append(found().problem.slopes(part))
    assert np.array_equal(*slopes)
    monkeypatch.setattr(model_replay.Near, "checked", property(lambda near: True, lambda near, value: None))
    found().problem.around = None
    assert np.allclose(found().problem.slopes(part), slopes[0], rtol=1e-3, atol=1e-6)


@pytest.mark.exhaustive
def test_without_noise_they_are_exact(tmp_path: Path) -> None:
    result = fitted(bench(tmp_path, noise=0.0))
    assert result.values == pytest.approx(list(TRUE.values()), rel=1e-3)
    assert result.after["first"] < 2e-5


@pytest.mark.exhaustive
def test_intervals_hold_the_truth_as_often_as_told(tmp_path: Path) -> None:
    inside = []
    for seed in range(200):
        folder = tmp_path / str(seed)
        folder.mkdir()
        result = fitted(bench(folder, seed=seed))
        inside.append(np.abs(result.values - list(TRUE.values())) < QUANTILE * result.errors)
    assert 0.90 <= np.mean(inside) <= 0.98  # 400 intervals of 95 %: within three standard deviations


def test_what_rows_do_not_tell_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without weight, the tip is where the servo points, however stiff the arm is."""
    shear = {"name": "shear", "start": 1.0, "lower": 0.5, "upper": 2.0}
    overlay = {
        "joints": OVERLAY["joints"],
        "bodies": [{"name": "rod", "material": {"young_modulus": 2.6e6, "shear_factor": "= shear"}}],
    }
    folder = bench(tmp_path, parameters=[ZERO, shear], overlay=overlay)
    assert main(["calibrate", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = {name: line for line in lines for name in ("zero", "shear") if line.split()[:1] == [name]}
    assert "NOT FOUND" not in rows["zero"]
    assert "NOT FOUND" in rows["shear"]


def test_a_prior_stands_where_rows_tell_nothing(tmp_path: Path) -> None:
    shear = {"name": "shear", "start": 1.2, "lower": 0.2, "upper": 5.0, "prior": 0.1}
    overlay = {
        "joints": OVERLAY["joints"],
        "bodies": [{"name": "rod", "material": {"young_modulus": 2.6e6, "shear_factor": "= shear"}}],
    }
    result = fitted(bench(tmp_path, parameters=[ZERO, shear], overlay=overlay))
    assert result.values[1] == pytest.approx(1.2, abs=0.05)
    assert result.errors[1] == pytest.approx(0.1, rel=0.1)


@pytest.mark.exhaustive
def test_outliers_hardly_matter_with_a_robust_loss(tmp_path: Path) -> None:
    folder = bench(tmp_path, loss="soft_l1", scale_mm=0.3)
    lines = (folder / "first.csv").read_text().splitlines()
    for k in (3, 7, 11):
        theta, x, y, z = lines[k].split(",")
        lines[k] = f"{theta},{float(x) + 9.0:.6f},{y},{float(z) - 12.0:.6f}"
    (folder / "first.csv").write_text("\n".join(lines) + "\n")
    robust = fitted(folder)
    description = yaml.safe_load((folder / "calibration.yaml").read_text())
    (folder / "calibration.yaml").write_text(yaml.safe_dump({**description, "loss": "linear"}))
    plain = fitted(folder)
    truth = np.array(list(TRUE.values()))
    assert (np.abs(robust.values - truth) < 0.3 * np.abs(plain.values - truth)).all()


def test_the_command_writes_a_robot_that_validates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out, data = bench(tmp_path), tmp_path / "found" / "arm_found.yaml", tmp_path / "my tables"
    out.parent.mkdir()
    assert main(["calibrate", str(folder), "--json", "--out", str(out)]) == 0
    shown, said = capsys.readouterr()
    told = json.loads(shown)
    assert said.rstrip().endswith(shlex.join(["--robot", str(out)]))
    assert [each["found"] for each in told["parameters"]] == [True, True]
    robot = load_scene(out)
    assert robot.joints[0].rest == pytest.approx(-told["parameters"][0]["value"])
    assert robot.scene.bodies[0].material.young_modulus == pytest.approx(2.6e6, rel=0.05)
    assert main(["validate", str(folder), "--robot", str(out), "--max-mean", "0.5"]) == 0
    assert main(["validate", str(folder), "--max-mean", "0.5"]) == 1
    data.mkdir()
    (folder / "first.csv").rename(data / "first.csv")
    assert main(["calibrate", str(folder), "--every", "4", "--data", str(data), "--out", str(out)]) == 0
    judge = shlex.split(capsys.readouterr().err.partition("judge it: softsim ")[2])
    assert main([*judge, "--max-mean", "0.5"]) == 0


def test_an_interrupt_keeps_the_best(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replayed, calls = problem.replay, []

    def interrupted(*arguments: Any, **named: Any) -> Any:
        calls.append(1)
        if len(calls) > 9:
            raise KeyboardInterrupt
        return replayed(*arguments, **named)

    monkeypatch.setattr(problem, "replay", interrupted)
    monkeypatch.setattr(problem, "LONG", np.inf)  # on a slow machine other processes would count the calls
    result = fitted(bench(tmp_path))
    assert result.stopped
    assert result.after["first"] < result.before["first"]
    assert np.isinf(result.errors).all()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"parameters": [ZERO]}, "the overlay names 'young'"),
        ({"parameters": [ZERO, YOUNG, {**YOUNG, "name": "more"}]}, "more stands nowhere in the overlay"),
        ({"parameters": [ZERO, {**YOUNG, "start": 9.0}]}, "between 0.5 and 6"),
        ({"parameters": [ZERO, {**YOUNG, "lower": 7.0}]}, "less than upper"),
        ({"loss": "cubic"}, "loss"),
        ({"sessions": ["second"]}, "no session 'second'"),
        ({"every": 0}, "every"),
    ],
)
def test_what_cannot_be_fitted_is_a_sentence(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises((ConfigError, DataError), match=sentence):
        fitted(bench(tmp_path, **changes))


def test_rows_in_another_unit_are_refused(tmp_path: Path) -> None:
    folder = bench(tmp_path)
    text = (folder / "dataset.yaml").read_text().replace("unit: mm", "unit: m").replace("_mm", "")
    (folder / "dataset.yaml").write_text(text)
    (folder / "first.csv").write_text((folder / "first.csv").read_text().replace("_mm", ""))
    with pytest.raises(DataError):
        fitted(folder)


def test_a_description_needs_words_for_names() -> None:
    with pytest.raises(SceneError, match="a word of letters"):
        ParameterDescription(name="two words", start=0.0, lower=-1.0, upper=1.0)
    with pytest.raises(SceneError, match="one parameter or more"):
        CalibrationDescription(name="none", data_set=".", parameters=(), overlay={})
