"""A model beside measurements: what was hidden in them is found, held-out rows judge, limits decide."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from headless_browser import chromium_path
from measured_tripod import DESCRIPTION, POINT, SHIFT, TURN, tripod_poses, write_bench

from softsim_core import ConfigError, DataError, NotConvergedError, Simulation, load_scene
from softsim_core.base import Array
from softsim_core.lab.identification import (
    Prediction,
    SessionResult,
    by_region,
    compare_session,
    in_short_steps,
    load_data_set,
    load_session,
    measures,
    plain,
    read_alignments,
    replay,
    worst,
)
from softsim_ros.cli import main
from softsim_ros.cli.measurements import validation_page

pytestmark = pytest.mark.slow


def beside(folder: Path) -> SessionResult:
    """The session of a folder beside the poses that it was made from."""
    data = load_data_set(folder)
    poses = tripod_poses()
    known = np.ones(len(poses.joints), bool)
    prediction = Prediction(poses.positions[:, None], poses.rotations[:, None], known)
    return compare_session(load_session(data, data.description.sessions[0]), prediction)


def test_the_replay_is_that_of_the_model_in_any_order(tmp_path: Path) -> None:
    data = load_data_set(write_bench(tmp_path))
    session = load_session(data, data.description.sessions[0], every=3)
    told: list[tuple[int, int]] = []
    robot = load_scene("tripod")
    nearest = replay(robot, session, progress=lambda *each: told.append(each))
    as_measured = replay(robot, session, "rows")
    assert told == [(k, 8) for k in range(1, 9)]
    for found in (nearest, as_measured):
        assert np.abs(found.positions[:, 0] - tripod_poses().positions[::3]).max() < 1e-7
        assert np.abs(found.rotations[:, 0] - tripod_poses().rotations[::3]).max() < 1e-6


def test_hidden_frame_and_point_are_found(tmp_path: Path) -> None:
    result = beside(write_bench(tmp_path))
    assert result.alignment is not None
    assert np.abs(result.alignment.points - POINT).max() < 1e-6
    # the data's frame is the robot's, turned and shifted, and the fit leads back
    assert np.abs(result.alignment.rotation - TURN.T).max() < 1e-6
    assert np.abs(result.alignment.place(SHIFT)).max() < 1e-6
    assert result.of(result.evaluated).max < 1e-7
    assert result.of(result.evaluated, raw=True).mean > 0.05
    assert not result.warnings


def test_noise_is_left_and_the_point_is_as_sure_as_told(tmp_path: Path) -> None:
    result = beside(write_bench(tmp_path, noise=3e-4))
    assert result.alignment is not None
    away = np.abs(result.alignment.points - POINT)
    assert (away < 4.0 * result.alignment.point_errors).all()
    expected = np.sqrt(3.0) * 3e-4 * np.sqrt(1.0 - 9.0 / (3 * 24))
    assert result.of(result.evaluated).rms == pytest.approx(expected, rel=0.2)


def test_suspect_rows_neither_fit_nor_count(tmp_path: Path) -> None:
    poses = tripod_poses()
    bad = np.zeros(len(poses.joints), int)
    bad[[2, 5]] = 1
    folder = write_bench(tmp_path, edit={"bad": bad})
    lines = (folder / "poses.csv").read_text().splitlines()
    lines[4] = ",".join(["500.0", *lines[4].split(",")[1:]])
    (folder / "poses.csv").write_text("\n".join(lines))
    result = beside(folder)
    assert result.of(result.evaluated).count == len(bad) - 2
    assert result.of(result.evaluated).max < 1e-7
    assert result.of(~result.session.used).max > 0.1


def test_held_out_rows_judge_and_do_not_fit(tmp_path: Path) -> None:
    out = (np.arange(24) % 4 == 0).astype(int)
    folder = write_bench(tmp_path, edit={"out": out}, text=DESCRIPTION + "    split: {column: out}\n")
    lines = (folder / "poses.csv").read_text().splitlines()
    lines[2] = ",".join(
        [str(float(lines[2].split(",")[0]) + 5.0), *lines[2].split(",")[1:]]
    )  # a held-out row
    (folder / "poses.csv").write_text("\n".join(lines))
    result = beside(folder)
    assert result.of(result.session.fitting).max < 1e-7
    assert (result.of(result.evaluated).count, result.of(result.evaluated).max) == (
        6,
        pytest.approx(5e-3, rel=1e-4),
    )


def test_rows_of_further_files_are_sorted_and_held_out(tmp_path: Path) -> None:
    """Rows of one run in two files: all in order, those of the second file judge and do not fit."""
    out = np.arange(24) % 4 == 1
    split = "    further: [other.csv]\n    order: row\n    split: {files: [other.csv]}\n"
    folder = write_bench(tmp_path, edit={"row": np.arange(24)}, text=DESCRIPTION + split)
    text = (folder / "poses.csv").read_text()
    head, *lines = [line for line in text.splitlines() if not line.startswith("#")]
    moved = lines[1].split(",")
    lines[1] = ",".join([str(float(moved[0]) + 5.0), *moved[1:]])
    for name, rows in (("poses.csv", ~out), ("other.csv", out)):
        (folder / name).write_text("\n".join([head, *(lines[k] for k in np.flatnonzero(rows))]))
    result = beside(folder)
    assert np.array_equal(result.session.training, ~out)
    assert result.of(result.session.fitting).max < 1e-7
    assert result.of(result.evaluated).max == pytest.approx(5e-3, rel=1e-4)
    assert result.session.table.lines[:3] == ["2 of poses.csv", "2 of other.csv", "3 of poses.csv"]


def test_a_fault_in_a_further_file_names_that_file(tmp_path: Path) -> None:
    folder = write_bench(tmp_path, text=DESCRIPTION + "    further: [other.csv]\n")
    data = load_data_set(folder)
    lines = (folder / "poses.csv").read_text().splitlines()
    (folder / "other.csv").write_text("\n".join(line.rpartition(",")[0] for line in lines if line[0] != "#"))
    with pytest.raises(DataError, match=r"other\.csv: column \w+: is not there"):
        load_session(data, data.description.sessions[0])


def test_a_split_by_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    folder = write_bench(tmp_path, text=DESCRIPTION + "    split: {files: [other.csv]}\n")
    with pytest.raises(ConfigError, match=r"split names other\.csv, which is not among its files poses\.csv"):
        load_data_set(folder)


def test_rows_with_chosen_numbers_are_held_out(tmp_path: Path) -> None:
    split = "    split: {column: load, values: [2, 5.5]}\n"
    folder = write_bench(tmp_path, edit={"load": [0.0, 2.0, 3.0, 5.5] * 6}, text=DESCRIPTION + split)
    assert beside(folder).session.training.tolist() == [True, False, True, False] * 6
    write_bench(tmp_path, text=DESCRIPTION + "    split: {held_out_share: 0.25, values: [2]}\n")
    with pytest.raises(ConfigError, match="values need the column that has them"):
        load_data_set(folder)


def test_rows_beyond_a_range_are_not_read(tmp_path: Path) -> None:
    text = DESCRIPTION + "    within: {load: [2, 3]}\n"
    folder = write_bench(tmp_path, edit={"load": [0.0, 2.0, 3.0, 5.5] * 6}, text=text)
    data = load_data_set(folder)
    session = load_session(data, data.description.sessions[0])
    assert session.table.numbers("load").tolist() == [2.0, 3.0] * 6
    write_bench(tmp_path, edit={"load": [0.0] * 24}, text=text)
    with pytest.raises(DataError, match="column load: no row is within 2 to 3"):
        load_session(data, data.description.sessions[0])
    write_bench(tmp_path, text=DESCRIPTION + "    within: {load: [3, 2]}\n")
    with pytest.raises(ConfigError, match="smallest and largest number"):
        load_data_set(folder)


def test_a_share_is_held_out_the_same_every_time(tmp_path: Path) -> None:
    folder = write_bench(tmp_path, text=DESCRIPTION + "    split: {held_out_share: 0.25, seed: 4}\n")
    first, again = beside(folder).session.training, beside(folder).session.training
    assert (~first).sum() == 6
    assert np.array_equal(first, again)


def test_rows_without_equilibrium_have_no_error(tmp_path: Path) -> None:
    data = load_data_set(write_bench(tmp_path))
    poses = tripod_poses()
    known = np.arange(24) != 7
    positions = np.where(known[:, None], poses.positions, np.nan)[:, None]
    prediction = Prediction(positions, poses.rotations[:, None], known)
    result = compare_session(load_session(data, data.description.sessions[0]), prediction)
    assert result.of(result.evaluated).count == 23
    assert result.of(result.evaluated).max < 1e-7
    assert result.warnings == ("1 of 24 rows have no equilibrium of the model, and have no error",)


def test_measures_of_known_errors() -> None:
    errors = np.outer(np.arange(1.0, 5.0), [0.6, 0.0, 0.8])
    found = measures(errors)
    assert (found.count, found.mean, found.max) == (4, 2.5, 4.0)
    assert found.rms == pytest.approx(np.sqrt(7.5))
    assert np.isnan(measures(np.zeros((0, 3))).mean)
    regions = by_region(errors, np.outer(np.arange(4.0), [1.0, 0.0, -1.0]))
    assert [found.count for _, _, found in regions.values()] == [1, 1, 2, 1, 1, 2]
    assert regions["x high"][2].mean == pytest.approx(3.5)
    assert regions["z high"][2].mean == pytest.approx(1.5)


def test_short_steps_visit_all_and_the_nearest_first() -> None:
    points = np.array([[0.9], [0.1], [0.5], [0.11]])
    assert in_short_steps(points, np.zeros(1)).tolist() == [1, 3, 2, 0]


def test_the_command_judges_by_its_limits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(write_bench(tmp_path, noise=3e-4))
    assert main(["validate", folder, "--every", "4", "--max-mean", "1.0"]) == 0
    assert "bench: A Tripod on a bench." in capsys.readouterr().out
    assert main(["validate", folder, "--every", "4", "--max-mean", "0.1", "--json"]) == 1
    shown, said = capsys.readouterr()
    told = json.loads(shown)
    assert "beyond its limit: session poses: mean 0." in said
    assert told["passed"] is False
    assert told["sessions"]["poses"]["aligned"]["count"] == 6
    assert told["sessions"]["poses"]["raw"]["mean_mm"] > 50.0
    rows = told["sessions"]["poses"]["each_row"]
    assert [row["line"] for row in rows] == [3, 7, 11, 15, 19, 23]
    assert set(rows[0]["commands"]) == {"s0_deg", "s1_deg", "s2_deg"}
    assert all(row["used_for"] == "training" for row in rows)
    errors = 1e3 * np.linalg.norm([row["error_m"]["tracker"] for row in rows], axis=1)
    assert errors.mean() == pytest.approx(told["sessions"]["poses"]["aligned"]["mean_mm"])
    assert set(told["sessions"]["poses"]["regions"]) == {
        f"{a} {p}" for a in "xyz" for p in ("low", "middle", "high")
    }


def test_an_earlier_alignment_is_taken_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = beside(write_bench(tmp_path / "one"))
    report = tmp_path / "report.json"
    report.write_text(json.dumps(plain("bench", "tripod", [result])))
    (given,) = read_alignments(report).values()
    assert result.alignment is not None
    assert np.allclose(given.points, result.alignment.points)
    other = write_bench(tmp_path / "two", noise=1e-3)
    words = ["validate", str(other), "--every", "8", "--json", "--alignment"]
    assert main([*words, str(report)]) == 0
    told = json.loads(capsys.readouterr().out)["sessions"]["poses"]
    assert np.allclose(told["alignment"]["points_m"], POINT[None], atol=1e-6)
    assert told["aligned"]["count"] == 3  # too few to fit anything
    report.write_text("{}")
    assert main([*words, str(report)]) == 1
    assert "is no report of `softsim validate --json`" in capsys.readouterr().err


def test_an_interrupt_keeps_what_is_done(tmp_path: Path) -> None:
    data = load_data_set(write_bench(tmp_path))
    session = load_session(data, data.description.sessions[0])

    def stop(done: int, total: int) -> None:
        if done == 15:
            raise KeyboardInterrupt

    found = replay(load_scene("tripod"), session, progress=stop)
    assert found.stopped
    assert found.reached.sum() == 15
    result = compare_session(session, found)
    assert result.stopped
    assert result.warnings[0] == "9 of 24 rows were not replayed, and have no error"
    assert result.of(result.evaluated).count == 15


@pytest.mark.parametrize("fails", [1, 2, 99])
def test_a_row_is_tried_from_the_start_pose_and_by_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: int
) -> None:
    """Where it is not found at all, the rows after it are found as before."""
    data = load_data_set(write_bench(tmp_path))
    session = load_session(data, data.description.sessions[0], every=6)
    lost, tries, settle = tripod_poses().joints[6], [], Simulation.settle
    robot = load_scene("tripod")

    def settled(simulation: Simulation, joints: Array, shift: float, **named: Any) -> object:
        if np.allclose(joints, lost) and len(tries) < fails:
            tries.append(simulation.joint_positions)
            raise NotConvergedError("it is said so", 1.0, 1, 1.0)
        return settle(simulation, joints, shift, **named)

    monkeypatch.setattr(Simulation, "settle", settled)
    found = replay(robot, session, "rows")
    assert found.reached.tolist() == [True, fails < 3, True, True]
    assert np.allclose(tries[0], tripod_poses().joints[0])  # from the row before
    if fails > 1:
        assert np.allclose(tries[1], robot.start_joints)
    if fails > 2:  # the last of eight parts
        assert np.allclose(tries[2], robot.start_joints + 0.875 * (lost - robot.start_joints))
    rows = found.reached.nonzero()[0]
    assert np.abs(found.positions[rows, 0] - tripod_poses().positions[6 * rows]).max() < 1e-7


def test_the_page_shows_errors_and_loads_nothing(tmp_path: Path) -> None:
    folder = write_bench(tmp_path / "set", noise=3e-4, text=DESCRIPTION.replace("on a bench", "on <b> & co"))
    text = validation_page(load_data_set(folder).description, "tripod", [beside(folder)])
    assert "A Tripod on &lt;b&gt; &amp; co." in text
    assert not re.search(r"(src|href)=|https?://(?!www.w3.org/2000/svg)|@import", text)
    (told,) = json.loads(re.search(r'type="application/json">(.*?)</script>', text, re.DOTALL)[1])["sessions"]
    lengths = np.linalg.norm(told["errors"], axis=1)
    assert (len(lengths), sum(told["counts"])) == (24, 24)
    assert told["worst"] == np.argsort(-lengths)[:8].tolist()
    assert told["commands"][0] == f"s0_deg = {np.degrees(tripod_poses().joints[0, 0])}, " + ", ".join(
        f"s{k}_deg = {np.degrees(tripod_poses().joints[0, k])}" for k in (1, 2)
    )


def test_the_worst_is_shown_when_its_line_is_clicked(tmp_path: Path) -> None:
    folder = write_bench(tmp_path / "set", noise=3e-4)
    result = beside(folder)
    page = validation_page(load_data_set(folder).description, "tripod", [result])
    (tmp_path / "page.html").write_text(page)
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium_path(), args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 1400, "height": 850})
        wrong: list[str] = []
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        tab.goto((tmp_path / "page.html").as_uri())
        tab.click("#worst tr:first-child")
        said = tab.inner_text("#chosen")
        browser.close()
    assert wrong == []
    ((row, _, error),) = worst(result, 1)
    assert said.startswith(
        f"line {result.session.table.lines[row]}, tracker: {1e3 * np.linalg.norm(error):.2f} mm"
    )


def test_swapped_commands_of_a_symmetric_robot_mirror_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = DESCRIPTION.replace("s0_deg, s1_deg", "s1_deg, s0_deg")
    assert main(["validate", str(write_bench(tmp_path, text=text)), "--every", "2"]) == 1
    assert "two columns of the sensor or of the commands are swapped" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("calls", "sessions", "fit"),
    [(1, 0, "{}"), (4, 1, "{}"), (5, 1, "{}"), (6, 2, "{}"), (3, 0, "{frame: true}")],
)
def test_an_interrupt_ends_the_command_with_what_is_done(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    calls: int,
    sessions: int,
    fit: str,
) -> None:
    """Each session settles at the start pose and at its two rows."""
    first = DESCRIPTION.replace("{frame: true, point: true}", fit)
    second = first[first.index("  - name: poses") :].replace("name: poses", "name: again")
    folder = write_bench(tmp_path, text=first + second)
    settle, done = Simulation.settle, []

    def settled(simulation: Simulation, joints: Array, shift: float, **named: Any) -> object:
        done.append(joints)
        if len(done) == calls:
            raise KeyboardInterrupt
        return settle(simulation, joints, shift, **named)

    monkeypatch.setattr(Simulation, "settle", settled)
    assert main(["validate", str(folder), "--every", "12", "--json"]) == 130
    assert len(done) == calls
    shown, said = capsys.readouterr()
    assert "interrupted; what is done follows" in said
    assert len(json.loads(shown)["sessions"]) == sessions


def test_a_model_that_reaches_nothing_is_said(tmp_path: Path) -> None:
    data = load_data_set(write_bench(tmp_path))
    session = load_session(data, data.description.sessions[0])
    lost = np.full((24, 1, 3), np.nan)
    prediction = Prediction(lost, np.full((24, 1, 3, 3), np.nan), np.zeros(24, bool))
    with pytest.raises(DataError, match="session poses: the model reaches no row for training"):
        compare_session(session, prediction)
