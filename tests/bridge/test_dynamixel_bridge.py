"""The bridge process on an emulated bus of Dynamixel servos: driven, read back, faults, e-stop, limits."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bridge_session import BRIDGE, bridge_words
from node_processes import parameter_words
from waiting import BUILD_S

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, UInt16MultiArray

from servo_bridge.emulator import VirtualBoard
from servo_bridge.protocols import DynamixelBus, dynamixel_packets as table
from softsim_core.scene import load_scene

pytestmark = pytest.mark.slow

ROBOT = """\
name: four
joints:
  - {name: leg_0, limits: &limits {lower: -1.2, upper: 1.2, speed: 3.0, acceleration: 30.0}}
  - {name: leg_1, limits: *limits}
  - {name: leg_2, limits: *limits}
  - {name: leg_3, limits: *limits}
board:
  baud_rate: 1000000
  servos:  # pulse = 2048 - 651.9 * angle
    - {joint: leg_0, id: 0, sign: -1}
    - {joint: leg_1, id: 1, sign: -1}
    - {joint: leg_2, id: 2, sign: -1, rest_pulse: 2100}
    - {joint: leg_3, id: 3, sign: -1, pulse_min: 1350}
"""
REST = (2048, 2048, 2100, 2048)
LOW, HIGH = math.ceil(2048 - 1.2 * 4096 / math.tau), math.floor(2048 + 1.2 * 4096 / math.tau)
COMMANDS = "position_controller/commands"
NEAR = 17
Starter = Callable[..., Any]


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    file = tmp_path / "four.yaml"
    file.write_text(ROBOT)
    return file


@pytest.fixture
def board(tmp_path: Path, robot: Path) -> Iterator[VirtualBoard]:
    described = load_scene(robot).board
    assert described is not None
    with VirtualBoard(described.servos, link=tmp_path / "board") as virtual:
        yield virtual


@pytest.fixture
def bus(board: VirtualBoard) -> DynamixelBus:
    assert isinstance(board.model, DynamixelBus)
    return board.model


@pytest.fixture
def start_four(start_bridge: Starter, robot: Path) -> Starter:
    """Starts the bridge with the robot of four servos; it sends unless told otherwise."""
    return lambda **parameters: start_bridge(**{"robot": robot, "autostart": "activate"} | parameters)


@pytest.fixture
def start_four_process(start_bridge_process: Starter, robot: Path) -> Starter:
    """As `start_four`, in a process of its own."""
    return lambda **parameters: start_bridge_process(**{"robot": robot, "autostart": "activate"} | parameters)


def command(*angles: float) -> Float64MultiArray:
    return Float64MultiArray(data=list(angles))


def told(*pulses: int) -> Callable[[VirtualBoard], bool]:
    """Whether the servos' newest goals are these."""
    return lambda board: board.servo_bytes == pulses


def values(diagnostics: list[DiagnosticArray]) -> dict[str, str]:
    """Key-value pairs of the newest status of the bridge."""
    found = [status for message in diagnostics for status in message.status if "servo_bridge" in status.name]
    return {pair.key: pair.value for pair in found[-1].values} if found else {}


def within_limits(bus: DynamixelBus) -> bool:
    """Whether every goal that was ever told lay within the joint's limits and the servo's range."""
    for servo_id, servo in bus.servos.items():
        assert servo.goals is not None
        assert max(LOW, 1350 if servo_id == 3 else 0) <= servo.goals[0] <= servo.goals[1] <= HIGH
    return True


def spoil(bus: DynamixelBus, share: float, seed: int) -> None:
    bus.faults.draw = random.Random(seed)
    bus.faults.lost = bus.faults.late = bus.faults.damaged = bus.faults.unheard = share


def drive(client: Any, board: VirtualBoard, stream: Starter, angle: float) -> Any:
    """Send all servos to an angle and wait until they were told the end of the way."""
    running = stream(client.publisher(Float64MultiArray, COMMANDS), command(*[angle] * 4))
    goal = round(2048 - angle * 4096 / math.tau)
    assert board.wait_for(told(goal, goal, goal, goal))
    return running


def test_the_servos_are_found_driven_and_read_back(
    start_four: Starter,
    client: Any,
    board: VirtualBoard,
    bus: DynamixelBus,
    stream: Starter,
    wait_until: Starter,
) -> None:
    for servo_id, servo in bus.servos.items():
        servo.turn(2048 + 100 * servo_id)  # as somebody left them
        servo.put(table.GOAL_POSITION, 3000)
    bridge = start_four(autostart="configure")
    diagnostics = client.collect(DiagnosticArray, "/diagnostics")
    assert wait_until(lambda: values(diagnostics).get("link") == "dynamixel")
    assert values(diagnostics)["models"] == "XM430-W210 XM430-W210 XM430-W210 XM430-W210"
    assert not any(servo.torque for servo in bus.servos.values())
    assert [servo.goals for servo in bus.servos.values()] == [None] * 4

    applied = client.collect(JointState, "applied_joint_states")
    client.transition("activate")
    assert wait_until(lambda: bool(applied))
    first = board.packets[0].servo_bytes
    assert max(abs(pulse - 2048 - 100 * number) for number, pulse in enumerate(first)) <= 1
    drive(client, board, stream, 0.8)
    assert wait_until(lambda: applied[-1].position == pytest.approx([0.8] * 4, abs=0.001))
    assert applied[-1].name == ["leg_0", "leg_1", "leg_2", "leg_3"]
    assert wait_until(lambda: values(diagnostics).get("torque") == "on on on on")
    assert values(diagnostics)["hardware errors"] == "none"
    assert board.dropped == 0
    bridge.end()
    assert board.wait_for(lambda b: not b.is_open)
    assert [servo.goal for servo in bus.servos.values()] == list(REST)
    assert not any(servo.torque for servo in bus.servos.values())
    assert within_limits(bus)


def test_the_virtual_board_takes_the_servos_from_the_robot_s_file(
    start: Starter, client: Any, robot: Path, tmp_path: Path, wait_until: Starter
) -> None:
    link = tmp_path / "another"
    pulses = client.collect(UInt16MultiArray, "virtual_board/servo_pulses")
    words = ["--ros-args", "-r", "__ns:=/tripod"]
    board = start("servo_bridge.nodes.virtual_board_node", *words, *parameter_words(robot=robot, link=link))
    assert board.says("virtual board on")
    start(BRIDGE, *bridge_words(robot=robot, port=link, autostart="activate"))
    assert wait_until(lambda: bool(pulses))
    first = list(pulses[0].data)  # heard on the way from the middle to rest, if it was heard late
    assert len(first) == len(REST)
    assert all(2048 <= pulse <= rest for pulse, rest in zip(first, REST, strict=True)), first


def test_up_with_an_emulated_board_mirrors_the_simulator_onto_the_bus(
    start: Starter, client: Any, robot: Path, stream: Starter, wait_until: Starter
) -> None:
    applied = client.collect(JointState, "applied_joint_states")
    words = ("--board", "emulated", "--send", "--headless", "--no-viewer", "--namespace", "tripod")
    up = start("softsim_ros.cli", "up", str(robot), *words)
    stream(client.publisher(Float64MultiArray, COMMANDS), command(0.3, -0.3, 0.2, 0.1))
    goal = [0.3, -0.3, 0.2, 0.1]
    assert wait_until(
        lambda: bool(applied) and applied[-1].position == pytest.approx(goal, abs=0.002), BUILD_S
    )
    assert up.end() == 0


def test_what_is_published_is_measured_and_not_what_was_told(
    start_four: Starter,
    client: Any,
    board: VirtualBoard,
    bus: DynamixelBus,
    stream: Starter,
    wait_until: Starter,
) -> None:
    start_four()
    applied = client.collect(JointState, "applied_joint_states")
    assert wait_until(lambda: applied)  # found: discovery may take longer than the way
    drive(client, board, stream, 0.5)
    assert wait_until(lambda: applied[-1].position == pytest.approx([0.5] * 4, abs=0.001))
    bus.servos[2].put(44, 1)  # as if it were blocked: it hardly moves
    running = drive(client, board, stream, -0.5)
    assert wait_until(lambda: abs(applied[-1].position[0] + 0.5) < 0.001)
    assert applied[-1].position[2] > 0.0
    running.stop()


def test_lost_late_and_damaged_packets_are_survived(
    start_four: Starter, client: Any, board: VirtualBoard, bus: DynamixelBus, stream: Starter
) -> None:
    spoil(bus, 0.05, 11)
    start_four()
    running = drive(client, board, stream, 0.9)
    for angle in (-0.9, 0.4):
        running.message = command(*[angle] * 4)
        goal = round(2048 - angle * 4096 / math.tau)
        assert board.wait_for(told(goal, goal, goal, goal))
    assert board.open_count == 1  # and none of it was a lost board
    assert within_limits(bus)


def test_a_servo_that_falls_silent_is_named_and_driven_again_when_it_is_back(
    start_four: Starter, client: Any, board: VirtualBoard, bus: DynamixelBus, stream: Starter
) -> None:
    bridge = start_four()
    drive(client, board, stream, 0.5)
    bus.servos[1].answers = False
    assert bridge.says("no telemetry from the board")
    assert bridge.says("receives nothing from servo 1 (leg_1) at 1000000 baud (answers come from: 0, 2, 3)")
    for servo_id in (0, 2, 3):
        assert bus.servos[servo_id].torque  # they hold
    bus.servos[1].power_cycle()
    bus.servos[1].turn(2200)
    bus.servos[1].answers = True
    assert board.wait_for(lambda b: b.servo_bytes == (1722,) * 4 and bus.servos[1].torque)
    assert within_limits(bus)


def test_the_adapter_unplugged_and_plugged_in_again(
    start_four: Starter, client: Any, board: VirtualBoard, bus: DynamixelBus, stream: Starter
) -> None:
    bridge = start_four()
    drive(client, board, stream, 0.5)
    board.unplug()
    assert bridge.says("vanished")
    board.clear()
    board.replug()
    assert bridge.says("is open again")
    assert board.wait_for(told(1722, 1722, 1722, 1722))
    assert board.wait_for(lambda b: len(b.packets) > 5)
    assert {pulse for packet in board.packets for pulse in packet.servo_bytes} == {1722}  # they held
    assert all(servo.torque for servo in bus.servos.values())


def test_an_overload_stops_the_bridge_with_a_sentence_until_the_supply_was_off(
    start_four: Starter, client: Any, board: VirtualBoard, bus: DynamixelBus, stream: Starter
) -> None:
    bridge = start_four()
    drive(client, board, stream, 0.5)
    bus.servos[2].fail(table.HardwareError.OVERLOAD)
    assert bridge.says("servo 2 (leg_2) has switched its torque off (overload)")
    assert client.reaches("inactive")
    for servo in bus.servos.values():
        servo.power_cycle()
    assert board.wait_for(lambda b: all(servo.torque for servo in bus.servos.values()))
    assert board.wait_for(told(1722, 1722, 1722, 1722))


def test_a_servo_set_otherwise_leaves_the_bridge_with_a_sentence(
    start_four: Starter, board: VirtualBoard, bus: DynamixelBus
) -> None:
    bus.servos[3].put(11, 4)
    bridge = start_four()
    assert bridge.says("servo 3 (leg_3) is in operating mode 4; set mode 3 (position)")
    assert not any(servo.torque for servo in bus.servos.values())


def test_a_line_that_is_too_slow_is_refused(
    start_four: Starter, client: Any, robot: Path, board: VirtualBoard
) -> None:
    bridge = start_four(autostart="none", baud_rate=57600)
    assert client.refuses("configure")
    assert bridge.says("4 servos at 57600 baud need")
    assert board.received == 0


@pytest.mark.parametrize("way", ["stay", "deactivate", "kill"])
def test_an_e_stop_on_the_way_stops_within_one_packet(
    start_four: Starter,
    start_four_process: Starter,
    client: Any,
    board: VirtualBoard,
    bus: DynamixelBus,
    stream: Starter,
    way: str,
) -> None:
    bridge = start_four_process() if way == "kill" else start_four()
    running = drive(client, board, stream, 1.0)
    assert client.trigger("servo_bridge/clear_e_stop").success  # found
    running.message = command(*[-1.0] * 4)
    assert board.wait_for(lambda b: b.servo_bytes is not None and b.servo_bytes[0] > 1600)
    assert client.trigger("servo_bridge/e_stop").success
    count = board.accepted
    if way == "kill":
        bridge.process.kill()
        bridge.process.wait()
        assert board.wait_for(lambda b: not b.is_open)
    else:
        assert board.wait_for(lambda b: b.accepted >= count + 3)
    stopped = board.servo_bytes
    assert stopped is not None
    assert stopped[0] < 2600  # the way ends at 2700
    if way == "deactivate":
        client.transition("deactivate")
    if way != "kill":
        count = board.accepted
        assert board.wait_for(lambda b: b.accepted >= count + 30)
    assert board.servo_bytes == stopped
    assert all(servo.torque for servo in bus.servos.values())
    assert board.wait_for(lambda b: bus.positions == pytest.approx(dict(enumerate(stopped)), abs=NEAR))
    if way == "stay":
        assert client.trigger("servo_bridge/clear_e_stop").success
        assert board.wait_for(told(2700, 2700, 2700, 2700))  # the commands of now
    assert within_limits(bus)


def test_an_e_stop_before_anything_was_sent_gives_no_torque(
    start_four: Starter, client: Any, board: VirtualBoard, bus: DynamixelBus, wait_until: Starter
) -> None:
    diagnostics = client.collect(DiagnosticArray, "/diagnostics")
    start_four(autostart="configure")
    assert wait_until(lambda: values(diagnostics).get("link") == "dynamixel")
    assert client.trigger("servo_bridge/e_stop").success
    assert client.refuses("activate")
    count = board.accepted
    assert board.wait_for(lambda b: b.accepted >= count + 20)
    assert not any(servo.torque for servo in bus.servos.values())


def test_kill_9_on_the_way_is_stopped_by_the_servos_and_taken_over_by_the_next_bridge(
    start_four: Starter,
    start_four_process: Starter,
    client: Any,
    board: VirtualBoard,
    bus: DynamixelBus,
    stream: Starter,
) -> None:
    bridge = start_four_process()
    drive(client, board, stream, 1.0).stop()
    bridge.process.kill()
    bridge.process.wait()
    tripped = table.WATCHDOG_TRIPPED
    assert board.wait_for(lambda b: not b.is_open)
    servos = bus.servos.values()
    assert board.wait_for(lambda b: all(servo.get(table.BUS_WATCHDOG) == tripped for servo in servos))
    stood = bus.positions
    assert all(servo.torque for servo in bus.servos.values())
    board.clear()
    start_four(hold_timeout=60.0, rest_timeout=60.0)
    assert board.wait_for(lambda b: len(b.packets) > 3)
    for number, pulse in enumerate(board.packets[0].servo_bytes):
        assert abs(pulse - stood[number]) <= NEAR
    assert board.wait_for(lambda b: all(servo.get(table.BUS_WATCHDOG) == 25 for servo in servos))


@pytest.mark.parametrize("seed", [3])
def test_no_goal_outside_the_limits_whatever_is_commanded_on_a_bad_line(
    start_four: Starter, client: Any, board: VirtualBoard, bus: DynamixelBus, stream: Starter, seed: int
) -> None:
    draw = random.Random(seed)
    spoil(bus, 0.03, seed)
    start_four()
    running = stream(client.publisher(Float64MultiArray, COMMANDS), command(0.0, 0.0, 0.0, 0.0))
    assert board.wait_for(lambda b: b.accepted > 5)
    for _ in range(40):
        wild = [draw.choice([math.nan, math.inf, 1e9, -1e9, draw.uniform(-4.0, 4.0)]) for _ in range(4)]
        running.message = command(*wild[: draw.choice([3, 4, 4, 4, 4])])
        count = board.accepted
        assert board.wait_for(lambda b, more=count + 5: b.accepted >= more)
        if draw.random() < 0.1:
            assert client.trigger("servo_bridge/e_stop").success
            assert client.trigger("servo_bridge/clear_e_stop").success
    assert within_limits(bus)
