"""The example of a board of one's own: what it prints, and the driver on it within the robot's limits."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from board_driving import PERIOD, PacedDriver
from example_files import EXAMPLES, MOST_LINES, lines_of_example, output_of_example
from node_processes import spin_until as wait_until

from servo_bridge.emulator import VirtualBoard
from servo_bridge.protocols import protocol_named
from softsim_core.scene import load_scene

EXAMPLE = EXAMPLES / "my_board.py"
SPEED = 2.0


@pytest.mark.slow
def test_it_runs_as_it_stands_and_is_short() -> None:
    output = output_of_example("my_board")
    assert output.startswith("my_board: ")
    assert output.endswith("servos at (121, 99) degrees\n")
    assert lines_of_example("my_board") <= MOST_LINES


def test_its_packets_are_those_it_describes() -> None:
    robot = load_scene(EXAMPLE)
    assert robot.board is not None
    protocol = protocol_named("my_board")(robot.board)
    packet = protocol.encode([-89.0 * math.pi / 180.0] * 2)
    assert packet.data == b"S 90 90 *65\n"
    assert packet.angles_rad == pytest.approx([math.radians(-89.0)] * 2)
    assert not protocol.decode(b"hello\nmy_board rea").recognised
    assert protocol.decode(b"dy\n").recognised


@pytest.mark.slow
def test_the_driver_goes_within_limits_holds_and_ends_at_rest() -> None:
    paced = PacedDriver(load_scene(EXAMPLE))
    driver = paced.driver
    with VirtualBoard(servos=2, protocol="my_board") as board:
        driver.connect(board.port, quiet_s=0.2)
        assert driver.tick() is None
        assert board.received == 0
        assert wait_until(lambda: driver.link_state == "my_board")
        driver.start()
        paced.follow([-9.0, -1.0], 100)
        driver.motion.e_stop.latch()
        paced.follow([0.0, 0.0], 5)
        assert board.wait_for(lambda b: b.accepted == 105)
        poses = [packet.servo_bytes for packet in board.packets]
        assert poses[0] == (150, 150)
        assert set(poses[-6:]) == {(93, 121)}  # clipped to -1.5 rad, then held
        most = math.degrees(SPEED * PERIOD) + 1.0
        for old, new in pairwise(poses):
            assert all(abs(a - b) <= most for a, b in zip(old, new, strict=True))
        driver.motion.e_stop.clear()
        assert driver.settle()
        assert board.wait_for(lambda b: b.servo_bytes == (150, 150))
        assert board.dropped == 0
        driver.disconnect()
