"""The stop, from the driver to the pins: latched in the firmware; nobody comes back faster than allowed."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from firmware_build import build
from lock_step import REST, TOLERANCE_US, LockStep, tripod

from servo_bridge.driver import byte_to_width, bytes_to_angles
from servo_bridge.emulator import EmulatedBoard, EmulatedBoardPty

FAR = (65, 70, 75)
SLEW_US = 62.0
REST_RAD, NEAR = math.radians(150 - 179), math.radians(2.0)
LONGEST_STEP = 3.5 * 0.04 + NEAR / 10.0
"""Largest change from packet to packet in [rad]: two periods at the joints' speed; widths are whole us."""


def driven(board: EmulatedBoard) -> LockStep:
    """A driver that streams a pose far from rest, which the servos have reached."""
    made = LockStep(board)
    made.connect()
    made.drive_to(*FAR)
    return made


def stop(robot: LockStep) -> None:
    """Latch the e-stop; the packet that carries it leaves at once."""
    robot.driver.motion.e_stop.latch()
    robot.driver.tick()
    robot.run(robot.driver.period)
    robot.board.clear()


def stays(robot: LockStep, seconds: float) -> None:
    """Nobody sends; the servos stay where they are, with pulses in every frame."""
    robot.board.clear()
    robot.run(seconds)
    assert robot.at(*FAR), robot.board.widths_us()
    assert robot.largest_step_us() < TOLERANCE_US
    assert len(robot.board.pulses) >= 3 * (50 * seconds - 2)


@pytest.mark.parametrize("end", ["deactivate", "close", "kill"])
def test_latched_it_outlasts_the_bridge(board: EmulatedBoard, end: str) -> None:
    robot = driven(board)
    stop(robot)
    if end == "deactivate":
        assert not robot.driver.begin_settling(1.5)
        robot.drive(5.0)
    elif end == "close":
        robot.driver.disconnect(relax=True)
    stays(robot, 5.0)
    if end == "deactivate":  # nor does its clearing move them
        robot.driver.motion.e_stop.clear()
        robot.drive(4.0)
        assert robot.at(*FAR), board.widths_us()
        assert robot.largest_step_us() < TOLERANCE_US


def test_it_outlasts_the_bridge_where_the_line_has_no_word_to_stop(
    make_board: Callable[..., EmulatedBoard],
) -> None:
    robot = driven(make_board(build("-DLEGACY_ONLY")))
    assert robot.driver.holds is False
    stop(robot)
    robot.drive(0.5, REST)
    assert robot.at(*FAR)
    stays(robot, 5.0)
    robot.close()


def test_latched_it_outlasts_a_bridge_that_stands_still_and_its_clearing(board: EmulatedBoard) -> None:
    robot = driven(board)
    stop(robot)
    stays(robot, 5.0)
    robot.driver.motion.e_stop.clear()
    robot.drive(2.0)
    assert robot.at(*FAR), board.widths_us()
    assert robot.largest_step_us() < TOLERANCE_US
    robot.close()


def test_a_bridge_killed_and_started_anew_finds_the_servos_where_they_are(board: EmulatedBoard) -> None:
    robot = driven(board)
    killed = robot.driver
    robot.run(1.0)
    robot.new_driver()
    robot.connect()  # opens the port: a reset
    assert board.widths_us() is None
    robot.drive_to(*FAR)
    assert robot.largest_step_us() <= SLEW_US  # over the reset, too
    board.clear()
    robot.drive(2.0, FAR)
    assert robot.largest_step_us() < TOLERANCE_US
    robot.close()
    killed.disconnect()


def test_a_bridge_that_stood_still_comes_back_from_where_the_board_went(board: EmulatedBoard) -> None:
    robot = driven(board)
    robot.run(6.0)
    assert robot.at(*REST)  # it went to rest by itself
    angles = [robot.driver.applied_angles()]

    def back() -> bool:
        angles.append(robot.driver.applied_angles())
        return robot.at(*FAR)

    assert robot.drive_until(back, FAR)
    news = list(robot.driver.takeover.news)
    assert any("the bridge was stalled for 6.0 s" in each for each in news), news
    assert any("deg away from its commands; the bridge continues from there" in each for each in news), news
    from_rest = [pose for pose in angles if pose != angles[0]]
    assert abs(from_rest[0][0] - REST_RAD) < NEAR
    for before, after in pairwise(from_rest):
        assert max(abs(b - a) for a, b in zip(before, after, strict=True)) <= LONGEST_STEP
    robot.close()


@pytest.mark.ros
@pytest.mark.slow
def test_latched_it_outlasts_a_bridge_that_is_interrupted(
    emulator: None, tmp_path: Path, start: Any, client: Any, stream: Any
) -> None:
    """The same through a service, a process and a pseudo-terminal."""
    from bridge_session import BRIDGE, bridge_words
    from std_msgs.msg import Float64MultiArray

    board_settings = tripod().board
    assert board_settings is not None
    widths = [byte_to_width(each) for each in FAR]

    def at_far(board: EmulatedBoardPty) -> bool:
        return board.widths_us() == pytest.approx(widths, abs=TOLERANCE_US)

    with EmulatedBoardPty(link=tmp_path / "board") as board:
        bridge = start(BRIDGE, *bridge_words(port=board.port, autostart="activate"))
        command = Float64MultiArray(data=list(bytes_to_angles(FAR, board_settings.hobby_servos)))
        stream(client.publisher(Float64MultiArray, "position_controller/commands"), command)
        assert board.wait_for(at_far, 120.0), bridge.output
        assert client.trigger("servo_bridge/e_stop").success
        assert bridge.end(signal.SIGINT) == 0
        end = board.time_s + 2.5  # silence would lead to rest after two
        assert board.wait_for(lambda each: each.time_s > end, 120.0)
        assert at_far(board), board.widths_us()
