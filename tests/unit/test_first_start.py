"""`softsim bench --install`: which phases it sees, and how it judges them; the start itself runs in CI."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from benchmarks import (
    KERNELS,
    MOTION,
    FirstStart,
    compare_with_targets,
)

SCRIPT = """#!/bin/sh
echo "[1/4] Making a Python 3.12.1 environment in /x/venv: done in 3 s"
echo "[2/4] Fetching the installer (uv): done in 1 s"
echo "starting tripod: Ctrl-C ends it in the safe pose"
echo "[INFO] [1.0] [tripod.simulator]: simulating tripod: 246 nodes"
echo "$SOFTSIM_HOME|$NUMBA_CACHE_DIR|$UV_CACHE_DIR"
{end}
"""
RUNS = """trap 'exit 0' TERM
echo "[INFO] [2.0] [tripod.simulator]: kernels compiled: from step 7 on the simulation runs on them"
while :; do sleep 0.05; done"""


def start_of(tmp_path: Path, end: str) -> tuple[FirstStart, list[str]]:
    checkout = tmp_path / "checkout"
    checkout.mkdir()
    file = checkout / "softsim"
    file.write_text(SCRIPT.format(end=end))
    file.chmod(file.stat().st_mode | stat.S_IXUSR)
    (checkout / ".softsim").mkdir()
    said: list[str] = []
    return FirstStart(checkout, "tripod", said.append), said


def test_each_phase_is_told_with_its_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/somewhere")
    monkeypatch.setenv("SOFTSIM_HOME", "/elsewhere")
    first, said = start_of(tmp_path, RUNS)
    assert first.run(60.0) == 0
    assert list(first.phases) == [
        "Making a Python 3.12.1 environment",
        "Fetching the installer",
        "the program has started",
        "the simulator runs",
        KERNELS,
    ]
    assert [line.split(" s  ")[1] for line in said] == list(first.phases)
    home, cache, uv = first.output[4].split("|")
    assert (home, cache) == ("", "")  # of the copy's own, which are empty
    assert not Path(uv).exists()  # gone with the copy
    assert (os.environ["SOFTSIM_HOME"], os.environ["NUMBA_CACHE_DIR"]) == ("/elsewhere", "/somewhere")


def test_a_start_that_fails_is_not_waited_for(tmp_path: Path) -> None:
    first, _ = start_of(tmp_path, "exit 3")
    assert first.run(60.0) == 3


@pytest.mark.slow
def test_what_takes_too_long_is_ended(tmp_path: Path) -> None:
    first, _ = start_of(tmp_path, "trap 'exit 0' TERM; while :; do sleep 0.05; done")
    assert first.run(1.0) is None


def test_targets_are_judged() -> None:
    told, missed = compare_with_targets({MOTION: 30.0, KERNELS: 100.0}, [])
    assert (len(told), missed) == (2, 1)
    assert told[0].endswith("after 30.0 s, target 45 s: as wanted")
    assert "after 100.0 s, target 90 s: missed" in told[1]
    assert compare_with_targets({}, [])[1] == 2
    told, missed = compare_with_targets({MOTION: 30.0, KERNELS: 80.0}, [0.7, 1.0, 0.99])
    assert missed == 1
    assert "0.70 in the slowest second, median 0.99, target 0.9: missed" in told[2]
    assert compare_with_targets({MOTION: 30.0, KERNELS: 80.0}, [0.9, 1.0])[1] == 0
