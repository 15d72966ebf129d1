"""Tests that may run once more when they fail: each for a reason that is given here, and printed."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import pytest

RERUNS: Mapping[str, str] = {}
"""Why a test may run once more, by its id without parameters."""


class Reruns:
    """A plugin of pytest: runs tests once more where they fail for a reason below, and tells which, and why.

    Args:
        reasons: As RERUNS.
    """

    def __init__(self, reasons: Mapping[str, str]) -> None:
        self._reasons = reasons

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if find_spec("pytest_rerunfailures"):
            for item in items:
                if without_parameters(item.nodeid) in self._reasons:
                    item.add_marker(pytest.mark.flaky(reruns=1))

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        again = terminalreporter.stats.get("rerun", [])
        if again:
            terminalreporter.section("run once more")
        for report in again:
            name = without_parameters(report.nodeid)
            terminalreporter.write_line(f"{report.nodeid}: {self._reasons[name]}")


def without_parameters(nodeid: str) -> str:
    return nodeid.partition("[")[0]
