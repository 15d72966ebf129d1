"""Expressions of parameters are sums and products of numbers and names, and nothing else."""

from __future__ import annotations

import pytest

from softsim_core import SceneError
from softsim_core.lab.identification import evaluate_expression, names_in, replace_expressions


def test_expressions() -> None:
    assert evaluate_expression("= -(a + 2) * 3 / b ** 2", {"a": 1.0, "b": 3.0}) == pytest.approx(-1.0)
    assert replace_expressions({"x": ["= a", 1, "text", None]}, {"a": 2.5}) == {"x": [2.5, 1, "text", None]}
    assert names_in({"x": ["= a * b", "c"], "y": {"z": "= d"}}) == {"a", "b", "d"}


@pytest.mark.parametrize(
    "expression",
    [
        "= __import__('os')",
        "= a.real",
        "= a[0]",
        "= (lambda: 1)()",
        "= 'a' * 9",
        "= a if a else 1",
        "= 9 ** 9 ** 9",
        "= 1 / (a - 1)",
        "= (-a) ** 0.5",
        "= b",
        "= ",
        "= True and a",
        "=" + "(" * 500,
    ],
)
def test_expressions_do_nothing_else(expression: str) -> None:
    with pytest.raises(SceneError):
        evaluate_expression(expression, {"a": 1.0})
