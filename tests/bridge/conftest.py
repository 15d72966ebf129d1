"""Fixtures of the bridge's tests: a virtual board, a bridge process on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from bridge_session import BRIDGE, bridge_words, client, start, stream
from node_processes import NodeProcess, spin_until

from servo_bridge.virtual_board import VirtualBoard

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


@pytest.fixture
def start_bridge(start: Callable[..., NodeProcess], board: VirtualBoard) -> Callable[..., NodeProcess]:
    """Starts the bridge on the virtual board; keywords are parameters (quiet time 0, source commands)."""

    def starter(**parameters: object) -> NodeProcess:
        values = {"port": board.port, "open_wait_s": 0.0} | parameters
        return start(BRIDGE, *bridge_words(**values))

    return starter
