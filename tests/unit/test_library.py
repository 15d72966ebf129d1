"""The front door: `softsim_core` gives, lists and documents everything a user needs, and loads nothing."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import softsim_core

REPOSITORY = Path(__file__).resolve().parents[2]


def page_writer() -> ModuleType:
    spec = importlib.util.spec_from_file_location("library_page", REPOSITORY / "docs" / "library.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_name_is_there_listed_and_documented() -> None:
    assert sorted([*dir(softsim_core), "__version__"]) == sorted(softsim_core.__all__)
    for name in softsim_core.__all__:
        thing = getattr(softsim_core, name)
        assert name == "__version__" or inspect.getdoc(thing), name


def test_every_error_and_every_description_is_among_them() -> None:
    """A class called ...Error or ...Description anywhere in the core is a user's."""
    defined = {
        node.name
        for file in (REPOSITORY / "softsim_core").rglob("*.py")
        for node in ast.parse(file.read_text()).body
        if isinstance(node, ast.ClassDef) and re.search(r"^[A-Z]\w*(Error|Description)$", node.name)
    }
    assert defined <= set(softsim_core.__all__)


def test_the_page_is_the_one_that_its_writer_writes() -> None:
    writer = page_writer()
    grouped = [name for names in writer.GROUPS.values() for name in names.split()]
    assert sorted(grouped) == sorted(softsim_core.__all__)
    written = (REPOSITORY / "docs" / "library.md").read_text(encoding="utf-8")
    assert written == writer.page(), "run python docs/library.py"


def test_an_unknown_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="softsim_core attribute Nothing"):
        softsim_core.Nothing  # noqa: B018


@pytest.mark.parametrize(
    ("line", "absent"),
    [
        ("import softsim_core; dir(softsim_core)", {"numpy", "scipy", "numba", "yaml"}),
        (
            "from softsim_core import Box, SceneError, box_mesh",
            {"scipy", "numba", "yaml"},
        ),
    ],
)
def test_importing_is_light(line: str, absent: set[str]) -> None:
    code = f"{line}\nimport sys\nprint(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=True
    )
    assert absent.isdisjoint(loaded.stdout.split())


def test_the_version_is_that_of_the_packages() -> None:
    project = (REPOSITORY / "pyproject.toml").read_text()
    assert 'version = { attr = "softsim_core.__version__" }' in project
    versions: list[str] = []
    for file in (REPOSITORY / "ros2_ws" / "src").glob("*/package.xml"):
        versions += re.findall(r"<version>(.+)</version>", file.read_text())
    assert len(versions) > 1
    versions += re.findall(r"^version: (.+)$", (REPOSITORY / "CITATION.cff").read_text(), re.MULTILINE)
    assert set(versions) == {softsim_core.__version__}
