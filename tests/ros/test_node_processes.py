"""Node processes of the tests: their output, and one that does not end."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from node_processes import NodeProcess, ProcessGroup

STUCK = """
import signal, threading

def wait_for_nothing():
    threading.Event().wait()

signal.signal(signal.SIGINT, signal.SIG_IGN)
print("stuck", flush=True)
wait_for_nothing()
"""


@pytest.fixture(autouse=True)
def importable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules of the test's folder can be started by name, also with PYTHONSAFEPATH."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


def test_a_process_that_does_not_end_shows_where_it_is_stuck(tmp_path: Path) -> None:
    (tmp_path / "stuck.py").write_text(STUCK)
    process = NodeProcess("stuck", (), tmp_path / "log.txt")
    assert process.says("stuck")
    with pytest.raises(
        AssertionError, match=r"SIGINT(?s:.*)Fatal Python error: Aborted(?s:.*)wait_for_nothing"
    ):
        process.end(deadline_s=0.1)
    assert process.process.returncode == -signal.SIGABRT


def test_output_can_be_forgotten_and_that_of_others_is_shown(tmp_path: Path) -> None:
    (tmp_path / "speaks.py").write_text("print('first', flush=True); input(); print('second')")
    process = NodeProcess("speaks", (), tmp_path / "log.txt")
    assert process.says("EOFError")
    assert process.process.wait() == 1
    assert "first" in ProcessGroup(tmp_path, [process]).output
    process.forget_output()
    assert process.output == ""
