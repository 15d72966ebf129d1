"""A fixed sample of cases for the daily run; `pytest -m exhaustive` runs the others.

A sample depends on names alone: it is the same in each run and in each worker.
"""

from __future__ import annotations

import random
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import pytest

DRAWN = ("seed",)
"""Parameters whose values stand for each other, as numbers with a fraction do: one of them is met."""


def sampled(name: str, cases: Sequence[tuple[Any, ...]]) -> list[Any]:
    """Return cases as parameters: some in which each value of each column occurs; the others are exhaustive."""
    order = list(cases)
    random.Random(name).shuffle(order)
    met: set[tuple[int, Any]] = set()
    daily: set[tuple[Any, ...]] = set()
    for case in order:
        if not met.issuperset(enumerate(case)):
            daily.add(case)
            met.update(enumerate(case))
    return [pytest.param(*case, marks=() if case in daily else pytest.mark.exhaustive) for case in cases]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the SciPy path on a sample of the cases; a folder's `conftest.py` imports this hook.

    Numba and SciPy compute the same steps; `tests/unit/test_steppers_agree.py` compares them. A test that runs
    on both, for several cases, keeps every case on Numba and at least one on SciPy. The SciPy cases of a module
    meet each element, law, actuator and scene of its cases.
    """
    modules: dict[str, list[pytest.Function]] = defaultdict(list)
    for item in items:
        if (
            isinstance(item, pytest.Function)
            and hasattr(item, "callspec")
            and item.callspec.params.get("backend") == "scipy"
            and not item.get_closest_marker("exhaustive")
        ):
            modules[item.nodeid.partition("::")[0]].append(item)
    for name, cases in modules.items():
        order = sorted(cases, key=lambda case: case.nodeid)
        random.Random(name).shuffle(order)
        met: set[tuple[str, str]] = set()
        for case in order:
            features = {(key, _feature(key, value)) for key, value in (case.callspec.params.items())} | {
                ("test", case.originalname)
            }
            if features <= met:
                case.add_marker(pytest.mark.exhaustive)
            met |= features


def _feature(key: str, value: object) -> str:
    return "any" if key in DRAWN or isinstance(value, float) else repr(value)
