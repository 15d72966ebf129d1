"""The command that a message advises installs into the Python that said it."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest

from softsim_core.base import machine


def test_in_the_environment_of_a_checkout_it_names_that_python_and_its_pins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "prefix", "/somewhere/venv")
    words = shlex.split(machine.install_command("study"))
    root = Path(machine.__file__).resolve().parents[2]
    assert words[:2] == [str(Path(sys.executable).with_name("pip")), "install"]
    assert words[2:] == ["-c", str(root / "constraints.txt"), "-e", f"{root}[study]"]
    assert Path(words[3]).is_file()


def test_elsewhere_it_is_that_of_the_distribution(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", sys.base_prefix)
    assert machine.install_command("study") == "pip install 'softsim[study]'"
