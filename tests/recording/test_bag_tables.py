"""Recordings as tables of a data set: rows of one topic, the newest word of the others, and sentences."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bag_rows import COMMANDS, command, write

from softsim_core.base import DataError
from softsim_core.lab.identification import READERS, read_table
from softsim_ros.cli import main
from softsim_ros.recording import read_bag, register

OTHER = "/tripod/markers"
FIRST, STEP = 1_000_000_000, 10_000_000


def bag(folder: Path) -> Path:
    """Markers each 10 ms; commands from 15 ms on, each 30 ms."""
    messages = [(OTHER, FIRST + STEP * k, command([k, 2.0 * k, -1.0])) for k in range(12)]
    messages += [(COMMANDS, FIRST + 15_000_000 + 3 * STEP * k, command([10.0 + k])) for k in range(3)]
    write(folder, sorted(messages, key=lambda each: each[1])).close()
    return folder


def test_rows_are_those_of_the_first_topic_with_the_newest_of_the_others(tmp_path: Path) -> None:
    columns = ["markers:data.0", "markers:data.1", "position_controller/commands:data.0", "recorded_s"]
    table = read_bag(bag(tmp_path / "bag"), columns)
    assert table.lines == list(range(3, 13))  # the first two came before any command
    assert np.array_equal(table.numbers("markers:data.1"), 2.0 * np.arange(2, 12))
    assert table.numbers("recorded_s") == pytest.approx(0.01 * np.arange(2, 12))
    commands = table.numbers("position_controller/commands:data.0")
    assert commands.tolist() == [10, 10, 10, 11, 11, 11, 12, 12, 12, 12]


def test_a_folder_and_its_file_are_tables_once_registered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for ending in READERS:
        monkeypatch.setitem(READERS, ending, READERS[ending])  # they are put back
    register()
    folder = bag(tmp_path / "bag")
    (file,) = folder.glob("*.mcap")
    for path in (folder, file):  # the file alone does not tell the namespace
        assert len(read_table(path, [f"{OTHER}:data.0"])) == 12


@pytest.mark.parametrize(
    ("column", "sentence"),
    [
        ("x", "column x: must be TOPIC:FIELD, or recorded_s"),
        (
            "pose:data.0",
            r"topic /tripod/pose: is not there; did you mean /tripod/markers\? there are /tripod/m",
        ),
        (
            "markers:data.7",
            r"column /tripod/markers:data.7: is not there; there are .*data.0, data.1, data.2",
        ),
    ],
)
def test_what_is_not_there_is_said(tmp_path: Path, column: str, sentence: str) -> None:
    with pytest.raises(DataError, match=sentence):
        read_bag(bag(tmp_path / "bag"), [column])


@pytest.mark.ros
@pytest.mark.numba
def test_a_recorded_simulation_is_a_data_set(
    robot_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recorded pose of a step carries the stamp of its begin: the sensor seems a step early."""
    columns = ", ".join(f"'effector_pose:pose.position.{axis}'" for axis in "xyz")
    commands = ", ".join(f"'position_controller/commands:data.{k}'" for k in range(3))
    (tmp_path / "dataset.yaml").write_text(
        "name: own\nrobot: tripod\nsessions:\n"
        f"  - {{name: own, file: {robot_bag}, commands: {{columns: [{commands}]}}, "
        f"time: {{column: recorded_s, start: rest, most_delay: 0.03}}, "
        f"sensors: [{{name: pose, columns: [{columns}]}}]}}"
    )
    assert main(["validate", str(tmp_path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["sessions"]["own"]
    assert told["rows"] == 40
    assert told["alignment"]["delay_s"] == pytest.approx(-0.01, abs=1e-5)
    assert told["aligned"]["max_mm"] < 1e-2 < told["raw"]["max_mm"]
