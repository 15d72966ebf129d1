"""The conversation with a bus of Dynamixel servos, in steps: getting ready, goals, hold, faults, limits."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from servo_bridge import ProtocolError
from servo_bridge.emulator import VirtualBoard
from servo_bridge.protocols import (
    AUTO,
    DEAD_BAND,
    DynamixelBus,
    DynamixelProtocol,
    EmulatedServo,
    HardwareError,
    Instruction,
    PacketStream,
    StatusError,
    candidates,
    dynamixel_packets as packets,
    dynamixel_packets as table,
)
from softsim_core.scene import BoardDescription, BusServo

PERIOD = 0.02
IDS = (0, 1, 2, 9)
SERVOS = tuple(
    BusServo(joint=f"j{number}", id=number, sign=-1 if number % 2 else 1, pulse_min=1000, pulse_max=3000)
    for number in IDS
)
BOARD = BoardDescription(servos=SERVOS, baud_rate=1_000_000)


def write(servo_id: int, address: int, data: bytes) -> bytes:
    return packets.packet(servo_id, Instruction.WRITE, address.to_bytes(2, "little") + data)


class Conversation:
    """The protocol and the emulated bus, a packet every 20 ms of a time that only this moves."""

    def __init__(self, board: BoardDescription = BOARD) -> None:
        self.bus = DynamixelBus([servo.id for servo in board.bus_servos])
        self.protocol = DynamixelProtocol(board)
        self.now = 100.0
        self.seen: Callable[[], None] = lambda: None

    def turn(self, data: bytes) -> bool:
        """A packet, its answers, and the time until the next; whether the board was recognised."""
        self.bus.feed(data, self.now)
        decoded = self.protocol.decode(self.bus.answer(self.now))
        self.wait(PERIOD)
        return decoded.recognised

    def wait(self, duration_s: float) -> None:
        self.now += duration_s
        self.bus.advance(self.now)
        self.seen()

    def open(self, most: int = 200) -> None:
        """Ask until every servo is known."""
        for _ in range(most):
            if self.protocol.ready:
                return
            self.turn(self.protocol.ask())
            assert self.protocol.fault() == ""
        raise AssertionError("the servos do not become known")

    def take_over(self, most: int = 300) -> tuple[float, ...]:
        self.protocol.begin_takeover()
        for _ in range(most):
            if self.protocol.acknowledged():
                pose = self.protocol.pose()
                assert pose is not None
                return pose
            self.turn(self.protocol.limits())
            assert self.protocol.fault() == ""
        raise AssertionError("the pose is not taken over")

    def drive(self, angle: float, count: int = 100) -> None:
        for _ in range(count):
            self.turn(self.protocol.encode([angle] * len(self.bus.servos)).data)

    def fault(self, count: int = 200) -> str:
        """What the protocol says after so many questions, or before."""
        for _ in range(count):
            if found := self.protocol.fault():
                return found
            self.turn(self.protocol.ask())
        return ""

    def states(self) -> list[tuple[float, bool]]:
        return [(servo.position, servo.torque) for servo in self.bus.servos.values()]


def test_a_bus_of_servos_is_known_by_their_models_and_settings() -> None:
    """It has no number of its own; another kind of servos is another board."""
    identities = []
    for firmware in (45, 45, 46):
        talk = Conversation()
        assert talk.protocol.identity() is None
        talk.bus.servos[2].put(6, firmware)
        talk.open()
        identities.append(talk.protocol.identity())
    assert identities[0] == identities[1] != identities[2]


def spoil(bus: DynamixelBus, share: float, seed: int) -> None:
    bus.faults.lost = bus.faults.late = bus.faults.damaged = bus.faults.unheard = share
    bus.faults.draw = random.Random(seed)


def test_nothing_is_written_to_a_servo_before_the_pose_is_taken_over() -> None:
    talk = Conversation()
    talk.open()
    for _ in range(50):
        assert talk.protocol.decode(b"") is not None
        talk.turn(talk.protocol.ask())
    assert [servo.goals for servo in talk.bus.servos.values()] == [None] * 4
    assert not any(torque for _, torque in talk.states())


@pytest.mark.parametrize("share", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(5))
def test_torque_comes_on_where_each_servo_stands_and_nothing_moves(share: float, seed: int) -> None:
    draw, talk = random.Random(seed), Conversation()
    for servo in talk.bus.servos.values():
        servo.turn(draw.uniform(1000.0, 3000.0))
        servo.put(table.GOAL_POSITION, draw.randrange(4096))  # left over
    before = talk.bus.positions
    spoil(talk.bus, share, seed)
    talk.open()
    pose = talk.take_over()
    assert all(torque for _, torque in talk.states())
    for servo_id, position in talk.bus.positions.items():
        assert abs(position - before[servo_id]) <= DEAD_BAND
    for angle, servo in zip(pose, SERVOS, strict=True):
        stood = before[servo.id] - servo.zero_pulse
        assert angle * servo.sign * 4096 / 6.283185307179586 == pytest.approx(stood, abs=DEAD_BAND + 1)


@pytest.mark.parametrize("had_torque", [False, True])
def test_without_its_goal_no_servo_gets_torque(had_torque: bool) -> None:
    """Goals are lost on the line, and all other packets arrive: the torque has to wait."""
    talk = Conversation()
    talk.open()
    if had_torque:
        talk.take_over()
        talk.drive(0.0, 20)
        talk.bus.servos[2].power_cycle()
    talk.bus.servos[2].turn(2500)  # its goal is 2048 still
    talk.protocol.begin_takeover()
    for _ in range(50):
        talk.protocol.acknowledged()
        told = PacketStream().feed(talk.protocol.limits())
        kept = [each for each in told if int.from_bytes(each.parameters[:2], "little") != table.GOAL_POSITION]
        talk.turn(b"".join(packets.packet(each.servo_id, each.instruction, each.parameters) for each in kept))
        assert not talk.bus.servos[2].torque
    talk.take_over()
    assert talk.bus.servos[2].torque
    assert abs(talk.bus.servos[2].position - 2500) <= DEAD_BAND


def test_a_servo_that_gives_way_under_its_load_is_told_one_goal_only() -> None:
    talk = Conversation()
    talk.open()
    talk.take_over()
    sinking = talk.bus.servos[1]

    def sink() -> None:
        sinking.position -= 40.0  # as under a load, whatever its goal is

    talk.seen = sink
    sinking.goals = None
    talk.protocol.begin_takeover()
    for _ in range(30):  # as where another servo needs longer
        talk.turn(talk.protocol.limits())
    assert talk.protocol.acknowledged()
    assert sinking.goals is not None
    assert sinking.goals[0] == sinking.goals[1]


def test_goals_are_reached_and_told_back_as_measured() -> None:
    talk = Conversation()
    talk.open()
    talk.take_over()
    talk.drive(0.5)
    assert talk.bus.positions == {0: 2374, 1: 1722, 2: 2374, 9: 1722}
    assert talk.protocol.measured() == pytest.approx([0.5] * 4, abs=0.0008)
    assert talk.protocol.deviation() == ""
    values = talk.protocol.values()
    assert values["positions [pulse]"] == "2374 1722 2374 1722"
    assert (values["torque"], values["hardware errors"]) == ("on on on on", "none")
    talk.bus.servos[2].turn(2300)  # measured, not told
    talk.turn(talk.protocol.ask())
    assert talk.protocol.measured() != pytest.approx([0.5] * 4, abs=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_no_goal_outside_the_limits_is_ever_sent(seed: int) -> None:
    draw, talk = random.Random(seed), Conversation()
    spoil(talk.bus, 0.1, seed)
    talk.open()
    for _ in range(30):
        talk.take_over()
        for _ in range(draw.randrange(30)):
            angles = [draw.choice([-1e308, 1e308, draw.uniform(-7.0, 7.0)]) for _ in IDS]
            talk.turn(talk.protocol.encode(angles).data)
            if draw.random() < 0.05:
                talk.bus.servos[draw.choice(IDS)].turn(draw.uniform(-100.0, 5000.0))
            if draw.random() < 0.05:
                talk.turn(talk.protocol.hold())
    for servo in talk.bus.servos.values():
        assert servo.goals is not None
        assert 1000 <= servo.goals[0] <= servo.goals[1] <= 3000


def test_a_hold_stops_within_a_packet_and_lasts() -> None:
    talk = Conversation()
    talk.open()
    talk.take_over()
    talk.drive(0.0)
    talk.drive(1.0, 3)  # on the way, 652 pulses
    told = {each.goal for each in talk.bus.servos.values()}
    assert told == {2700, 1396}
    at = talk.bus.positions
    talk.turn(talk.protocol.hold())
    stopped = {each: servo.goal for each, servo in talk.bus.servos.items()}
    for servo_id, goal in stopped.items():  # where it stood when it was asked last, 20 ms before
        assert abs(goal - at[servo_id]) < 0.021 * 7.0 * 652
    for _ in range(100):
        talk.turn(talk.protocol.hold())
    assert {each: servo.goal for each, servo in talk.bus.servos.items()} == stopped
    assert talk.bus.positions == pytest.approx(stopped)
    pose = talk.take_over()  # as when it is cleared
    talk.turn(talk.protocol.encode(pose).data)
    assert {each: servo.goal for each, servo in talk.bus.servos.items()} == stopped


@pytest.mark.parametrize("board", [BOARD, replace(BOARD, baud_rate=57600, rate=10.0)])
def test_the_first_packet_of_a_hold_outlasts_the_answers_that_may_be_on_the_line(
    board: BoardDescription,
) -> None:
    talk = Conversation(board)
    talk.open()
    talk.take_over()
    talk.drive(1.0, 5)
    question = talk.protocol.ask()
    talk.bus.feed(question, talk.now)
    answers_s = 10.0 * len(talk.bus.answer(talk.now)) / board.baud_rate + 4 * 500e-6  # with makers' pauses
    lost = math.ceil(answers_s * board.baud_rate / 10.0)
    first = talk.protocol.hold()
    talk.turn(first[lost:])  # what went out meanwhile nobody could read
    goals = [servo.goal for servo in talk.bus.servos.values()]
    assert goals[0] < 2400  # not 2700, where they were to go
    talk.turn(talk.protocol.hold())
    assert [servo.goal for servo in talk.bus.servos.values()] == goals
    assert len(talk.protocol.hold()) < 80  # and then once a packet


@pytest.mark.parametrize("steps", range(0, 12, 2))
def test_a_hold_while_the_servos_are_made_ready_moves_none_and_gives_none_torque(steps: int) -> None:
    talk = Conversation()
    for servo_id, servo in talk.bus.servos.items():
        servo.turn(1500 + 100 * servo_id)
        servo.put(table.GOAL_POSITION, 2900)
    before = talk.bus.positions
    talk.open()
    talk.protocol.begin_takeover()
    for _ in range(steps):
        talk.protocol.acknowledged()
        talk.turn(talk.protocol.limits())
    torque = [torque for _, torque in talk.states()]
    for _ in range(30):
        talk.turn(talk.protocol.hold())
    assert [torque for _, torque in talk.states()] == torque
    assert talk.bus.positions == pytest.approx(before, abs=DEAD_BAND)


def test_a_hold_without_fresh_answers_keeps_the_goals_told() -> None:
    talk = Conversation()
    talk.open()
    talk.take_over()
    talk.bus.faults.lost = 1.0
    for step in range(10):
        talk.turn(talk.protocol.encode([0.02 * step] * 4).data)
    told = {each: servo.goal for each, servo in talk.bus.servos.items()}
    talk.turn(talk.protocol.hold())
    assert {each: servo.goal for each, servo in talk.bus.servos.items()} == told


def test_servos_stop_by_themselves_when_packets_stop_and_are_taken_over_again() -> None:
    talk = Conversation()
    talk.open()
    talk.take_over()
    slow = BoardDescription(servos=tuple(replace(each, speed=0.2) for each in SERVOS), baud_rate=1_000_000)
    talk.protocol = DynamixelProtocol(slow)
    talk.open()
    talk.take_over()
    talk.drive(1.4, 5)
    begun = talk.bus.positions
    talk.wait(0.45)
    moving = talk.bus.positions
    assert all(abs(moving[each] - begun[each]) > 20 for each in IDS)
    talk.wait(0.2)
    stopped = talk.bus.positions
    assert all(abs(stopped[each] - begun[each]) < 0.2 * 652 * 0.55 for each in IDS)
    talk.wait(5.0)
    assert talk.bus.positions == pytest.approx(stopped, abs=1.0)
    assert all(torque for _, torque in talk.states())  # they hold
    talk.drive(1.4, 20)
    assert talk.bus.positions == pytest.approx(stopped, abs=1.0)  # and take no goal
    assert "was stopped by its bus watchdog" in talk.protocol.deviation()
    pose = talk.take_over()
    assert talk.protocol.deviation() == ""
    talk.turn(talk.protocol.encode(pose).data)
    assert talk.bus.positions == pytest.approx(stopped, abs=DEAD_BAND)


def test_a_servo_that_lost_its_power_for_a_moment_is_noticed() -> None:
    talk = Conversation()
    talk.open()
    talk.take_over()
    talk.drive(0.3)
    talk.bus.servos[2].power_cycle()
    talk.drive(0.3, 20)
    assert "servo 2 (j2) has lost its torque" in talk.protocol.deviation()
    talk.take_over()
    assert talk.bus.servos[2].torque


def test_an_overload_is_a_sentence_with_what_to_do() -> None:
    talk = Conversation()
    talk.open()
    talk.take_over()
    talk.bus.servos[9].fail(HardwareError.OVERLOAD)
    assert not talk.bus.servos[9].torque
    found = talk.fault()
    assert "servo 9 (j9) has switched its torque off (overload)" in found
    assert "switch the servos' supply off and on" in found
    talk.bus.servos[9].power_cycle()
    talk.protocol = DynamixelProtocol(BOARD)
    talk.open()
    talk.take_over()


def test_a_low_supply_is_told_and_is_no_fault_by_itself() -> None:
    talk = Conversation()
    talk.open()
    talk.take_over()
    talk.bus.servos[9].fail(HardwareError.INPUT_VOLTAGE)
    assert talk.fault(20) == ""
    assert talk.protocol.values()["hardware errors"] == "9: input voltage"


@pytest.mark.parametrize(
    ("address", "value", "sentence"),
    [
        (0, 12, "is a model 12; known are XM430-W350, XM430-W210"),
        (6, 37, "has firmware 37, and 38 is needed"),
        (11, 4, "is in operating mode 4; set mode 3"),
        (10, 4, "takes profiles of time"),
        (48, 2500, "takes goals 0..2500 only, and the robot's file allows 1000..3000"),
    ],
)
def test_a_servo_that_cannot_be_driven_is_named(address: int, value: int, sentence: str) -> None:
    talk = Conversation()
    talk.bus.servos[2].put(address, value)
    found = talk.fault()
    assert found.startswith("cannot be driven: servo 2 (j2) ")
    assert sentence in found
    assert talk.bus.servos[2].goals is None


def test_servos_that_do_not_answer_are_named() -> None:
    talk = Conversation()
    talk.bus.servos[1].answers = False
    found = talk.fault()
    assert "receives nothing from servo 1 (j1) at 1000000 baud (answers come from: 0, 2, 9)" in found
    talk = Conversation()
    talk.bus.faults.lost = 1.0
    assert "(answers come from: none)" in talk.fault()


def test_one_servo_that_falls_silent_is_a_board_that_falls_silent() -> None:
    talk = Conversation()
    talk.open()
    assert any(talk.turn(talk.protocol.ask()) for _ in range(5))
    talk.bus.servos[9].answers = False  # the last of the line: all others go on
    talk.turn(talk.protocol.ask())
    assert not any(talk.turn(talk.protocol.ask()) for _ in range(50))
    talk.bus.servos[9].answers = True
    assert any(talk.turn(talk.protocol.ask()) for _ in range(5))


def test_a_servo_beyond_its_limits_gets_no_torque_before_it_is_turned_back() -> None:
    talk = Conversation()
    talk.bus.servos[0].turn(3200)
    talk.open()
    talk.protocol.begin_takeover()
    for _ in range(20):
        talk.turn(talk.protocol.limits())
    assert "servo 0 (j0) is at pulse 3200, outside 1000..3000; it has no torque" in talk.protocol.fault()
    assert not talk.bus.servos[0].torque
    talk.bus.servos[0].turn(2990)
    talk.protocol = DynamixelProtocol(BOARD)
    talk.open()
    talk.take_over()
    assert abs(talk.bus.servos[0].position - 2990) <= DEAD_BAND


def test_relaxing_switches_the_torque_off() -> None:
    talk = Conversation()
    talk.open()
    talk.take_over()
    talk.turn(talk.protocol.relax())
    assert not any(torque for _, torque in talk.states())


def test_a_line_too_slow_for_the_rate_is_refused_with_numbers() -> None:
    slow = replace(BOARD, baud_rate=57600)
    with pytest.raises(ProtocolError, match=r"4 servos at 57600 baud need .* 50 Hz leave 16\.0 ms"):
        candidates(AUTO, slow)
    assert candidates(AUTO, replace(slow, rate=10.0)) == (DynamixelProtocol,)


def answered(bus: DynamixelBus, data: bytes) -> list[tuple[int, bytes]]:
    bus.feed(data, 1.0)
    return [(each.error, each.parameters) for each in PacketStream().feed(bus.answer(1.0))]


def test_an_emulated_servo_refuses_what_a_real_one_refuses() -> None:
    bus = DynamixelBus([3])
    servo = bus.servos[3]
    for address, data, error in (
        (132, table.four(1), StatusError.ACCESS),  # only measured
        (60, b"\x01", StatusError.ACCESS),  # not defined
        (116, b"\x01\x00", StatusError.DATA_LENGTH),
        (116, table.four(4096), StatusError.DATA_RANGE),
        (64, b"\x02", StatusError.DATA_RANGE),
    ):
        assert answered(bus, write(3, address, data)) == [(error, b"")]
    assert answered(bus, write(3, 48, table.four(2500))) == [(0, b"")]
    assert answered(bus, write(3, 116, table.four(2501))) == [(StatusError.DATA_LIMIT, b"")]
    assert answered(bus, write(3, 64, b"\x01")) == [(0, b"")]
    assert answered(bus, write(3, 11, b"\x03")) == [(StatusError.ACCESS, b"")]  # with torque
    assert answered(bus, packets.packet(3, 0x77)) == [(StatusError.INSTRUCTION, b"")]
    servo.fail(HardwareError.OVERLOAD)
    assert answered(bus, packets.ping(3)) == [(0x80, bytes([6, 4, 45]))]
    assert answered(bus, write(3, 64, b"\x01")) == [(0x80 | StatusError.RESULT_FAIL, b"")]
    assert answered(bus, packets.packet(3, 0x08)) == [(0, b"")]  # reboot
    assert answered(bus, write(3, 64, b"\x01")) == [(0, b"")]
    assert answered(bus, packets.ping(4)) == []


def test_behind_a_servo_that_is_missing_none_answers() -> None:
    bus = DynamixelBus([1, 2, 3])
    bus.servos[2].answers = False
    bus.feed(packets.packet(254, Instruction.SYNC_READ, bytes([132, 0, 4, 0, 1, 2, 3])), 1.0)
    assert [each.servo_id for each in PacketStream().feed(bus.answer(1.0))] == [1]


@pytest.mark.parametrize("profile", [0, 40])
def test_an_emulated_servo_moves_by_its_profile(profile: int) -> None:
    servo = EmulatedServo(1)
    servo.write(112, table.four(profile))
    servo.write(64, b"\x01")
    servo.write(116, table.four(4000))
    speed = (profile or 330) * 0.229 * 4096 / 60.0  # pulses a second
    for step in range(1, 11):
        servo.advance(0.02 * step, 0.02)
        assert 0.7 * speed * 0.02 * (step - 2) <= servo.position - 2048 <= speed * 0.02 * step + 1e-6
    servo.advance(100.0, 5.0)
    assert servo.position == 4000


def test_the_makers_library_drives_the_emulated_bus(tmp_path: Path) -> None:
    sdk = pytest.importorskip("dynamixel_sdk", reason="the makers' library is no part of the install")

    class PatientPort(sdk.PortHandler):  # type: ignore[misc, name-defined]
        """Their port, on a machine that may be busy."""

        def isPacketTimeout(self) -> bool:  # noqa: N802
            return bool(self.getCurrentTime() - self.packet_start_time > 60_000.0)

    with VirtualBoard([BusServo(joint="a", id=1), BusServo(joint="b", id=5)], tmp_path / "bus") as board:
        port, makers = PatientPort(board.port), sdk.PacketHandler(2.0)
        assert port.setBaudRate(1_000_000)
        assert board.wait_for(lambda b: b.is_open)
        assert makers.ping(port, 5) == (1030, 0, 0)
        assert makers.write1ByteTxRx(port, 5, 64, 1) == (0, 0)
        assert makers.write4ByteTxRx(port, 5, 116, 5000) == (0, StatusError.DATA_RANGE)
        write = sdk.GroupSyncWrite(port, makers, 116, 4)
        for servo_id, goal in ((1, 2048), (5, 2300)):
            assert write.addParam(servo_id, list(table.four(goal)))
        assert write.txPacket() == 0
        assert board.wait_for(lambda b: b.servo_bytes == (2048, 2300))
        assert board.wait_for(lambda b: b.model.positions == {1: 2048, 5: 2300})
        for read in (sdk.GroupSyncRead(port, makers, 132, 4), sdk.GroupBulkRead(port, makers)):
            for servo_id in (1, 5):
                assert read.addParam(servo_id, *((132, 4) if isinstance(read, sdk.GroupBulkRead) else ()))
            assert read.txRxPacket() == 0
            assert [read.getData(servo_id, 132, 4) for servo_id in (1, 5)] == [2048, 2300]
        port.closePort()
