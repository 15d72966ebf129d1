"""`softsim material`: the list, one elastomer, its picture, what it refuses."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from softsim_core.base import install_command
from softsim_ros.cli import main


def test_without_a_name_it_lists_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["material"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 19 + 2
    row = next(line for line in lines if line.startswith("Dragon Skin 10 MEDIUM"))
    assert row.split()[4:] == ["142", "kPa", "2", "/", "4", "11.4", "1070", "kg/m^3"]
    assert "ODbL" in lines[-2]


def test_one_tells_stiffness_waves_and_step_and_draws_in_the_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["material", "Dragon", "Skin", "10", "MEDIUM", "--factor", "1.86"]) == 0
    shown, warned = capsys.readouterr()
    assert "E 264.4 kPa, Poisson ratio 0.499," in shown
    assert "15.7 m/s along a bar" in shown
    assert "bends with T = 118 ms and stretches" in shown
    assert "stretch 1.02 to 2, tension only; the bar tore at 11.38" in shown
    assert "T = 25.4 ms: up to dt = 1.88 ms and 0.405 ms it adds less than 0.05" in shown
    chart = shown[shown.index("nominal stress") :].splitlines()
    assert sum(line.count("o") for line in chart[1:]) >= 8
    assert warned == ""


def test_the_stiffness_of_the_table_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["material", "Ecoflex 00-30"]) == 0
    shown, warned = capsys.readouterr()
    assert "assumed, the table has none: weigh a casting" in shown
    assert "stiffness of Ecoflex 00-30 is too low" in warned


def test_as_json_with_the_other_law(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--json", "--law", "ogden", "--poisson-ratio", "0.45", "--factor", "2", "--density", "1000"]
    assert main(["material", "rtv615", *words]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["material"]["law"] == "ogden"
    assert told["poisson_ratio"] == pytest.approx(0.45)
    assert told["young_modulus_pa"] == pytest.approx(2.9 * (196.1e3 + 556.4e3), rel=1e-3)
    assert told["stretches"][-1] == 2.92
    assert told["points"][0] == [1.05, 104e3]


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        (["Dragon Skin 10"], 1, "did you mean Dragon Skin 10 MEDIUM"),
        (["RTV615", "--factor", "-1"], 1, "stiffness_factor must be > 0"),
        (["RTV615", "--poisson-ratio", "0.5"], 1, "poisson_ratio must be between -1 and 0.5"),
        (["RTV615", "--size", "0"], 2, "--size must be a number > 0, not 0"),
        (["RTV615", "--density", "nan"], 2, "--density must be a number > 0, not nan"),
    ],
)
def test_what_cannot_be_is_one_sentence(
    words: list[str], code: int, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["material", *words]) == code
    said = capsys.readouterr().err
    assert said.startswith("softsim material: ")
    assert sentence in said


@pytest.mark.slow
def test_a_picture_is_written_or_its_lack_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "curve.png"
    if importlib.util.find_spec("matplotlib") is not None:
        assert main(["material", "RTV615", "--out", str(file)]) == 0
        assert file.stat().st_size > 10_000
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["material", "RTV615", "--out", str(file)]) == 1
    assert f"--out needs matplotlib; {install_command('report')}" in capsys.readouterr().err
