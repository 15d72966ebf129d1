"""The stop, from a service to the pins: latched in the firmware; nobody comes back faster than allowed."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from bridge_session import BRIDGE, BridgeClient, Stream, bridge_words
from firmware_build import build
from node_processes import NodeProcess, spin_until
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from servo_bridge.emulator import EmulatedBoardPty
from servo_bridge.servo import byte_to_width, bytes_to_angles
from softsim_core import load_scene

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.usefixtures("emulator", "ros_domain")]

FAR = (65, 70, 75)
TOLERANCE_US = 1.5
SLEW_US = 62.0
REST_RAD, NEAR = math.radians(150 - 179), math.radians(2.0)
LONGEST_STEP = 3.5 * 0.04 + NEAR / 10.0
"""Largest change from packet to packet in [rad]: two periods at the joints' speed; widths are whole us."""


@pytest.fixture
def far_end(tmp_path: Path) -> Iterator[EmulatedBoardPty]:
    with EmulatedBoardPty(link=tmp_path / "board") as board:
        yield board


@pytest.fixture
def driven(
    start: Callable[..., NodeProcess],
    far_end: EmulatedBoardPty,
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
) -> NodeProcess:
    """A bridge that streams a pose far from rest, which the servos have reached."""
    bridge = start(BRIDGE, *bridge_words(port=far_end.port, autostart="activate"))
    scene = load_scene("tripod")
    assert scene.board is not None
    command = Float64MultiArray(data=list(bytes_to_angles(FAR, scene.board.servos)))
    stream(client.publisher(Float64MultiArray, "position_controller/commands"), command)
    assert far_end.wait_for(at(*FAR)), bridge.output
    return bridge


def at(*servo_bytes: float) -> Callable[[EmulatedBoardPty], bool]:
    """Whether the newest pulses are those of the bytes."""
    wanted = [byte_to_width(each) for each in servo_bytes]
    return lambda board: board.widths_us() == pytest.approx(wanted, abs=TOLERANCE_US)


def largest_steps_us(board: EmulatedBoardPty) -> list[float]:
    """Largest changes of the width from one pulse of a pin to the next, largest first."""
    pins = [[each.width_us for each in board.pulses if each.channel == pin] for pin in range(3)]
    return sorted((abs(b - a) for widths in pins for a, b in pairwise(widths)), reverse=True)


def let_pass(board: EmulatedBoardPty, seconds: float) -> None:
    """Time of the board."""
    end = board.time_s + seconds
    assert board.wait_for(lambda each: each.time_s > end, 60.0)


@pytest.mark.parametrize("end", ["deactivate", "SIGINT", "SIGKILL"])
def test_latched_it_outlasts_the_bridge(
    driven: NodeProcess, far_end: EmulatedBoardPty, client: BridgeClient, end: str
) -> None:
    assert client.trigger("servo_bridge/e_stop").success
    far_end.clear()
    if end == "deactivate":
        client.transition(end)
    else:
        assert driven.end(getattr(signal, end)) == (0 if end == "SIGINT" else -signal.SIGKILL)
    let_pass(far_end, 5.0)
    assert at(*FAR)(far_end), far_end.widths_us()
    assert largest_steps_us(far_end)[0] < TOLERANCE_US
    assert len(far_end.pulses) > 3 * 200
    if end == "deactivate":  # nor does its clearing move them
        assert client.trigger("servo_bridge/clear_e_stop").success
        let_pass(far_end, 4.0)
        assert at(*FAR)(far_end), far_end.widths_us()
        assert largest_steps_us(far_end)[0] < TOLERANCE_US


def test_it_outlasts_the_bridge_where_the_line_has_no_word_to_stop(
    tmp_path: Path,
    start: Callable[..., NodeProcess],
    client: BridgeClient,
    stream: Callable[[Any, Any], Stream],
) -> None:
    with EmulatedBoardPty(build(tmp_path, "-DLEGACY_ONLY"), link=tmp_path / "plain") as board:
        bridge = start(BRIDGE, *bridge_words(port=board.port, autostart="activate"))
        scene = load_scene("tripod")
        assert scene.board is not None
        command = Float64MultiArray(data=list(bytes_to_angles(FAR, scene.board.servos)))
        stream(client.publisher(Float64MultiArray, "position_controller/commands"), command)
        assert board.wait_for(at(*FAR)), bridge.output
        assert bridge.says("the legacy protocol has no word to stop")
        assert "in silence the board's firmware decides" in client.trigger("servo_bridge/e_stop").message
        board.clear()
        assert bridge.end(signal.SIGKILL) == -signal.SIGKILL
        let_pass(board, 5.0)
        assert at(*FAR)(board), board.widths_us()
        assert largest_steps_us(board)[0] < TOLERANCE_US


def test_latched_it_outlasts_a_bridge_that_stands_still_and_its_clearing(
    driven: NodeProcess, far_end: EmulatedBoardPty, client: BridgeClient
) -> None:
    assert client.trigger("servo_bridge/e_stop").success
    far_end.clear()
    driven.process.send_signal(signal.SIGSTOP)
    let_pass(far_end, 5.0)
    driven.process.send_signal(signal.SIGCONT)
    assert at(*FAR)(far_end), far_end.widths_us()
    assert client.trigger("servo_bridge/clear_e_stop").success
    let_pass(far_end, 2.0)
    assert at(*FAR)(far_end), far_end.widths_us()
    assert largest_steps_us(far_end)[0] < TOLERANCE_US


def test_a_bridge_killed_and_started_anew_finds_the_servos_where_they_are(
    driven: NodeProcess, far_end: EmulatedBoardPty, client: BridgeClient, start: Callable[..., NodeProcess]
) -> None:
    assert client.trigger("servo_bridge/e_stop").success  # the board stays, however long the start takes
    far_end.clear()
    opened = far_end.open_count
    driven.end(signal.SIGKILL)
    anew = start(BRIDGE, *bridge_words(port=far_end.port, autostart="activate"))
    assert far_end.wait_for(lambda board: board.open_count > opened), anew.output
    assert far_end.wait_for(lambda board: board.widths_us() is None)  # its port was opened: a reset
    assert far_end.wait_for(at(*FAR)), anew.output
    assert largest_steps_us(far_end)[0] <= SLEW_US  # over the reset, too


def test_a_bridge_that_stood_still_comes_back_from_where_the_board_went(
    driven: NodeProcess, far_end: EmulatedBoardPty, client: BridgeClient
) -> None:
    applied = client.collect(JointState, "applied_joint_states")
    assert spin_until(lambda: len(applied) > 0)
    driven.process.send_signal(signal.SIGSTOP)
    let_pass(far_end, 6.0)
    assert at(150, 150, 150)(far_end)  # it went to rest by itself
    applied.clear()
    driven.process.send_signal(signal.SIGCONT)
    assert far_end.wait_for(at(*FAR)), driven.output
    assert driven.says("the bridge stood still for")
    assert driven.says("away from what it was told; the bridge goes on from there")
    poses = [list(message.position) for message in applied]
    rest = next(index for index, pose in enumerate(poses) if abs(pose[0] - REST_RAD) < NEAR)
    assert rest <= 1  # at most one message of before the stop was still on its way
    for before, after in pairwise(poses[rest:]):
        assert max(abs(b - a) for a, b in zip(before, after, strict=True)) <= LONGEST_STEP
