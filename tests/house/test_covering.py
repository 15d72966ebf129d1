"""`softsim test PATH`: every file of the project has tests, by the table that CONTRIBUTING.md shows."""

from __future__ import annotations

import argparse
import shutil
import subprocess
from pathlib import Path

import pytest

from softsim_ros.cli.upkeep import UncoveredPathError, coverage_table, covering_tests, files_of, suite

REPOSITORY = Path(__file__).resolve().parents[2]
TESTS = coverage_table(REPOSITORY)
TEXTS = {
    *("CHANGELOG.md", "CITATION.cff", "CODE_OF_CONDUCT.md", "LICENSE", "MANIFEST.in", "NOTICE"),
    *("SECURITY.md", ".dockerignore", ".gitignore", ".pre-commit-config.yaml"),
}
"""Files that no program of the project reads."""


def words(*given: str) -> list[str]:
    """What `softsim test` gives to pytest behind its own options."""
    parser = argparse.ArgumentParser(allow_abbrev=False)
    suite.configure(parser)
    arguments, arguments.rest = parser.parse_known_args(given)
    line = suite.command(arguments, REPOSITORY)
    return line[line.index("--dist=loadfile") + 1 :]


def test_every_row_of_contributing_is_read() -> None:
    table = (
        (REPOSITORY / "CONTRIBUTING.md")
        .read_text(encoding="utf-8")
        .split("| changed | tests |\n|---|---|\n")[1]
    )
    rows = table.split("\n\n")[0].splitlines()
    assert len(rows) == len(TESTS) > 60


@pytest.mark.parametrize("name", TESTS)
def test_what_the_table_names_is_there(name: str) -> None:
    assert (REPOSITORY / name).exists()
    for word in TESTS[name].split():
        files = files_of(word, REPOSITORY)
        assert files, word
        assert all((REPOSITORY / file).exists() for file in files), word


def test_every_test_is_of_some_path() -> None:
    reached = {file for name in TESTS for file in covering_tests(name, REPOSITORY)}
    files = [file.relative_to(REPOSITORY) for file in (REPOSITORY / "tests").rglob("test_*.py")]
    assert [str(file) for file in files if not {str(file), str(file.parent)} & reached] == []


def test_every_file_has_tests() -> None:
    if shutil.which("git") is None or not (REPOSITORY / ".git").exists():
        pytest.skip("no git checkout")
    listed = subprocess.run(["git", "ls-files"], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    for name in set(listed.stdout.splitlines()) - TEXTS:
        if not name.startswith("tests/"):
            assert covering_tests(name, REPOSITORY), name


def test_a_path_of_the_product_becomes_its_tests() -> None:
    assert words("softsim_core/simulation/batch/") == ["-m", "not exhaustive", "tests/batch"]
    assert words("-x", "softsim_core/lab/study/store.py", "-k", "docs") == [
        *("-m", "not exhaustive", "-x", "tests/study", "-k", "docs")
    ]
    assert "tests/unit/test_contact_solver.py" in words("softsim_core/physics/contact")
    assert words("tests/unit/test_pose.py::test_x")[-1] == "tests/unit/test_pose.py::test_x"


def test_without_a_path_the_markers_decide() -> None:
    assert words("-m", "packaging") == ["-m", "packaging"]
    assert words("--quick", "-k", "codec") == ["-m", suite.QUICK, "-k", "codec"]


def test_a_path_that_nothing_covers_is_one_sentence() -> None:
    with pytest.raises(UncoveredPathError, match=r"no test covers LICENSE; .* of softsim_core, ") as said:
        words("LICENSE")
    assert "\n" not in str(said.value)
