"""The e-stop acts within one packet, whatever the bridge is busy with, and its clearing moves nothing."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from waiting import DEADLINE_S

pytest.importorskip("rclpy")

from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from servo_bridge.emulator import VirtualBoard

REST = (150, 150, 150)
FAR = (64, 64, 64)
COMMANDS = "position_controller/commands"
Starter = Callable[..., Any]


def drive_far(client: Any, board: VirtualBoard, stream: Starter) -> None:
    message = Float64MultiArray(data=[-2.0] * 3)
    stream(client.publisher(Float64MultiArray, COMMANDS), message)
    assert board.wait_for(lambda b: b.servo_bytes == FAR)
    board.clear()


@pytest.mark.parametrize("way_out", ["deactivate", "active_shutdown", "SIGINT", "SIGTERM"])
@pytest.mark.slow
def test_on_the_way_to_rest_it_stops_within_one_packet(
    start_bridge: Starter,
    start_bridge_process: Starter,
    client: Any,
    board: VirtualBoard,
    stream: Starter,
    wait_until: Starter,
    tmp_path: Path,
    way_out: str,
) -> None:
    robot = tmp_path / "slow.yaml"
    limits = "{lower: -2.0225, upper: -0.0255, speed: 0.3}"
    joints = "".join(f"  - {{name: servo_{number}, limits: {limits}}}\n" for number in range(3))
    tripod = Path(__file__).resolve().parents[2] / "configs" / "robots" / "tripod.yaml"
    robot.write_text(f"extends: {tripod}\njoints:\n{joints}")
    starter = start_bridge_process if way_out.startswith("SIG") else start_bridge
    bridge = starter(robot=robot, autostart="activate", settle_timeout=30.0)
    message = Float64MultiArray(data=[-1.0] * 3)
    stream(client.publisher(Float64MultiArray, COMMANDS), message)
    assert board.wait_for(lambda b: b.servo_bytes == (121, 121, 121))
    client.service(Trigger, "servo_bridge/e_stop")  # found before the bridge has no time for anything else
    board.clear()
    if way_out.startswith("SIG"):
        bridge.process.send_signal(getattr(signal, way_out))
    else:
        answer = client.ask(way_out)
    assert board.wait_for(lambda b: b.servo_bytes is not None and 124 <= b.servo_bytes[0] <= 130)
    assert client.trigger("servo_bridge/e_stop").success
    stopped = board.packets
    if way_out.startswith("SIG"):
        assert bridge.process.wait(DEADLINE_S) == 0
    else:
        assert wait_until(answer.done)
        assert answer.result().success
    later = [packet.servo_bytes for packet in board.packets[len(stopped) :]]
    assert len(later) <= 1  # what was on the line when the answer came
    assert board.servo_bytes is not None
    assert 124 <= board.servo_bytes[0] <= 132  # the way to rest would have lasted for another second


@pytest.mark.slow
def test_it_is_answered_while_a_robot_is_loaded(
    start_bridge: Starter, client: Any, board: VirtualBoard, tmp_path: Path, wait_until: Starter
) -> None:
    gate, robot = tmp_path / "gate", tmp_path / "slow.py"
    os.mkfifo(gate)
    robot.write_text(f"open({str(gate)!r}).read()\nraise LookupError('no robot here')\n")
    bridge = start_bridge(robot=robot)
    answer = client.ask("configure")
    held: list[int] = []

    def reading() -> bool:
        """Whether the robot's file reads from the gate, which then stays open."""
        assert not answer.done()
        with contextlib.suppress(OSError):  # nobody reads yet
            held.append(os.open(gate, os.O_WRONLY | os.O_NONBLOCK))
        return bool(held)

    assert wait_until(reading)
    assert client.trigger("servo_bridge/e_stop").success
    assert not answer.done()
    os.close(held[0])
    assert wait_until(answer.done)
    assert not answer.result().success
    assert bridge.says("no robot here")
    assert client.state() == "unconfigured"
    assert board.received == 0


@pytest.mark.slow
@pytest.mark.parametrize("board", ["extended"], indirect=True)
def test_latched_while_the_port_is_gone_it_keeps_the_bridge_from_going_on(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter, wait_until: Starter
) -> None:
    bridge = start_bridge(autostart="activate", open_wait_s=2.0)
    drive_far(client, board, stream)
    board.unplug()
    assert bridge.says("vanished")
    assert client.trigger("servo_bridge/e_stop").success
    before = board.accepted
    board.replug()
    assert bridge.says("is open again")
    assert bridge.says("the e-stop is latched; call ~/clear_e_stop first")
    assert client.reaches("inactive")
    assert board.accepted == before


@pytest.mark.slow
def test_its_clearing_moves_nothing_before_the_next_command(
    start_bridge: Starter, client: Any, board: VirtualBoard
) -> None:
    bridge = start_bridge(autostart="activate", hold_timeout=0.1, rest_timeout=0.2, rest_speed=10.0)
    assert bridge.says("sending to")  # what was commanded before that is dropped
    publisher = client.publisher(Float64MultiArray, COMMANDS)
    publisher.publish(Float64MultiArray(data=[-2.0] * 3))
    assert board.wait_for(lambda b: b.servo_bytes is not None and b.servo_bytes != REST)
    assert client.trigger("servo_bridge/e_stop").success
    assert client.trigger("servo_bridge/clear_e_stop").success
    read = len(board.packets)
    assert board.wait_for(
        lambda b: len(b.packets) > read + 3
    )  # what was sent before it may still be on the line
    board.clear()
    assert board.wait_for(
        lambda b: len(b.packets) > 50
    )  # five times as long as the silence that leads to rest
    assert len({packet.servo_bytes for packet in board.packets}) == 1
    stopped = board.packets[-1].servo_bytes
    publisher.publish(Float64MultiArray(data=[-0.5] * 3))
    assert board.wait_for(lambda b: b.servo_bytes != stopped)


@pytest.mark.slow
def test_its_packet_does_not_wait_for_the_beat(
    start_bridge: Starter, client: Any, board: VirtualBoard
) -> None:
    bridge = start_bridge(autostart="activate")
    assert board.wait_for(lambda b: len(b.packets) > 3)
    bridge.node._session._writer.period = 3600.0  # from the packet after the next on, in an hour
    for _ in range(6):
        board.clear()
        assert client.trigger("servo_bridge/e_stop").success
        assert board.wait_for(lambda b: bool(b.packets))
        assert client.trigger("servo_bridge/clear_e_stop").success
