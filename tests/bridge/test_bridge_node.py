"""The bridge across processes: real rclpy, real pseudo-terminal, the board's side read back."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from waiting import DEADLINE_S

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from servo_bridge.emulator import VirtualBoard
from servo_bridge.nodes import main

REST = (150, 150, 150)
COMMANDS = "position_controller/commands"
Starter = Callable[..., Any]


def command(*values: float) -> Float64MultiArray:
    return Float64MultiArray(data=list(values))


def at(*servo_bytes: int) -> Callable[[VirtualBoard], bool]:
    """Whether the board's newest pose is this one."""
    return lambda board: board.servo_bytes == servo_bytes


def sending(board: VirtualBoard) -> bool:
    """Whether ten more packets come."""
    goal = board.accepted + 10
    return board.wait_for(lambda b: b.accepted >= goal)


@pytest.mark.slow
def test_the_lifecycle_is_closed_then_open_then_sending(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter
) -> None:
    bridge = start_bridge()
    assert client.state() == "unconfigured"
    assert board.open_count == 0
    assert client.refuses("activate")
    assert bridge.says("transition 3 refused in state unconfigured; possible are: configure, shutdown")

    client.transition("configure")
    assert client.state() == "inactive"
    assert board.wait_for(lambda b: b.is_open)
    running = stream(client.publisher(Float64MultiArray, COMMANDS), command(-1.4965, -1.0, -0.785))
    assert client.state() == "inactive"
    assert board.received == 0  # nothing moves before activate

    applied = client.collect(JointState, "applied_joint_states")
    client.transition("activate")
    assert board.wait_for(at(93, 121, 134))
    assert board.packets[0].servo_bytes == REST
    running.message = command(0.0, -2.0225, -1.046667)
    assert board.wait_for(at(177, 63, 119))  # 0 rad is clamped to the joint's upper limit, -0.0255 rad
    assert applied[-1].name == ["servo_0", "servo_1", "servo_2"]
    nominal = {round(angle, 9) for message in applied for angle in message.position}
    sent = {value for packet in board.packets for value in packet.servo_bytes}
    assert nominal <= {round(math.radians(value - 179), 9) for value in sent}

    client.transition("deactivate")
    assert board.wait_for(lambda b: [packet.servo_bytes for packet in b.packets[-3:]] == [REST] * 3)
    before = board.received
    assert client.state() == "inactive"
    client.transition("activate")
    assert board.wait_for(at(177, 63, 119))
    assert board.received > before
    client.transition("deactivate")
    client.transition("cleanup")
    assert client.state() == "unconfigured"
    assert board.wait_for(lambda b: not b.is_open)
    client.transition("unconfigured_shutdown")
    assert client.state() == "finalized"
    assert board.dropped == 0


@pytest.mark.slow
def test_joint_states_are_mirrored_by_name(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter
) -> None:
    start_bridge(source="joint_states", autostart="activate")
    message = JointState(
        name=["servo_2", "other", "servo_0", "servo_1"], position=[-0.785, math.nan, -1.4965, -1.0]
    )
    stream(client.publisher(JointState, "joint_states"), message)
    assert board.wait_for(at(93, 121, 134))


@pytest.mark.slow
def test_the_speed_limit_holds_on_the_wire(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter
) -> None:
    bridge = start_bridge(autostart="activate")
    running = stream(client.publisher(Float64MultiArray, COMMANDS), command(-2.0, -2.0, -2.0))
    assert board.wait_for(at(64, 64, 64))
    running.message = command(-0.1, -2.0, -0.1)
    assert board.wait_for(at(173, 64, 173))
    running.message = command(-2.0, -0.1, 1e9)
    assert board.wait_for(at(64, 173, 177))
    running.stop()
    bridge.end()
    packets = board.packets
    rate = math.degrees(3.5)  # bytes per second
    for before, after in pairwise(packets):  # a step never uses more than two periods, however late it is
        for one, other in zip(before.servo_bytes, after.servo_bytes, strict=True):
            assert abs(one - other) <= rate * 0.04 + 1.0


@pytest.mark.slow
def test_wrong_commands_are_refused_whole_and_reported(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter, wait_until: Starter
) -> None:
    bridge = start_bridge(autostart="activate", hold_timeout=60.0, rest_timeout=60.0)
    diagnostics = client.collect(DiagnosticArray, "/diagnostics")
    publisher = client.publisher(Float64MultiArray, COMMANDS)
    first = stream(publisher, command(-1.0, -1.0, -1.0))
    assert board.wait_for(at(121, 121, 121))
    first.stop()
    board.clear()
    publisher.publish(command(math.nan, -1.5, -1.5))
    assert bridge.says("command nan for joint servo_0 refused")
    for refused, bad in enumerate((command(-1.5, math.inf, -1.5), command(-1.5, -1.5)), start=2):
        publisher.publish(bad)
        assert wait_until(lambda count=str(refused): values(diagnostics).get("commands refused") == count)
    assert "expected 3 (servo_0, servo_1, servo_2)" in values(diagnostics)["last refusal"]
    assert {packet.servo_bytes for packet in board.packets} == {(121, 121, 121)}
    publisher.publish(command(1e9, -1.0, -1.0))
    assert board.wait_for(at(177, 121, 121))
    assert wait_until(lambda: values(diagnostics).get("commands clipped") == "1")
    assert values(diagnostics)["port"] == board.port
    assert client.reaches("active")


def values(diagnostics: list[DiagnosticArray]) -> dict[str, str]:
    """Key-value pairs of the newest status of the bridge."""
    statuses = [
        status for message in diagnostics for status in message.status if "servo_bridge" in status.name
    ]
    return {pair.key: pair.value for pair in statuses[-1].values} if statuses else {}


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_in_the_safe_pose_with_exit_code_0(
    start_bridge_process: Starter, client: Any, board: VirtualBoard, stream: Starter, number: signal.Signals
) -> None:
    bridge = start_bridge_process(autostart="activate")
    stream(client.publisher(Float64MultiArray, COMMANDS), command(-2.0, -0.1, -1.5))
    assert board.wait_for(at(64, 173, 93))
    bridge.process.send_signal(number)
    bridge.process.send_signal(number)  # an impatient second one changes nothing
    assert bridge.process.wait(DEADLINE_S) == 0
    assert board.wait_for(lambda b: not b.is_open)
    assert [packet.servo_bytes for packet in board.packets[-3:]] == [REST] * 3
    assert "Traceback" not in bridge.output


@pytest.mark.slow
def test_kill_9_leaves_the_port_free_for_the_next_bridge(
    start_bridge_process: Starter, client: Any, board: VirtualBoard, stream: Starter
) -> None:
    bridge = start_bridge_process(autostart="activate")
    running = stream(client.publisher(Float64MultiArray, COMMANDS), command(-1.0, -1.0, -1.0))
    assert board.wait_for(lambda b: b.servo_bytes not in (None, REST))
    running.stop()
    bridge.process.kill()
    bridge.process.wait()
    assert board.wait_for(lambda b: not b.is_open)
    board.clear()
    start_bridge_process(autostart="activate")
    assert sending(board)
    assert board.packets[0].servo_bytes == REST


@pytest.mark.slow
def test_a_missing_port_is_a_sentence_and_the_node_stays(
    start_bridge: Starter, client: Any, board: VirtualBoard
) -> None:
    bridge = start_bridge(port=f"{board.port}_missing")
    assert client.refuses("configure")
    assert bridge.says("board_missing does not exist; plug the board in, or give another name")
    assert client.state() == "unconfigured"


@pytest.mark.slow
def test_autostart_waits_for_a_port_that_comes_later(start_bridge: Starter, board: VirtualBoard) -> None:
    board.unplug()
    bridge = start_bridge(autostart="activate")
    assert bridge.says("does not exist")
    board.replug()
    assert sending(board)


@pytest.mark.slow
def test_a_second_bridge_on_the_same_port_is_refused(
    start_bridge_process: Starter, client: Any, board: VirtualBoard
) -> None:
    start_bridge_process(autostart="activate")
    assert sending(board)
    second = start_bridge_process(autostart="configure")
    assert second.says("is in use by another program")
    assert second.end(signal.SIGTERM) == 0
    assert sending(board)


@pytest.mark.slow
@pytest.mark.parametrize("board", ["extended"], indirect=True)
def test_a_port_that_vanishes_is_reported_and_the_pose_taken_up_again(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter, wait_until: Starter
) -> None:
    bridge = start_bridge(autostart="activate", open_wait_s=2.0)
    diagnostics = client.collect(DiagnosticArray, "/diagnostics")
    running = stream(client.publisher(Float64MultiArray, COMMANDS), command(-2.0, -2.0, -2.0))
    assert board.wait_for(at(64, 64, 64))
    board.unplug()
    assert bridge.says("vanished (board unplugged, or its USB supply failed); plug it in again")
    assert client.reaches("inactive")
    assert wait_until(
        lambda: any(
            "does not exist" in item.message or "vanished" in item.message
            for message in diagnostics
            for item in message.status
        )
    )
    running.message = command(-0.1, -0.1, -0.1)
    board.clear()
    board.replug()
    assert board.wait_for(at(173, 173, 173))
    assert all(abs(value - 64) <= math.degrees(3.5) * 0.04 + 1.0 for value in board.packets[0].servo_bytes)
    assert client.reaches("active")
    assert wait_until(lambda: values(diagnostics).get("reconnects") == "1")
    assert "Traceback" not in bridge.output


@pytest.mark.slow
def test_a_silent_board_plugged_in_again_is_driven_after_cleanup_and_configure(
    start_bridge: Starter, client: Any, board: VirtualBoard
) -> None:
    bridge = start_bridge(autostart="activate")
    assert sending(board)
    board.unplug()
    assert bridge.says("vanished")
    before = board.received
    board.replug()
    assert bridge.says("is still the one that was configured is unknown")
    assert (client.state(), board.received) == ("inactive", before)
    for label in ("cleanup", "configure", "activate"):
        client.transition(label)
    assert sending(board)


@pytest.mark.slow
def test_silence_holds_and_then_goes_to_rest(start_bridge: Starter, client: Any, board: VirtualBoard) -> None:
    bridge = start_bridge(autostart="activate", hold_timeout=0.6, rest_timeout=0.9, rest_speed=1.0)
    assert bridge.says("sending to")  # what was commanded before that is dropped
    client.publisher(Float64MultiArray, COMMANDS).publish(command(-1.0, -1.0, -1.0))
    assert board.wait_for(at(121, 121, 121))
    assert board.wait_for(at(*REST))
    poses = [packet.servo_bytes for packet in board.packets]
    held = len(poses) - poses[::-1].index((121, 121, 121)) - 1
    for before, after in pairwise(board.packets[held:]):
        assert 0 <= after.servo_bytes[0] - before.servo_bytes[0] <= math.degrees(1.0) * 0.04 + 1.0


@pytest.mark.slow
def test_the_e_stop_is_latched_until_it_is_cleared(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter
) -> None:
    bridge = start_bridge(autostart="activate")
    running = stream(client.publisher(Float64MultiArray, COMMANDS), command(-1.0, -1.0, -1.0))
    assert board.wait_for(at(121, 121, 121))
    assert client.trigger("servo_bridge/e_stop").success
    running.message = command(-2.0, -2.0, -2.0)
    board.clear()
    assert sending(board)
    assert {packet.servo_bytes for packet in board.packets} == {(121, 121, 121)}
    client.transition("deactivate")
    assert board.servo_bytes == (121, 121, 121)
    assert client.refuses("activate")
    assert bridge.says("the e-stop is latched; call ~/clear_e_stop first")
    assert client.trigger("servo_bridge/clear_e_stop").success
    client.transition("activate")
    assert board.wait_for(at(64, 64, 64))


@pytest.mark.slow
def test_the_board_is_given_its_quiet_time(start_bridge: Starter, client: Any, board: VirtualBoard) -> None:
    start_bridge(open_wait_s=1.0)
    client.transition("configure")
    assert board.wait_for(lambda b: b.is_open)
    client.transition("activate")
    assert board.received == 0
    assert sending(board)


@pytest.mark.slow
def test_parameters_that_need_a_new_configure_are_refused_meanwhile(
    start_bridge: Starter, client: Any, board: VirtualBoard, stream: Starter
) -> None:
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters

    def change(name: str, kind: int, **value: Any) -> Any:
        parameter = Parameter(name=name, value=ParameterValue(type=kind, **value))
        request = SetParameters.Request(parameters=[parameter])
        return client.call(SetParameters, "servo_bridge/set_parameters", request).results[0]

    start_bridge(autostart="activate")
    stream(client.publisher(Float64MultiArray, COMMANDS), command(*[math.radians(-78.5)] * 3))
    assert board.wait_for(at(101, 101, 101))
    for name in ("robot", "port", "calibration", "protocol"):
        never = change(name, ParameterType.PARAMETER_STRING, string_value="/dev/ttyACM0")
        assert not never.successful
        assert "read-only" in never.reason
    refused = change("rate", ParameterType.PARAMETER_DOUBLE, double_value=20.0)
    assert not refused.successful
    assert "fixed while the bridge is configured" in refused.reason
    assert not change("rest_timeout", ParameterType.PARAMETER_DOUBLE, double_value=-1.0).successful
    assert change("avoid_byte_100", ParameterType.PARAMETER_BOOL, bool_value=False).successful
    assert board.wait_for(at(100, 100, 100))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["-p", "autostart:=maybe"], "'maybe' is refused; allowed is one of: none, configure, activate"),
        (["-p", "rate:=1000.0"], "rate"),
        (["-p", "port:=3"], "port"),
    ],
)
def test_a_parameter_that_cannot_be_used_ends_with_a_sentence(
    ros_domain: int, capfd: pytest.CaptureFixture[str], arguments: list[str], sentence: str
) -> None:
    assert main(["--ros-args", *arguments]) == 1
    assert sentence in capfd.readouterr().err
