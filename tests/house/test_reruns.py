"""Only tests named with a reason run once more, and it is told."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from reruns import RERUNS, without_parameters

REPOSITORY = Path(__file__).resolve().parents[2]
FAILS_ONCE = """
import pathlib, pytest

@pytest.mark.parametrize("case", [1, 2])
def test_named(case):
    seen = pathlib.Path(f"named_{case}")
    first = not seen.exists()
    seen.touch()
    assert not (first and case == 1)

def test_other():
    seen = pathlib.Path("other")
    first = not seen.exists()
    seen.touch()
    assert not first
"""
REGISTERS = """
from reruns import Reruns

def pytest_configure(config):
    config.pluginmanager.register(Reruns({"test_some.py::test_named": "the moon was full"}))
"""


@pytest.mark.slow
def test_a_named_test_runs_once_more_with_its_reason_and_no_other_does(tmp_path: Path) -> None:
    pytest.importorskip("pytest_rerunfailures")
    (tmp_path / "test_some.py").write_text(FAILS_ONCE)
    (tmp_path / "conftest.py").write_text(REGISTERS)
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-c", os.devnull, "--rootdir", ".", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY / "tests")},
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    assert "test_some.py::test_named[1]: the moon was full" in run.stdout, run.stdout + run.stderr
    assert "1 failed, 2 passed, 1 rerun" in run.stdout
    assert "FAILED test_some.py::test_other" in run.stdout


@pytest.mark.parametrize("name", RERUNS)
def test_each_named_test_exists_and_has_a_reason(name: str) -> None:
    file, _, function = name.partition("::")
    defined = ast.walk(ast.parse((REPOSITORY / file).read_text()))
    assert function in {each.name for each in defined if isinstance(each, ast.FunctionDef)}
    assert without_parameters(name) == name
    assert len(RERUNS[name]) > 20
