"""The table of features names every row that was asked for, and tests that exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
TEXT = (REPOSITORY / "docs" / "features.md").read_text()
LINES = [[cell.strip() for cell in line.split("|")] for line in TEXT.splitlines()]
ROWS = {cells[1]: cells for cells in LINES if len(cells) == 7}
STATES = {"yes", "better", "other", "partly", "no"}


@pytest.mark.parametrize("number", range(1, 106))
def test_every_row_says_how_far_it_is_and_what_shows_it(number: int) -> None:
    _, name, what, state, here, shown, _ = ROWS[f"F{number:02d}"]
    assert what, name
    assert state in STATES
    assert shown or state == "no"
    assert here or state == "yes"


def test_every_row_stands_once() -> None:
    names = re.findall(r"^\| (F\d+) \|", TEXT, re.MULTILINE)
    assert len(names) == len(set(names)) == 105


@pytest.mark.parametrize("named", sorted(set(re.findall(r"`(tests/[^`]+)`", TEXT)) - {"tests/reference"}))
def test_every_named_test_exists(named: str) -> None:
    path, _, function = named.partition("::")
    tree = ast.parse((REPOSITORY / path).read_text())
    assert not function or function in {
        node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)
    }


def test_every_named_folder_and_file_of_the_suite_exists() -> None:
    for named in re.findall(r"`((?:softsim_core|configs|docs|tests/reference)(?:/[\w./]+)?)`", TEXT):
        assert (REPOSITORY / named).exists(), named
