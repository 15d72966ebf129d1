"""A plugin that writes which functions of the product each test runs: `-p executed_functions`, by hand.

It writes one JSON a line to `executed_<worker>.jsonl` in the folder that EXECUTED_FUNCTIONS names, about the
product in the current folder. Functions in other processes and compiled kernels are not seen. Python 3.12 or
later.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import CodeType

import pytest

ROOT = f"{Path.cwd()}{os.sep}"
PACKAGES = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge")
PRODUCT = tuple(f"{ROOT}{name}{os.sep}" for name in PACKAGES)
FOLDER = Path(os.environ["EXECUTED_FUNCTIONS"])
TOOL = 4
"""An identifier that sys.monitoring leaves to tools without a name of their own."""

_monitoring = sys.monitoring
_seen: set[tuple[str, int]] = set()


def _note(code: CodeType, offset: int) -> object:
    if code.co_filename.startswith(PRODUCT):
        _seen.add((code.co_filename.removeprefix(ROOT), code.co_firstlineno))
    return _monitoring.DISABLE  # until the next phase begins


_monitoring.use_tool_id(TOOL, "executed_functions")
_monitoring.register_callback(TOOL, _monitoring.events.PY_START, _note)
_monitoring.set_events(TOOL, _monitoring.events.PY_START)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure() -> None:
    """Stop noting before the interpreter clears what notes need."""
    _monitoring.set_events(TOOL, _monitoring.events.NO_EVENTS)


def _phase(item: pytest.Item, when: str) -> Iterator[None]:
    _seen.clear()
    _monitoring.restart_events()
    began = time.monotonic()
    yield
    row = {"id": item.nodeid, "when": when, "seconds": time.monotonic() - began, "functions": sorted(_seen)}
    worker = os.environ.get("PYTEST_XDIST_WORKER", "main")
    with (FOLDER / f"executed_{worker}.jsonl").open("a") as file:
        file.write(json.dumps(row) + "\n")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Note what the fixtures of a test run; they serve the tests behind it, too."""
    yield from _phase(item, "setup")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Note what a test runs."""
    yield from _phase(item, "call")
