"""The recorded closed loop: our law gives both command columns to the last bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core.control.inverse import ClosedLoopLog, TiltController, read_closed_loop_log, read_path

pytestmark = pytest.mark.reference


def test_commands_are_reproduced_exactly(reference_dir: Path) -> None:
    record = read_closed_loop_log(reference_dir / "data" / "tripod" / "closedLoop.csv")
    assert len(record.time) == 572
    controller = TiltController()
    rows = zip(record.reference, record.measure, record.elapsed, strict=True)
    commands = np.array([controller.update(*row) for row in rows])
    assert np.abs(commands - record.command).max() == 0.0
    assert np.abs(commands).max() == 0.7


def test_our_log_has_the_recorded_format(reference_dir: Path, tmp_path: Path) -> None:
    recorded, ours = reference_dir / "data" / "tripod" / "closedLoop.csv", tmp_path / "log.csv"
    record = read_closed_loop_log(recorded)
    with ClosedLoopLog(ours) as log:
        for row in zip(record.time, record.reference, record.command, record.measure, strict=True):
            log.write(*row)
    integers_as_floats = recorded.read_bytes().replace(b",0\r\n", b",0.0\r\n").replace(b",0,", b",0.0,")
    assert ours.read_bytes() == integers_as_floats


def test_the_worked_out_maze_plan(reference_dir: Path) -> None:
    path = read_path(reference_dir / "data" / "tripod" / "mazeplanning.json", (0.0, 0.0, 0.03))
    assert path.duration == 13.0
    assert path.sample(20.0).position == pytest.approx([0.0, 0.0, 0.05])
