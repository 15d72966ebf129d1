"""What is wrong with measured data is one sentence with file, column and line, not a fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_tripod import DESCRIPTION, measured, tripod_poses, write_bench

from softsim_core import load_scene
from softsim_core.base import ConfigError, DataError, SoftSimError
from softsim_core.lab.identification import (
    Prediction,
    Session,
    TimeColumn,
    compare_session,
    load_data_set,
    load_session,
    validate_session,
    validation,
)


def session(folder: Path) -> Session:
    data = load_data_set(folder)
    return load_session(data, data.description.sessions[0])


def prediction() -> Prediction:
    poses = tripod_poses()
    known = np.ones(len(poses.joints), bool)
    return Prediction(poses.positions[:, None], poses.rotations[:, None], known)


def broken(row: int, cell: object) -> list[object]:
    """A column of numbers, but for one row."""
    values: list[object] = list(range(24))
    values[row] = cell
    return values


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        ({"x_mm": broken(3, "nan")}, r"poses.csv: column x_mm, line 6: holds 'nan', no finite number"),
        ({"x_mm": broken(5, "")}, r"poses.csv: column x_mm, line 8: holds '', no finite number"),
        ({"y_mm": np.ones(24)}, None),
        ({c: np.ones(24) for c in ("x_mm", "y_mm", "z_mm")}, "sensor tracker: reads the same in every row"),
        ({"bad": np.ones(24, int)}, "no row is left that is not suspect"),
    ],
)
def test_a_wrong_cell_is_named(tmp_path: Path, edit: dict[str, object], sentence: str | None) -> None:
    folder = write_bench(tmp_path, edit=edit)
    if sentence is None:
        session(folder)
        return
    with pytest.raises(DataError, match=sentence):
        session(folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("x_mm, y_mm", "X, y_mm", r"poses.csv: column X: is not there; .*there are x_mm, y_mm, z_mm, s0_deg"),
        ("unit: mm", "unit: m", "column x_mm: is declared in m, but its name says mm; correct one"),
        (
            "unit: mm",
            "unit: inch",
            r"dataset.yaml: line 10, column 60: sessions\[0\].sensors\[0\].unit: must be one of m, cm, mm",
        ),
        ("unit: deg", "unit: rad", "column s0_deg: is declared in rad, but its name says deg"),
        (
            "poses.csv",
            "other.csv",
            r"session poses: no file .*other.csv; name the folder of the data \(--data",
        ),
        ("poses.csv", "dataset.yaml", "is no table that is known here; known are .csv"),
        ("[z, x, y]", "[x, z, y]", r"frame.axes: must be right-handed; this mirrors the data, not"),
        ("[z, x, y]", "[z, z, y]", r"frame.axes: must be x, y and z, each once"),
        ("y_mm, z_mm", "y_mm, y_mm", r"sensors\[0\].columns: must be three different columns"),
        ("[s0_deg", "[x_mm", "column x_mm is sensor tracker and a command; it can be one thing"),
        ("suspect", "suspects", r"unknown key; did you mean suspect\? "),
    ],
)
def test_a_wrong_description_is_named(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    with pytest.raises(SoftSimError, match=sentence):
        session(write_bench(tmp_path, text=DESCRIPTION.replace(old, new)))


def test_angles_in_another_unit_are_far_beyond_the_limits(tmp_path: Path) -> None:
    text = DESCRIPTION.replace("_deg", "").replace("unit: deg", "unit: rad")
    edit = {f"s{k}": np.degrees(tripod_poses().joints[:, k]) for k in range(3)}
    found = session(write_bench(tmp_path, edit=edit, text=text))
    with pytest.raises(DataError, match=r"column s0, line \d+: commands servo_0 -\d+.* is its unit right\?"):
        found.commands(load_scene("tripod"))


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (
            "[s0_deg, s1_deg]",
            "2 columns for the 3 joints of tripod .servo_0, servo_1, servo_2.; name the joints",
        ),
        ("[s0_deg], joints: [servo_9]", "tripod has no joint 'servo_9'; it has servo_0"),
    ],
)
def test_joints_that_do_not_fit_are_named(tmp_path: Path, columns: str, sentence: str) -> None:
    found = session(write_bench(tmp_path, text=DESCRIPTION.replace("[s0_deg, s1_deg, s2_deg]", columns)))
    with pytest.raises(DataError, match=sentence):
        found.commands(load_scene("tripod"))


def test_joints_by_name_leave_the_others_at_rest(tmp_path: Path) -> None:
    text = DESCRIPTION.replace("[s0_deg, s1_deg, s2_deg]", "[s1_deg], joints: [servo_2]")
    robot = load_scene("tripod")
    told = session(write_bench(tmp_path, text=text)).commands(robot)
    assert np.allclose(told[:, 2], tripod_poses().joints[:, 1])
    assert (told[:, :2] == [joint.rest for joint in robot.joints[:2]]).all()


def test_swapped_columns_are_seen_by_their_mirror_image(tmp_path: Path) -> None:
    found = session(write_bench(tmp_path, text=DESCRIPTION.replace("x_mm, y_mm", "y_mm, x_mm")))
    with pytest.raises(
        DataError,
        match=r"session poses: a mirrored frame fits better.* are swapped",
    ):
        compare_session(found, prediction())


def test_columns_that_are_moved_around_are_warned_of(tmp_path: Path) -> None:
    found = session(write_bench(tmp_path, text=DESCRIPTION.replace("x_mm, y_mm, z_mm", "y_mm, z_mm, x_mm")))
    (warning,) = compare_session(found, prediction()).warnings
    assert "the fitted frame is turned by" in warning


def test_lengths_in_another_unit_are_seen_by_their_size(tmp_path: Path) -> None:
    text = DESCRIPTION.replace("_mm", "").replace("unit: mm", "unit: m")
    edit = dict(zip("xyz", 1e3 * measured(tripod_poses(), 0.0).T, strict=True))
    found = session(write_bench(tmp_path, edit=edit, text=text))
    with pytest.raises(
        DataError, match=r"sensor tracker: moves .* mm where the model moves .*are the units right"
    ):
        compare_session(found, prediction())


def ring(delay: float) -> tuple[np.ndarray, np.ndarray]:
    """Times in [s], and a place in [m] that rings `delay` s later."""
    times = np.arange(-0.2, 2.0, 0.01)
    since = np.maximum(times - delay, 0.0)
    return times, 0.01 * (1.0 - np.exp(-since) * np.cos(20.0 * since))


def in_time(folder: Path, delay: float, edit: dict[str, object] | None = None) -> Session:
    times, place = ring(delay)
    table = {"t_s": times, "x_m": place, "y_m": 0.5 * place, "z_m": 0.0 * place + 0.3, **(edit or {})}
    rows = [",".join(table), *(",".join(map(str, row)) for row in zip(*table.values(), strict=True))]
    (folder / "ring.csv").write_text("\n".join(rows))
    (folder / "dataset.yaml").write_text(
        "name: ring\nrobot: tripod\nsessions:\n"
        "  - {name: ring, file: ring.csv, time: {column: t_s, most_delay: 0.05}, "
        "sensors: [{name: a, columns: [x_m, y_m, z_m], displacement: true}]}"
    )
    return session(folder)


def ringing() -> Prediction:
    times, place = ring(0.0)
    positions = np.stack([place, 0.5 * place, 0.0 * place], axis=1)[:, None]
    return Prediction(positions, np.tile(np.eye(3), (len(times), 1, 1, 1)), np.ones(len(times), bool), times)


def test_a_delay_is_found(tmp_path: Path) -> None:
    result = compare_session(in_time(tmp_path, 0.013), ringing())
    assert result.alignment is not None
    assert result.alignment.delay == pytest.approx(0.013, abs=1e-3)
    assert result.of(result.evaluated).rms < 0.1 * result.of(result.evaluated, raw=True).rms


def test_no_row_is_judged_by_a_delay_that_it_has_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is measured in a fifth of the time changes the errors there by as much, and by no other delay."""
    monkeypatch.setattr(validation, "replay", lambda *_: ringing())
    session, robot = in_time(tmp_path, 0.013), load_scene("tripod")
    span = np.array_split(np.flatnonzero(session.fitting), 5)[2]
    changed = session.measured.copy()
    changed[span] += 0.02 * np.random.default_rng(0).standard_normal(changed[span].shape)
    before = validate_session(session, robot)
    after = validate_session(replace(session, measured=changed), robot)
    assert before.alignment is not None
    assert before.alignment.delay == pytest.approx(0.013, abs=1e-3)
    assert after.aligned[span] - before.aligned[span] == pytest.approx((session.measured - changed)[span])


def test_repeats_of_one_load_case_are_rows(tmp_path: Path) -> None:
    poses, random = tripod_poses(), np.random.default_rng(1)
    text = DESCRIPTION.replace("    alignment: {frame: true, point: true}\n", "")
    same = np.tile(np.degrees(poses.joints[0]), (24, 1))
    commands = {f"s{k}_deg": same[:, k] for k in range(3)}
    places = 1e3 * np.tile(poses.positions[0][[1, 2, 0]], (24, 1)) + 0.4 * random.standard_normal((24, 3))
    held = Prediction(
        np.tile(poses.positions[0], (24, 1, 1)), np.tile(poses.rotations[0], (24, 1, 1, 1)), np.ones(24, bool)
    )
    for read in (places, np.tile(places[0], (24, 1))):  # with noise, and as rounded to the same digits
        columns = dict(zip(("x_mm", "y_mm", "z_mm"), read.T, strict=True))
        write_bench(tmp_path, edit={**commands, **columns}, text=text)
        assert compare_session(session(tmp_path), held).of(np.ones(24, bool)).mean < 2e-3


def test_a_shifted_time_axis_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(
        DataError, match=r"column t_s: the measurement comes 50 ms or more .* is its time shifted\?"
    ):
        compare_session(in_time(tmp_path, 0.11), ringing())


def test_time_that_goes_back_is_named(tmp_path: Path) -> None:
    times = ring(0.0)[0]
    times[30] = times[28]
    with pytest.raises(
        DataError, match=r"column t_s, line 32: goes from 0.09 s to 0.08 s; time must increase"
    ):
        in_time(tmp_path, 0.0, {"t_s": times})


def test_displacements_need_a_zero(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="sensor a needs rows up to time 0 as its zero"):
        in_time(tmp_path, 0.0, {"t_s": ring(0.0)[0] + 1.0})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a,b,a\n1,2,3\n", "line 1: names the column 'a' twice"),
        ("a,b\n1,2\n1\n", "line 3: has 1 cells for 2 columns"),
        ("1,2\n3,4\n", "line 1: holds numbers where the names of the columns must stand"),
        ("a;b\n1,5;2,5\n", "line 1: has semicolons between its cells; save it with commas"),
        ("a\tb\n1.5\t2.5\n", "line 1: has tabs between its cells"),
        ("# nothing\na,b\n", "holds no rows below a header line"),
    ],
)
def test_a_table_that_is_none_is_named(tmp_path: Path, text: str, sentence: str) -> None:
    folder = write_bench(tmp_path)
    (folder / "poses.csv").write_text(text)
    with pytest.raises(DataError, match=sentence):
        session(folder)


def test_an_unknown_data_set_lists_the_known() -> None:
    with pytest.raises(ConfigError, match=r"silicone_baem: no such folder, .*did you mean silicone_beam"):
        load_data_set("silicone_baem")


def test_a_folder_without_a_description_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"holds no dataset.yaml"):
        load_data_set(tmp_path)


def test_a_window_of_time_must_be_one() -> None:
    with pytest.raises(SoftSimError, match="last must be > first"):
        replace(TimeColumn(column="t"), first=2.0, last=1.0)
