"""Escape sequences go to terminals that understand them."""

from __future__ import annotations

import os
import pty

import pytest

from softsim_node import takes_escapes


@pytest.mark.parametrize(("kind", "expected"), [("xterm-256color", True), ("vt100", True), ("dumb", False)])
def test_a_dumb_terminal_gets_none(kind: str, expected: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", kind)
    master, slave = pty.openpty()
    try:
        assert takes_escapes(slave) is expected
        with os.fdopen(slave, "w", closefd=False) as stream:
            assert takes_escapes(stream) is expected
    finally:
        os.close(master)
        os.close(slave)


def test_a_pipe_gets_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    reading, writing = os.pipe()
    try:
        assert takes_escapes(writing) is False
    finally:
        os.close(reading)
        os.close(writing)
