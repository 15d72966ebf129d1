"""Packages that may be there or not: found, absent, of another release, broken."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from softsim_ros import OPTIONAL, optional_module, optional_type

NAME = "control_msgs"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of a package that imports whatever a test writes into it."""
    folder = tmp_path / NAME
    folder.mkdir()
    (folder / "__init__.py").touch()
    for name in [each for each in sys.modules if each.partition(".")[0] == NAME]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [each for each in sys.modules if each.partition(".")[0] == NAME]:
        del sys.modules[name]


def test_what_is_not_installed_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in OPTIONAL:
        monkeypatch.setitem(sys.modules, name, None)
        assert optional_module(name) is None
        assert optional_type(f"{name}.msg", "Anything") is None


def test_a_release_may_lack_a_type_or_a_kind_of_types(package: Path) -> None:
    (package / "msg.py").write_text("class One: pass\n")
    assert optional_type(f"{NAME}.msg", "One").__name__ == "One"
    assert optional_type(f"{NAME}.msg", "Two") is None
    assert optional_type(f"{NAME}.action", "One") is None


def test_a_broken_package_is_no_absent_one(package: Path) -> None:
    (package / "msg.py").write_text("import a_module_that_is_not_there\n")
    with pytest.raises(ModuleNotFoundError, match="a_module_that_is_not_there"):
        optional_type(f"{NAME}.msg", "One")


def test_only_known_packages_are_asked_for() -> None:
    with pytest.raises(ValueError, match="numpy is none of tf2_msgs, control_msgs"):
        optional_module("numpy")
