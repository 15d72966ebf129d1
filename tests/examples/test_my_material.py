"""The example of a material law: it runs, in both back ends, and motion ends in the equilibrium."""

from __future__ import annotations

import pytest
from example_files import EXAMPLES, example


def test_a_beam_of_the_law_sags_as_its_equilibrium(backend: str) -> None:
    moving, resting = example("my_material").sagging_beam(backend)
    assert moving == pytest.approx(resting, abs=1e-4)
    assert resting == pytest.approx(14.571, abs=1e-3)


def test_it_is_short() -> None:
    assert len((EXAMPLES / "my_material.py").read_text().splitlines()) <= 80
