"""Every registered protocol of a board: round trip, refusals, noise, detection; and who may name one."""

from __future__ import annotations

import ast
import math
import random
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from servo_bridge import PortError, ProtocolError
from servo_bridge.driver import BoardLink, ServoDriver, angle_to_pulse, byte_to_angle, pulse_to_angle
from servo_bridge.protocols import (
    AUTO,
    Ability,
    BoardModel,
    BoardProtocol,
    Decoded,
    EncodedPacket,
    candidates,
    model_of_board,
    names,
    protocol_named,
    register,
)
from softsim_core.base import CommandError, SceneError
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import (
    BoardDescription,
    BusServo,
    JointDescription,
    RobotDescription,
    SceneDescription,
    Servo,
    ServoCalibration,
    load_scene,
)

REPOSITORY = Path(__file__).resolve().parents[2]
MIXED = (
    ServoCalibration(joint="a"),
    ServoCalibration(joint="b", sign=-1, zero_byte=61, trim_deg=2.5),
    ServoCalibration(joint="c", byte_min=80, byte_max=100, rest_byte=90),
)
BOARD = BoardDescription(servos=MIXED)
ON_A_BUS = (
    BusServo(joint="a", id=0),
    BusServo(joint="b", id=7, sign=-1, zero_pulse=1000, pulse_min=900, pulse_max=3000),
    BusServo(joint="c", id=252, zero_pulse=2100, pulse_min=2000, pulse_max=2200),
)
BUS = BoardDescription(servos=ON_A_BUS, baud_rate=1_000_000)
DEGREE = math.pi / 180.0

BUILT_IN = {"ascii_imu", "dynamixel", "extended", "legacy"}
EVERY = tuple(sorted({*BUILT_IN, "my_board"}))


@pytest.fixture(autouse=True)
def my_board() -> None:
    load_scene(REPOSITORY / "examples" / "my_board.py")  # registers one more, as a robot's file does


@pytest.fixture(params=EVERY)
def protocol(request: pytest.FixtureRequest) -> BoardProtocol:
    """A conversation in every protocol."""
    return conversation(request.param)


def board_of(name: str) -> BoardDescription:
    """A board of servos that a protocol drives."""
    return BUS if protocol_named(name).drives is BusServo else BOARD


def conversation(name: str) -> BoardProtocol:
    return protocol_named(name)(board_of(name))


def model_of(name: str) -> BoardModel:
    return model_of_board(name, board_of(name).servos)


def number_range(servo: Servo) -> tuple[int, int]:
    """Degrees or pulses that a servo may be sent to."""
    if isinstance(servo, BusServo):
        return servo.pulse_min, servo.pulse_max
    return servo.byte_min, servo.byte_max


def nominal(number: int, servo: Servo) -> float:
    return pulse_to_angle(number, servo) if isinstance(servo, BusServo) else byte_to_angle(number, servo)


def targets(draw: random.Random, servos: Sequence[Servo]) -> list[float]:
    """Angles in [rad] within the servos' ranges, some of them at the ends."""
    ends = [sorted(nominal(end, each) for end in number_range(each)) for each in servos]
    return [draw.choice([low, high, draw.uniform(low, high)]) for low, high in ends]


def said_by(name: str, seconds: float = 1.0) -> bytes:
    """What a model of the protocol's board says, asked and driven or not, in so much time."""
    model, writer = model_of(name), conversation(name)
    model.reset(2)
    said, now = b"", 10.0
    while now < 10.0 + seconds:
        model.feed(writer.encode([-1.0, 1.0, -1.5]).data + writer.ask(), now)
        heard = model.answer(now) + (model.say(now) if model.say_period_s else b"")
        writer.decode(heard)
        said += heard
        now += 0.05
    return said


def test_every_protocol_is_listed() -> None:
    assert set(names()) == set(EVERY)
    assert {each.name for board in (BOARD, BUS) for each in candidates(AUTO, board)} <= BUILT_IN
    assert [each.name for each in candidates(AUTO, BUS)] == ["dynamixel"]


def test_random_targets_arrive_as_they_were_meant(protocol: BoardProtocol) -> None:
    draw, model, servos = random.Random(5), model_of(protocol.name), board_of(protocol.name).servos
    for step in range(400):
        angles = targets(draw, servos)
        packet = protocol.encode(angles)
        assert model.feed(packet.data, step * 0.02) == [packet.servo_bytes]
        for told, wanted, servo in zip(packet.angles_rad, angles, servos, strict=True):
            assert abs(told - wanted) <= (2.0 if packet.avoided else 1.0) * DEGREE + 1e-9
            if isinstance(servo, BusServo):
                assert servo.pulse_min <= angle_to_pulse(told, servo) <= servo.pulse_max
                continue
            assert servo.byte_min <= round(servo.sign * told / DEGREE + servo.trim_deg) + servo.zero_byte
            assert round(servo.sign * told / DEGREE + servo.trim_deg) + servo.zero_byte <= servo.byte_max
    assert (model.accepted, model.dropped) == (400, 0)


def test_targets_beyond_the_servos_are_clipped_to_them(protocol: BoardProtocol) -> None:
    for angle in (-1e308, -9.0, 9.0, 1e308):
        servos = board_of(protocol.name).servos
        for number, servo in zip(protocol.encode([angle] * 3).servo_bytes, servos, strict=True):
            assert number_range(servo)[0] <= number <= number_range(servo)[1]


@pytest.mark.parametrize(
    "bad", [[math.nan, -1.0, -1.0], [-1.0, -1.0, math.inf], [-math.inf] * 3, [], [-1.0] * 2, [-1.0] * 4]
)
def test_a_pose_that_is_none_is_refused_before_it_is_encoded(
    protocol: BoardProtocol, bad: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    encoded: list[object] = []
    monkeypatch.setattr(protocol, "encode_pose", encoded.append)
    with pytest.raises(CommandError, match="refused"):
        protocol.encode(bad)
    for beyond in ([-1.0, -1.0, -0.02], [-2.03, -1.0, -1.0]):
        with pytest.raises(CommandError, match=r"refused: allowed is \[-2.0225, -0.0255\]"):
            protocol.encode(beyond, [JointLimits(-2.0225, -0.0255)] * 3)
    with pytest.raises(ValueError, match="shorter"):  # as many limits as servos, or none
        protocol.encode([-1.0] * 3, [JointLimits()] * 2)
    assert not encoded


def test_noise_and_damaged_packets_are_no_error_and_no_board(protocol: BoardProtocol) -> None:
    draw = random.Random(6)
    own = said_by(protocol.name) + protocol.encode([-1.0, 1.0, -1.5]).data
    for _ in range(300):
        assert not protocol.decode(draw.randbytes(draw.randrange(60))).recognised
    for _ in range(300):
        cut = bytearray(own[draw.randrange(len(own)) :][: draw.randrange(40)])
        if cut:
            cut[draw.randrange(len(cut))] ^= 1 << draw.randrange(8)
        for reading in protocol.decode(bytes(cut)).tilts:
            assert max(abs(reading.tilt_x), abs(reading.tilt_y)) <= 2.0 * math.pi
    assert isinstance(dict(protocol.values()), dict)


def test_a_model_takes_no_pose_from_noise_beyond_its_servos(protocol: BoardProtocol) -> None:
    draw, model = random.Random(7), model_of(protocol.name)
    for step in range(300):
        packet = bytearray(protocol.encode(targets(draw, board_of(protocol.name).servos)).data)
        packet[draw.randrange(len(packet))] ^= 1 << draw.randrange(8)
        poses = model.feed(bytes(packet[: draw.randrange(len(packet) + 1)]), step * 0.1)
        assert all(0 <= number <= model.largest for pose in poses for number in pose)
    assert model.accepted < 300


@pytest.mark.parametrize("speaker", EVERY)
def test_a_board_is_recognised_by_its_own_protocol_only(speaker: str) -> None:
    said = said_by(speaker)
    for name in EVERY:
        other = conversation(name)
        heard = [other.decode(said[at : at + 3]) for at in range(0, len(said), 3)]
        detects = Ability.DETECT in other.abilities
        assert any(each.recognised for each in heard) == (name == speaker and detects)


@pytest.mark.parametrize("speaker", EVERY)
def test_auto_finds_every_built_in_board_that_says_what_it_is(speaker: str) -> None:
    board = board_of(speaker)
    link = BoardLink("/dev/board", [each(board) for each in candidates(AUTO, board)], 2.5, 10.0)
    link.receive(said_by(speaker), 11.0)
    detected = speaker in BUILT_IN and Ability.DETECT in protocol_named(speaker).abilities
    assert link.state(11.0) == (speaker if detected else "waiting")
    link.receive(b"", 11.1)
    assert link.state(12.6) == (speaker if detected else "legacy")


@pytest.mark.parametrize("name", sorted({*EVERY} - {"dynamixel"}))  # its servos are of another kind
def test_bytes_of_the_boot_loader_and_of_headers_are_not_sent(name: str) -> None:
    draw, protocol = random.Random(8), conversation(name)
    packets = [protocol.encode(targets(draw, MIXED)).data for _ in range(300)]
    packets += [protocol.encode([byte_to_angle(100, servo) for servo in MIXED]).data]
    for packet in packets:
        assert 100 not in packet
        assert not any(header in packet[1:] for header in (0xFE, 0xFF))


def test_a_robot_s_board_settings_name_its_protocol() -> None:
    robot = load_scene(REPOSITORY / "examples" / "my_board.py")
    assert ServoDriver(robot).protocol == "my_board"
    assert ServoDriver(robot, protocol="legacy").protocol == "legacy"
    named = load_scene("tripod", {"board": {"protocol": "legacy"}})
    assert ServoDriver(named).protocol == "legacy"
    assert ServoDriver(load_scene("tripod")).protocol == AUTO


def test_an_unknown_protocol_is_a_sentence_with_the_known_ones() -> None:
    with pytest.raises(SceneError, match=r"no board protocol is named 'morse'; known: auto, ascii_imu"):
        ServoDriver(robot_of("morse"))
    with pytest.raises(ProtocolError, match="has no model of a board with 2 servos"):
        model_of_board("extended", MIXED[:2])
    with pytest.raises(ProtocolError, match="has no model of a board with 3 servos"):
        model_of_board("dynamixel", MIXED)
    with pytest.raises(
        ProtocolError, match="legacy protocol drives hobby servos, which have no id, and a is"
    ):
        candidates("legacy", BUS)
    with pytest.raises(ProtocolError, match="dynamixel protocol drives servos on a bus, which have an id"):
        candidates("dynamixel", BOARD)


def robot_of(protocol: str) -> RobotDescription:
    """A robot with one servo, whose board speaks a protocol."""
    joint = JointDescription(name="a", limits=JointLimits(-1.5, -0.1, 2.0))
    board = BoardDescription(servos=(ServoCalibration(joint="a"),), protocol=protocol)
    return RobotDescription(scene=SceneDescription(name="robot", joints=(joint,)), board=board)


class Minimal(BoardProtocol):
    """The least that a protocol defines."""

    name = "minimal"

    def encode_pose(self, angles_rad: object) -> EncodedPacket:
        return EncodedPacket(b"x", (90,), (0.0,))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"name": "legacy"}, "the name legacy is taken by LegacyProtocol"),
        ({"name": "auto"}, "name 'auto' cannot be used"),
        ({"name": "My board"}, "cannot be used; give small letters"),
        ({"abilities": Ability.TELEMETRY}, "TELEMETRY needs DETECT"),
        ({"abilities": Ability.HOLD}, "has the ability HOLD and no method hold"),
        ({"encode_pose": BoardProtocol.encode_pose}, "does not define encode_pose"),
    ],
)
def test_a_class_that_is_not_whole_is_refused(change: dict[str, object], sentence: str) -> None:
    with pytest.raises(ProtocolError, match=re.escape(sentence)):
        register(type("Mine", (Minimal,), change))
    with pytest.raises(ProtocolError, match="is no board protocol"):
        register(object)  # type: ignore[type-var]


def test_a_file_that_is_loaded_anew_registers_anew() -> None:
    former, before = protocol_named("my_board"), names()
    load_scene(REPOSITORY / "examples" / "my_board.py")
    assert protocol_named("my_board") is not former
    assert names() == before


@pytest.mark.parametrize("broken", ["decode", "ready", "fault"])
def test_a_protocol_that_fails_is_a_failed_port(broken: str) -> None:
    def fail(*arguments: object) -> Decoded:
        raise ZeroDivisionError("oh")

    body: dict[str, Callable[..., object] | property | object] = {
        broken: property(fail) if broken == "ready" else fail,
        "abilities": Ability.DETECT,
    }
    if broken != "decode":
        body["decode"] = lambda self, data: Decoded(recognised=True)
    link = BoardLink("/dev/board", [type("Mine", (Minimal,), body)(BOARD)], 0.0, 10.0)

    def look() -> None:
        link.receive(b"", 10.1)
        link.state(10.1)
        link.check(10.1)

    with pytest.raises(PortError, match=r"minimal failed on /dev/board \(ZeroDivisionError: oh\)"):
        look()


def sources() -> Iterator[Path]:
    """Code that must not know one protocol from another: the bridge outside its protocols, and the suite."""
    for package in ("servo_bridge", "softsim_ros", "softsim_core"):
        for file in sorted((REPOSITORY / package).rglob("*.py")):
            if (REPOSITORY / "servo_bridge" / "protocols") not in file.parents:
                yield file


@pytest.mark.slow
def test_nothing_outside_the_protocols_names_one() -> None:
    seen = 0
    for file in sources():
        seen += 1
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant):
                assert node.value not in EVERY, f"{file}, line {node.lineno}: names {node.value}"
            elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("servo_bridge.protoc"):
                assert node.module == "servo_bridge.protocols", f"{file}, line {node.lineno}: {node.module}"
    assert seen > 100
