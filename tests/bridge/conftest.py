"""Fixtures of the bridge's tests: a virtual board, a bridge on it in this process or in one of its own."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bridge_session import BRIDGE, BridgeClient, BridgeHere, bridge_words, client, start, stream
from node_processes import NodeProcess, spin_until

from servo_bridge.emulator import VirtualBoard

__all__ = ["client", "start", "stream"]


@pytest.fixture
def wait_until() -> Callable[..., bool]:
    """Looks at a condition until it holds; False when the deadline passed first."""
    return spin_until


@pytest.fixture(autouse=True)
def no_calibration_of_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "configuration"))


@pytest.fixture
def board(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[VirtualBoard]:
    """A board that says nothing; as an indirect parameter the name of another protocol."""
    with VirtualBoard(link=tmp_path / "board", protocol=getattr(request, "param", "auto")) as virtual:
        yield virtual


class ErrorLog:
    """A file for standard error; reading it loses nothing, whoever is writing.

    `capfd.readouterr` empties its file after reading, and loses a line that is written in between.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._before = os.dup(2)
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def follow(self) -> None:
        """Send standard error here, until pytest redirects it for the next phase of the test."""
        os.dup2(self._descriptor, 2)

    def close(self) -> None:
        """Send standard error where it went before, and show there what came meanwhile."""
        os.dup2(self._before, 2)
        os.close(self._before)
        os.close(self._descriptor)
        sys.stderr.write(self.path.read_text(errors="replace"))


@pytest.fixture
def start_bridge(
    client: BridgeClient, board: VirtualBoard, tmp_path: Path
) -> Iterator[Callable[..., BridgeHere]]:
    """Starts the bridge in this process, on the virtual board.

    Keywords are parameters (quiet time 0, source commands).
    """
    log = ErrorLog(tmp_path / "standard_error")
    bridges: list[BridgeHere] = []

    def starter(**parameters: Any) -> BridgeHere:
        values = {"port": board.port, "open_wait_s": 0.0} | parameters
        log.follow()
        bridges.append(BridgeHere(client, log.path, values))
        return bridges[-1]

    yield starter
    log.follow()
    for bridge in bridges:
        bridge.end()
    log.close()
    assert "Traceback" not in log.path.read_text(errors="replace")


@pytest.fixture
def start_bridge_process(
    start: Callable[..., NodeProcess], board: VirtualBoard
) -> Callable[..., NodeProcess]:
    """As `start_bridge`, in a process of its own."""

    def starter(**parameters: object) -> NodeProcess:
        values = {"port": board.port, "open_wait_s": 0.0} | parameters
        return start(BRIDGE, *bridge_words(**values))

    return starter
