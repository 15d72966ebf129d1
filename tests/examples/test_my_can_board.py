"""The example of a board on a CAN bus: driven on a virtual bus, within the robot's limits, and its faults."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from board_driving import PERIOD, PacedDriver, robot
from example_files import EXAMPLES, MOST_LINES, lines_of_example, output_of_example
from node_processes import spin_until as wait_until

from servo_bridge import PortError
from servo_bridge.driver import ServoDriver, angles_to_bytes, open_transport
from softsim_core.base import CommandError, SceneError
from softsim_core.scene import load_scene

pytest.importorskip("can")

SPEED = 2.0


class BoardHere:
    """The board on a virtual bus of its own, until it ends.

    Attributes:
        poses: The bytes of every pose it received, oldest first.
    """

    def __init__(self, bus: str, number: int) -> None:
        from virtual_can_board import run_board

        self.poses: list[bytes] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=run_board, args=(bus, self.poses, self._ended, number))
        self._thread.start()

    def end(self) -> None:
        """Unplug it; a second call does nothing."""
        self._ended.set()
        self._thread.join()


@pytest.fixture
def bus(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return f"can:virtual:{request.node.name}"


@pytest.fixture
def board(bus: str) -> Iterator[BoardHere]:
    load_scene(EXAMPLES / "my_can_board.py")  # registers the port and the protocol
    made = BoardHere(bus, 7)
    yield made
    made.end()


def connected(bus: str) -> PacedDriver:
    """The driver of the robot, once it knows its board."""
    paced = PacedDriver(load_scene(EXAMPLES / "my_can_board.py"))
    paced.driver.connect(bus, quiet_s=0.5)
    assert wait_until(lambda: paced.driver.link_state == "can_board")
    return paced


@pytest.mark.slow
def test_it_runs_as_it_stands_and_is_short() -> None:
    output = output_of_example("virtual_can_board")
    assert output.startswith("can_board: ")
    assert output.endswith("servos at (121, 99) degrees\n")
    assert lines_of_example("my_can_board") <= MOST_LINES


def test_the_driver_keeps_speed_and_limits_and_holds_at_an_e_stop(bus: str, board: BoardHere) -> None:
    paced = connected(bus)
    driver = paced.driver
    driver.start()
    paced.follow([-1.0, -9.0], 100)  # the second far beyond its limit of -1.5
    reached = angles_to_bytes([-1.0, -1.5], driver.servos)
    assert wait_until(lambda: board.poses and board.poses[-1] == bytes(reached))
    degrees = [list(pose) for pose in board.poses]
    steps = [abs(b - a) for before, after in pairwise(degrees) for a, b in zip(before, after, strict=True)]
    assert max(steps) <= math.degrees(SPEED * PERIOD) + 1.0  # rounded at both ends
    with pytest.raises(CommandError, match="nan"):
        driver.command([math.nan, 0.0])

    paced.follow([0.0, 0.0], 10)  # on the way back
    driver.motion.e_stop.latch()
    paced.follow([0.0, 0.0], 25)
    assert wait_until(lambda: len(board.poses) == driver.counts.packets)
    stopped = board.poses[-1]
    assert bytes(reached) < stopped < bytes(angles_to_bytes([0.0, 0.0], driver.servos))
    paced.follow([0.0, 0.0], 50)
    assert wait_until(lambda: len(board.poses) == driver.counts.packets)
    assert board.poses[-1] == stopped
    driver.disconnect()


def test_a_silent_board_is_lost_and_another_number_is_refused(bus: str, board: BoardHere) -> None:
    paced = connected(bus)
    board.end()

    def is_lost() -> bool:
        paced.now += PERIOD
        return refusal(paced).startswith(f"no telemetry from the board on {bus}")

    assert wait_until(is_lost)
    paced.driver.disconnect()

    stranger = BoardHere(bus, 8)
    try:
        paced.driver.connect(bus, quiet_s=0.5, again=True)
        assert wait_until(lambda: refusal(paced).startswith(f"another board is on {bus}"))
        assert "number 08, not protocol can_board, number 07" in refusal(paced)
        assert stranger.poses == []
    finally:
        paced.driver.disconnect()
        stranger.end()


def refusal(paced: PacedDriver) -> str:
    """What is wrong with the board now; empty if nothing is."""
    try:
        paced.driver.listen()
    except PortError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("count", [8, 9])
def test_a_board_has_a_servo_for_each_byte_of_a_frame_at_most(count: int) -> None:
    load_scene(EXAMPLES / "my_can_board.py")
    described = robot(count)
    assert described.board is not None
    described = replace(described, board=replace(described.board, protocol="can_board"))
    if count == 8:
        assert len(ServoDriver(described).servos) == 8
        return
    with pytest.raises(SceneError) as refused:
        ServoDriver(described)
    assert str(refused.value) == (
        "robot robot: the board has 9 servos and a CAN frame 8 data bytes; use at most 8 servos"
    )


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("can:nonsense:x", "the CAN bus can:nonsense:x failed"),
        ("can", "port can does not exist"),
        ("bus:localhost:5", "bus is no known kind of port"),
        ("/dev/nothing:here", "port /dev/nothing:here does not exist"),
    ],
)
def test_a_port_that_cannot_be_opened_says_why(port: str, words: str) -> None:
    load_scene(EXAMPLES / "my_can_board.py")
    opened: list[Any] = []
    with pytest.raises(PortError, match=words):
        opened.append(open_transport(port, 115_200))
    assert opened == []
