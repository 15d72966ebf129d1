"""Tests wait for conditions: no test sleeps, and one helper polls."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]

POLLING = {"waiting.py", "node_processes.py"}
"""Helpers that may wait for a time: between two looks, and for news that nothing reports."""


def delays(source: str) -> Iterator[int]:
    """Yield the lines in which a program waits for a time: `time.sleep(...)` or `Event().wait(seconds)`."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        waits = called.endswith("Event().wait") and bool(node.args or node.keywords)
        if waits or called in ("time.sleep", "sleep"):
            yield node.lineno


def test_delays_are_found() -> None:
    source = "time.sleep(1)\nthreading.Event().wait(0.1)\nEvent().wait()\ndone.wait(60.0)\n"
    assert list(delays(source)) == [1, 2]


def test_no_test_waits_for_a_time() -> None:
    found = [
        f"{path.relative_to(TESTS)}:{line}"
        for path in sorted(TESTS.rglob("*.py"))
        if path.name not in POLLING and re.search(r"\bsleep\(|Event\(\)\.wait\(", path.read_text())
        for line in delays(path.read_text())
    ]
    assert not found, f"{', '.join(found)}: wait for a condition instead, with waiting.spin_until"
