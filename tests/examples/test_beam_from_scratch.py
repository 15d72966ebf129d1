"""The example of a beam: it swings to its equilibrium, and two meshes give the deflection of beam theory."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

FILE = Path(__file__).resolve().parents[2] / "examples" / "beam_from_scratch.py"


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    return runpy.run_path(str(FILE))


def test_the_converged_deflection_is_that_of_beam_theory(example: dict[str, Any]) -> None:
    coarse, fine = (example["settled_deflection"](cells) for cells in (2, 4))
    theory = example["theory"]()
    assert 0.3 * theory < coarse < fine < 0.8 * theory  # linear tetrahedra lock in bending
    assert example["converged_deflection"](coarse, fine) == pytest.approx(theory, rel=2e-3)


def test_it_swings_down_to_its_equilibrium(example: dict[str, Any]) -> None:
    simulation = example["beam"](2)
    at_rest = example["settled_deflection"](2)
    while simulation.time < 2.0:
        simulation.step()
    assert example["deflection"](simulation) == pytest.approx(at_rest, rel=1e-4)


def test_it_takes_one_import_and_fits_on_a_page() -> None:
    lines = FILE.read_text().splitlines()
    assert [line for line in lines if "import" in line] == ["from softsim_core import ("]
    assert len(lines) <= 80
