"""Motion capture as tables of a data set: labels, units, points that were not seen."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from softsim_core.base import DataError
from softsim_core.lab.identification import load_data_set, load_session, read_table

DATA_SET = """
name: lab
robot: tripod
sessions:
  - name: walk
    file: walk.c3d
    time: {column: time_s}
    sensors: [{name: tip, columns: ["tip:x_mm", "tip:y_mm", "tip:z_mm"], unit: mm, at: effector}]
"""


def write_c3d(file: Path, unit: str = "mm") -> np.ndarray:
    """Six frames of two points at 50 Hz, and a channel with two samples a frame; the tip is lost in one."""
    c3d = pytest.importorskip("c3d")
    random = np.random.default_rng(4)
    places = random.uniform(-50.0, 50.0, (6, 2, 3)).astype(np.float32)
    writer = c3d.Writer(point_rate=50.0, analog_rate=100.0, point_units=unit)
    frames = []
    for k, points in enumerate(places):
        whole = np.zeros((2, 5), np.float32)
        whole[:, :3] = points
        whole[1, 3] = -1.0 if k == 2 else 0.0
        frames.append((whole, np.array([[0.1 * k, 9.0]])))
    writer.add_frames(frames)
    writer.set_point_labels(["base", "tip"])
    writer.set_analog_labels(["servo"])
    writer.set_analog_general_scale(1.0)
    writer.set_analog_scales([1.0])
    writer.set_analog_offsets([0])
    with file.open("wb") as stream:
        writer.write(stream)
    return places


def test_points_and_channels_are_columns(tmp_path: Path) -> None:
    places = write_c3d(tmp_path / "walk.c3d")
    table = read_table(tmp_path / "walk.c3d", ["tip:y_mm", "servo", "time_s"])
    seen = [0, 1, 3, 4, 5]
    assert table.lines == [1, 2, 4, 5, 6]
    assert table.numbers("tip:y_mm", "mm") == pytest.approx(1e-3 * places[seen, 1, 1])
    assert table.numbers("servo") == pytest.approx(0.1 * np.array(seen))
    assert table.numbers("time_s", "s") == pytest.approx(0.02 * np.array(seen))
    assert len(read_table(tmp_path / "walk.c3d", ["base:x_mm"])) == 6  # that point was never lost


def test_a_session_of_motion_capture_is_loaded(tmp_path: Path) -> None:
    places = write_c3d(tmp_path / "walk.c3d")
    (tmp_path / "dataset.yaml").write_text(DATA_SET)
    data = load_data_set(tmp_path)
    session = load_session(data, data.description.sessions[0])
    assert session.measured[:, 0] == pytest.approx(1e-3 * places[[0, 1, 3, 4, 5], 1])


def test_a_unit_that_is_not_the_files_is_a_sentence(tmp_path: Path) -> None:
    write_c3d(tmp_path / "walk.c3d", "m")
    (tmp_path / "dataset.yaml").write_text(DATA_SET)
    data = load_data_set(tmp_path)
    with pytest.raises(DataError, match=r"column tip:x_mm: is not there; did you mean tip:x_m\?"):
        load_session(data, data.description.sessions[0])
    (tmp_path / "dataset.yaml").write_text(DATA_SET.replace("_mm", "_m"))
    with pytest.raises(DataError, match="declared in mm, but its name says m"):
        load_session(load_data_set(tmp_path), load_data_set(tmp_path).description.sessions[0])


@pytest.mark.parametrize("kept", [0, 100, 700, 1100])
def test_a_torn_file_is_a_sentence(kept: int, tmp_path: Path) -> None:
    file = tmp_path / "walk.c3d"
    write_c3d(file)
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(DataError, match=r"walk.c3d: (cannot be read as C3D|holds no frames)"):
        read_table(file, ["tip:x_mm"])


def test_without_the_package_a_sentence_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "c3d", None)
    with pytest.raises(DataError, match="C3D files need the package c3d"):
        read_table(tmp_path / "walk.c3d", ["tip:x_mm"])
