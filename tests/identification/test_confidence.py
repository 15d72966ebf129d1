"""What judges a calibration: folds, profiles, other starts, poses to measure next, what is left open."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from softsim_core import ConfigError, DataError, SceneError, load_scene
from softsim_core.base import Array
from softsim_core.lab.identification import (
    QUANTILE,
    Calibration,
    DistributionDescription,
    cross_validated,
    distribution_of,
    load_distribution,
    next_poses,
    profiled,
    replace_expressions,
)
from softsim_core.simulation import Simulation
from softsim_ros.cli import main
from softsim_ros.cli.measurements import RequestedResults, describe_endings, page
from tests.identification.test_calibration import (
    DATA_SET,
    OVERLAY,
    TRUE,
    YOUNG,
    ZERO,
    bench,
    fitted,
    found,
    load_scene_text,
)

pytestmark = pytest.mark.slow


def test_rows_left_out_err_a_little_more() -> None:
    folds = cross_validated(found(), 3)
    ratios = {name: folds.left_out[name] / error for name, error in folds.fitted.items()}
    assert 1.0 < ratios["first"] < 1.6  # 2 numbers for 39 readings
    assert folds.ratio == pytest.approx(ratios["first"])
    assert folds.fitted["first"] == pytest.approx(found().after["first"], rel=0.1)


def test_too_many_folds_are_a_sentence() -> None:
    with pytest.raises(DataError, match="13 rows are too few for 5000 folds"):
        cross_validated(found(), 5000)


def test_a_profile_of_a_nearly_linear_problem_is_as_told_by_slopes() -> None:
    result = found()
    for k in range(2):
        low, high = profiled(result, k)
        half = QUANTILE * result.errors[k]
        assert (low, high) == pytest.approx(
            (result.values[k] - half, result.values[k] + half), abs=0.15 * half
        )


def test_a_profile_says_what_slopes_do_not(tmp_path: Path) -> None:
    """Of a compliance near zero rows tell how large it may be, and not that it is there."""
    compliance = {"name": "compliance", "start": 0.02, "lower": 0.001, "upper": 5.0}
    rod = {"start_clamp": {"rotation": ["= 1 / compliance", ".inf", ".inf"]}}
    rod["start_clamp"]["rotation"][1:] = [np.inf, np.inf]  # type: ignore[assignment]
    overlay = {"bodies": [{"name": "rod", "rod": rod, "material": {"young_modulus": 2.6e6}}]}
    overlay["joints"] = [{"name": "servo", "rest": -TRUE["zero"]}]
    result = fitted(bench(tmp_path, noise=1e-3, parameters=[compliance], overlay=overlay))
    low, high = profiled(result, 0)
    assert low == -np.inf
    assert result.values[0] < high < 5.0


@pytest.mark.exhaustive
def test_searches_from_several_starts_are_told(tmp_path: Path) -> None:
    """One begins with an arm so soft that it hangs on the other side of its servo, and stays there."""
    folder = bench(tmp_path, starts=3, every=3)
    result = fitted(folder)
    means = [each.mean for each in result.endings]
    assert len(means) == 3
    assert means[0] == min(means)
    assert result.values == pytest.approx(result.endings[0].values)
    assert np.abs(result.values - list(TRUE.values())) == pytest.approx(0.0, abs=0.1)
    told = describe_endings(result)
    assert told.startswith(f"{3 - len(result.other_endings)} of 3 searches ended here")
    assert ("the best of the others" in told) == bool(result.other_endings)


def test_the_pose_that_tells_most_is_found() -> None:
    """Beside brute force: the information of the rows and of each candidate by differences of simulations."""
    result = found()
    poses = next_poses(result, 8, candidates=8)
    assert poses.joints == ("servo",)
    assert (np.diff(poses.errors, axis=0) < 0.0).all()
    assert poses.errors[0] == pytest.approx(result.errors, rel=0.05)
    measured = rows_tell(result, np.linspace(-1.1, 1.1, 13)).sum(axis=0)
    candidates = rows_tell(result, poses.commands[:, 0])
    worth = np.linalg.slogdet(measured + candidates)[1]
    assert int(np.argmax(worth)) == 0
    assert np.argmax(np.linalg.slogdet(measured + candidates[0] + candidates[1:])[1]) == 0


def rows_tell(result: Calibration, commands: Array) -> Array:
    """Information of rows at commands (n,), in steps of the parameters, shape (n, 2, 2)."""
    steps, places = (1e-3, 0.02), []
    for k in range(-1, 2):
        zero, young = result.values + np.eye(3)[k, :2] * steps
        simulation = Simulation(
            load_scene_text(replace_expressions(OVERLAY, {"zero": zero, "young": young})), "scipy"
        )
        tips = []
        for each in commands.tolist():
            simulation.settle([each])
            tips.append(simulation.frames()["tip"].position)
        places.append(np.array(tips))
    slopes = np.stack([places[1] - places[0], places[2] - places[0]], axis=-1)
    return np.asarray(np.einsum("nra,nrb->nab", slopes, slopes))


@pytest.mark.exhaustive
def test_sessions_have_numbers_of_their_own(tmp_path: Path) -> None:
    folder = bench(tmp_path, parameters=[{**ZERO, "per_session": True}, YOUNG])
    rows = np.loadtxt(folder / "first.csv", delimiter=",", skiprows=1)
    rows[:, 0] -= 0.05  # the servo's horn was put on again: commands that reach the same places are less
    np.savetxt(folder / "second.csv", rows, "%.9g", ",", header="theta_rad,x_mm,y_mm,z_mm", comments="")
    session = DATA_SET.split("sessions:\n")[1].replace("first", "second")
    (folder / "dataset.yaml").write_text(DATA_SET + session)
    result = fitted(folder)
    assert result.names == ("zero of first", "zero of second", "young")
    assert result.values[1] - result.values[0] == pytest.approx(0.05, abs=2e-3)
    assert result.values[2] == pytest.approx(TRUE["young"], abs=0.1)
    assert result.overlay["joints"][0]["rest"] == pytest.approx(-result.values[:2].mean())
    left_open = distribution_of(result, "arm.yaml")
    assert left_open.names == ("zero", "young")
    assert left_open.covariance[0][0] == pytest.approx(0.05**2 / 2 * (1 + 1 / 2), rel=0.1)  # a new session


def test_what_is_left_open_is_drawn(tmp_path: Path) -> None:
    folder, out = bench(tmp_path), tmp_path / "open.yaml"
    assert main(["calibrate", str(folder), "--distribution", str(out)]) == 0
    left_open = load_distribution(out)
    drawn = left_open.draw(4000, seed=3)
    assert np.array_equal(drawn, left_open.draw(4000, seed=3))
    assert drawn.mean(axis=0) == pytest.approx(left_open.mean, rel=0.01)
    assert np.cov(drawn.T) == pytest.approx(np.array(left_open.covariance), rel=0.15, abs=1e-6)
    robot = load_scene(tmp_path / left_open.robot, left_open.fill_overlay(drawn[0]))
    assert robot.joints[0].rest == pytest.approx(-drawn[0, 0])


def test_draws_keep_within_bounds() -> None:
    wide = distribution(covariance=((1.0, 0.0), (0.0, 1.0)))
    drawn = wide.draw(500)
    assert drawn.shape == (500, 2)
    assert (drawn >= wide.lower).all()
    assert (drawn <= wide.upper).all()


def distribution(**changes: Any) -> DistributionDescription:
    given: dict[str, Any] = {
        "name": "arm",
        "robot": "arm.yaml",
        "names": ("zero", "young"),
        "units": ("rad", "MPa"),
        "mean": (0.0, 2.0),
        "covariance": ((1e-4, 0.0), (0.0, 1e-2)),
        "lower": (-0.3, 0.5),
        "upper": (0.3, 6.0),
        "overlay": OVERLAY,
    }
    return DistributionDescription(**{**given, **changes})


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"mean": (0.0,)}, "mean"),
        ({"covariance": ((1.0, 2.0), (2.0, 1.0))}, "negative"),
        ({"covariance": ((1.0,), (2.0,))}, "covariance"),
        ({"lower": (0.5, 0.5)}, "lower"),
    ],
)
def test_a_distribution_that_is_none_is_a_sentence(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SceneError, match=sentence):
        distribution(**changes)


def test_a_distribution_out_of_reach_of_its_bounds_is_a_sentence() -> None:
    with pytest.raises(SceneError, match="bounds are reached"):
        distribution(mean=(5.0, 2.0)).draw(3)


def test_a_missing_distribution_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        load_distribution(tmp_path / "none.yaml")


def test_the_command_tells_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stiff = {"name": "rod", "material": {"young_modulus": 1e6 * TRUE["young"]}}
    out, overlay = tmp_path / "o.yaml", {"joints": OVERLAY["joints"], "bodies": [stiff]}
    folder = bench(tmp_path, parameters=[ZERO], overlay=overlay)
    file = tmp_path / "page.html"
    asked = ["--folds", "3", "--profile", "--suggest", "1", "--out", str(out), "--report", str(file)]
    assert main(["calibrate", str(folder), *asked]) == 0
    told = capsys.readouterr().out
    for words in ("left out in 3 folds", "95 % interval by profile", "measure next (servo)"):
        assert words in told
        assert words in out.read_text()
        assert words in file.read_text()
    assert not re.search(r"(src|href)=|https?://|@import", file.read_text())
    assert yaml.safe_load(out.read_text())["joints"][0]["rest"] == pytest.approx(-TRUE["zero"], abs=0.02)


def test_the_page_draws_intervals_and_correlations() -> None:
    text = page("<arm>", found(), RequestedResults())
    assert "&lt;arm&gt;" in text
    assert text.count('<svg class="bar"') == 2
    told = [float(each) for each in re.findall(r"%\)\">([+-]\d\.\d\d)", text)]
    assert told == pytest.approx(found().correlation.ravel(), abs=0.005)
    assert "NOT FOUND" not in text


@pytest.mark.parametrize("option", ["--out", "--report", "--distribution"])
@pytest.mark.parametrize("place", ["nowhere/file", "."])
def test_what_cannot_be_written_is_told_before_the_search(
    option: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", str(bench(tmp_path)), option, str(tmp_path / place)]) == 2
    assert "a file in a folder that is there" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--folds", "--suggest", "--every"])
def test_nonsense_is_refused(option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(bench(tmp_path)), option, "0"]) == 2
    assert "or more" in capsys.readouterr().err
