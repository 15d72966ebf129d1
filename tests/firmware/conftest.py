"""Fixtures of the firmware's tests: an emulated board, or a skip that says why (in CI: a failure)."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from bridge_session import client, start, stream

from servo_bridge.emulator import EmulatedBoard, why_missing

__all__ = ["client", "start", "stream"]

sys.path.append(str(Path(__file__).parent))  # tests may import `firmware_line`


@pytest.fixture(scope="session")
def emulator() -> None:
    """Nothing, where boards can be emulated; else a skip, or a failure with REQUIRE_SIMAVR=1."""
    reason = why_missing()
    if reason and os.environ.get("REQUIRE_SIMAVR"):
        pytest.fail(reason)
    if reason:
        pytest.skip(reason)


@pytest.fixture
def make_board(emulator: None) -> Iterator[Callable[..., EmulatedBoard]]:
    """Makes boards that are gone after the test; takes a firmware other than the committed one."""
    boards: list[EmulatedBoard] = []

    def make(hex_path: Path | None = None, bootloader: Path | None = None) -> EmulatedBoard:
        boards.append(EmulatedBoard(hex_path, bootloader))
        return boards[-1]

    yield make
    for board in boards:
        board.close()


@pytest.fixture
def board(make_board: Callable[..., EmulatedBoard]) -> EmulatedBoard:
    """A board with the committed firmware, powered on 10 ms ago."""
    board = make_board()
    board.run(0.01)  # a byte that comes before the firmware has set up its serial line is lost
    return board
