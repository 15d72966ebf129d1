"""`softsim mjcf import|compare|export`, as a user calls it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from softsim_core import Simulation, load_scene
from softsim_core.scene.io import config_file
from softsim_ros.cli import run_command as main

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
SERVO = config_file("mjcf/servo_beam.xml")


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_import_writes_a_scene_that_runs(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco")
    assert main(["mjcf", "import", str(SERVO)]) == 0
    said = capsys.readouterr().out
    assert "servo_beam/servo_beam.yaml: 1 soft bodies, 1 rigid, 1 joints" in said
    assert "joint: damping not taken over (servo)" in said
    text = Path("servo_beam/servo_beam.yaml").read_text()
    assert text.startswith("# servo_beam: made of servo_beam.xml (MuJoCo).")
    assert "#   joint: damping not taken over (servo)\n" in text
    assert "density" not in text  # what is as by default is left out
    simulation = Simulation(load_scene(Path("servo_beam/servo_beam.yaml")), backend="scipy")
    simulation.step()
    assert simulation.joint_names == ("servo",)
    assert main(["mjcf", "import", str(SERVO)]) == 1  # nothing is written over
    assert "is there already and not empty" in capsys.readouterr().err
    assert main(["mjcf", "import", str(SERVO), "--to", "other", "--law", "saint_venant_kirchhoff"]) == 0
    assert load_scene(Path("other/servo_beam.yaml")).scene.bodies[0].material.law == "saint_venant_kirchhoff"


@pytest.mark.slow
def test_wrong_words_are_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco")
    for words, said in (
        (["import", "none.xml"], "does not exist"),
        (["import", str(SERVO), "--law", "glue"], "glue"),
        (["import", str(SERVO), "--law", "yeoh"], "young_modulus"),
        (["compare", str(SERVO), "--seconds", "1e6"], "more than 100000 steps"),
        (["export", "cantilever_quadratic"], "has cells tet10, MuJoCo only tet4"),
        (["export", "tripod", "--to", "/proc/none/x.xml"], "cannot be written"),
    ):
        assert main(["mjcf", *words]) == 1
        error = capsys.readouterr().err
        assert said in error
        assert len(error.splitlines()) == 1
    assert main(["mjcf", "compare", str(SERVO), "--seconds", "nan"]) == 2
    assert not list(Path().iterdir())


def test_export_writes_a_model(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["mjcf", "export", "cable_finger", "--to", "models/finger.xml"]) == 0
    said = capsys.readouterr().out
    assert "models/finger.xml: MuJoCo model of cable_finger" in said
    assert "its points sit on the nearest nodes" in said
    assert Path("models/finger.xml").read_text().startswith('<mujoco model="cable_finger">')


@pytest.mark.slow
def test_compare_tells_sags_distances_and_times(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco", minversion="4.0")
    shutil.copy(SERVO, "beam.xml")
    words = ["mjcf", "compare", "beam.xml", "--seconds", "0.1", "--rounds", "1", "--law", "corotational"]
    assert main(words) == 0
    said = capsys.readouterr().out
    for word in (
        "176 nodes, 540 tetrahedra, dt 5 ms",
        "min ms",
        "mujoco ",
        "ours, corotational",
        "beam",
        "0.100 s",
    ):
        assert word in said, word
    assert "something still moves" in said
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["dt"] == 0.005
    theirs, ours = found["rows"]
    assert ours["sags"]["beam"] == pytest.approx(theirs["sags"]["beam"], rel=0.05)
    assert len(ours["moments"]) == 10
    assert 0.0 < theirs["min_ms"] <= theirs["median_ms"]
    assert not Path("MUJOCO_LOG.TXT").exists()
