"""The tables of features and of attacks name tests, folders and files that exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
TEXT = "\n".join((REPOSITORY / "docs" / name).read_text() for name in ("features.md", "security.md"))


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
