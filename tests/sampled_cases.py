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
    """Return cases as parameters: a few that hold each value of each column; the others are exhaustive."""
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
    """Leave to the exhaustive run what a sample stands for; a folder's `conftest.py` imports this hook.

    Numba and SciPy compute the same steps; `tests/unit/test_steppers_agree.py` compares them. A test that
    runs on both, for several cases, keeps every case on Numba and at least one on SciPy. The SciPy cases of a
    module meet each element, law, actuator and scene of its cases, in its first tests where they can. A slow
    test keeps one seed for each case.
    """
    on_scipy: dict[str, dict[str, list[pytest.Function]]] = defaultdict(lambda: defaultdict(list))
    seeded: dict[tuple[str, ...], list[pytest.Function]] = defaultdict(list)
    for item in items:
        if isinstance(item, pytest.Function) and not item.get_closest_marker("exhaustive"):
            given = item.callspec.params if hasattr(item, "callspec") else {}
            if given.get("backend") == "scipy":
                on_scipy[item.nodeid.partition("::")[0]][item.originalname].append(item)
            if "seed" in given and item.get_closest_marker("slow"):
                others = (repr(value) for key, value in given.items() if key != "seed")
                seeded[(item.nodeid.partition("[")[0], *others)].append(item)
    for tests in on_scipy.values():
        met: set[tuple[str, str]] = set()
        for name, cases in tests.items():
            for k, case in enumerate(_shuffled(cases, name)):
                features = {(key, _feature(key, value)) for key, value in case.callspec.params.items()}
                if k and features <= met:
                    case.add_marker(pytest.mark.exhaustive)
                met |= features
    for names, cases in seeded.items():
        for case in _shuffled(cases, "-".join(names))[1:]:
            case.add_marker(pytest.mark.exhaustive)


def _shuffled(cases: Sequence[pytest.Function], name: str) -> list[pytest.Function]:
    order = sorted(cases, key=lambda case: case.nodeid)
    random.Random(name).shuffle(order)
    return order


def _feature(key: str, value: object) -> str:
    return "any" if key in DRAWN or isinstance(value, float) else repr(value)
