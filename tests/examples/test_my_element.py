"""The example of an element: it runs, in both back ends, and moves as tet4 does."""

from __future__ import annotations

from example_files import EXAMPLES, example


def test_four_quadrature_points_move_as_one(backend: str) -> None:
    assert example("my_element").difference(backend) < 1e-9


def test_it_is_short() -> None:
    assert len((EXAMPLES / "my_element.py").read_text().splitlines()) <= 80
