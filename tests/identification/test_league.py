"""The league: models of one robot on the same rows, beside a regression and errors that others published."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np
import pytest
from measured_tripod import DESCRIPTION, write_bench

from softsim_core.base import Array, IndexArray
from softsim_core.lab.identification import (
    Session,
    league_entries,
    load_data_set,
    load_session,
    regression_errors,
)
from softsim_core.scene.io import known_scenes
from softsim_ros.cli import main

MODELS = """
length: 0.1
models:
  - {robot: tripod}
  - {robot: softer.yaml, parameters: 1, note: by hand}
published:
  - {model: theirs, rms_mm: 2.0, note: all rows}
unknown: nothing
"""
SOFTER = f"""
extends: {known_scenes()["tripod"]}
name: softer
gravity: [0.0, 0.0, -30.0]
"""


def bench(folder: Path, split: bool = True, noise: float = 0.0) -> Path:
    """A data set of the Tripod with two models, of which the first made the data."""
    edit: dict[str, object] = {"test": (np.arange(24) % 4 == 0).astype(int)}
    text = DESCRIPTION.replace("    suspect: bad\n", "    suspect: bad\n    split: {column: test}\n" * split)
    write_bench(folder, text=text + MODELS, edit=edit, noise=noise)
    (folder / "softer.yaml").write_text(SOFTER)
    return folder


def session(folder: Path, commands: Array, positions: Array) -> Session:
    """Rows with one sensor from commands in [rad] (k, 3) and positions (k, 3) in [m]."""
    data = load_data_set(bench(folder))
    found = load_session(data, data.description.sessions[0])
    names = ("s0_deg", "s1_deg", "s2_deg")
    columns = dict(zip(names, np.degrees(commands).T, strict=True))
    table = replace(found.table, columns=columns, lines=list(range(len(commands))))
    return replace(found, table=table, measured=positions[:, None])


def features(commands: Array) -> Array:
    """All monomials up to degree 3 without the constant."""
    return np.stack(
        [
            commands[:, list(power)].prod(axis=1)
            for degree in (1, 2, 3)
            for power in combinations_with_replacement(range(3), degree)
        ],
        axis=1,
    )


def test_the_regression_repeats_a_cubic_polynomial(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    commands = rng.uniform(-1.0, 1.0, (80, 3))
    positions = 0.2 + features(commands) @ rng.normal(0.0, 0.1, (19, 3))
    rows = session(tmp_path, commands, positions)
    errors = regression_errors(rows, np.arange(60), np.arange(60, 80))
    assert errors.shape == (20, 1, 3)
    assert np.abs(errors).max() < 1e-4 * np.ptp(positions)


def test_the_penalty_is_the_best_one_of_stretches_that_are_left_out(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    commands = rng.uniform(-1.0, 1.0, (60, 3))
    commands[:2] = [[-1.0], [1.0]]  # so that scaling changes nothing
    positions = features(commands) @ rng.normal(0.0, 0.1, (19, 3)) + rng.normal(0.0, 0.05, (60, 3))
    rows = session(tmp_path, commands, positions)
    rows = replace(rows, training=np.arange(60) < 50, used=np.ones(60, bool))

    def predicted(fitted: IndexArray, others: IndexArray, penalty: float) -> Array:
        phi, known = features(commands)[fitted], positions[fitted]
        centred = phi - phi.mean(axis=0)
        right = centred.T @ (known - known.mean(axis=0))
        solved = np.linalg.solve(centred.T @ centred + penalty * np.eye(19), right)
        return np.asarray((features(commands)[others] - phi.mean(axis=0)) @ solved + known.mean(axis=0))

    everything = np.arange(50)
    phi = features(commands)[:50]
    penalties = np.geomspace(1e-8, 1e4, 49) * np.linalg.norm(phi - phi.mean(axis=0), 2) ** 2
    scores = np.zeros(49)
    for fold in np.array_split(everything, 5):
        fitted = np.setdiff1d(everything, fold)
        scores += [((predicted(fitted, fold, each) - positions[fold]) ** 2).sum() for each in penalties]
    last, best = np.arange(50, 60), penalties[np.argmin(scores)]
    assert 0 < np.argmin(scores) < 48
    expected = predicted(everything, last, best) - positions[last]
    np.testing.assert_allclose(regression_errors(rows, everything, last)[:, 0], expected, atol=1e-9)


@pytest.mark.slow
def test_each_model_has_an_entry(tmp_path: Path) -> None:
    entries = {each.model: each for each in league_entries(load_data_set(bench(tmp_path)))}
    assert list(entries) == ["tripod", "softer.yaml", "theirs", "cubic regression"]
    true, softer, theirs, regression = entries.values()
    assert (true.training.count, true.held_out.count, true.numbers) == (18, 6, 9)
    assert true.held_out.max < 1e-6
    assert true.milliseconds is not None
    assert softer.numbers == 10
    assert softer.note == "by hand"
    assert softer.held_out.rms > 1e-5
    assert softer.percent == pytest.approx(1e3 * softer.held_out.rms)
    assert theirs.plain()["training"]["rms_mm"] == 2.0
    assert theirs.plain()["training"]["mean_mm"] is None
    assert theirs.percent == pytest.approx(2.0)
    assert regression.numbers == 57
    assert regression.held_out.count == 6


@pytest.mark.slow
def test_without_held_out_rows_a_regression_is_tested_on_folds(tmp_path: Path) -> None:
    entries = league_entries(load_data_set(bench(tmp_path, split=False)), every=2)
    assert [each.held_out.count for each in entries] == [0, 0, 0, 12]
    assert entries[-1].note == "held out: 5 folds"
    assert entries[-1].held_out.rms > entries[-1].training.rms


@pytest.mark.slow
def test_the_command_prints_the_table_and_names_what_is_absent(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there, absent, broken = bench(tmp_path / "there"), bench(tmp_path / "absent"), bench(tmp_path / "broken")
    (absent / "poses.csv").unlink()
    table = (broken / "poses.csv").read_text()
    (broken / "poses.csv").write_text(table.replace(table.splitlines()[2].split(",")[0], "none", 1))
    assert main(["league", str(there), str(absent), str(broken), "--every", "2", "--json"]) == 1
    shown, said = capsys.readouterr()
    assert [each["model"] for each in json.loads(shown)["entries"]][:2] == ["tripod", "softer.yaml"]
    assert f"bench is left out: session poses: no file {absent}" in said
    assert "bench failed: " in said
    assert "none" in said
    assert main(["league", str(there), "--markdown"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("| data set | model | numbers | rows |")
    assert lines[2].startswith("| bench | tripod | 9 | 18 | 0.00 |")
    assert "- bench, unknown: nothing" in lines
    assert main(["league", str(absent)]) == 1
    assert "no data set is present" in capsys.readouterr().err
    assert main(["league", str(there), "--every", "0"]) == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("length: 0.1", "length: 0.0"), "length"),
        (("parameters: 1", "parameters: -1"), "parameters"),
        (("rms_mm: 2.0", "rms_mm: .nan"), "rms_mm"),
        (("rms_mm: 2.0, ", ""), "give mean_mm, rms_mm or both"),
    ],
)
def test_a_wrong_description_is_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    folder = bench(tmp_path)
    file = folder / "dataset.yaml"
    file.write_text(file.read_text().replace(*change))
    with pytest.raises(Exception, match=message):
        load_data_set(folder)
