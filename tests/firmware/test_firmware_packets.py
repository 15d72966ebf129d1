"""What the firmware accepts and refuses, held against the Python parsers on the same bytes."""

from __future__ import annotations

import itertools
import random
from dataclasses import dataclass, field

import pytest
from firmware_line import SLEW_US, TOLERANCE_US, heard, ideal, legacy, widths_by_frame

from servo_bridge.driver import byte_to_width
from servo_bridge.emulator import EmulatedBoard
from servo_bridge.protocols import Frame, FrameParser, FrameType, PacketParser, encode, frames, join12

FIRST_TYPE_OF_THE_BOARD = 16
NARROWEST_US, WIDEST_US = 544, 2400
COUNTER = 4096
"""Counters of the telemetry run modulo this."""


@dataclass
class Model:
    """The board's parser in Python: what it acknowledges, counts, and which pose it was told last.

    Within half a second of a frame legacy packets are refused: one flipped bit makes one of a frame. So are
    those that come while a HOLD lasts.
    """

    packets: PacketParser = field(default_factory=PacketParser)
    frames: FrameParser = field(default_factory=FrameParser)
    refused: int = 0
    framed: bool = False
    held: bool = False
    seq: int = 0
    pose_us: tuple[float, ...] | None = None

    @property
    def rejects(self) -> int:
        return (self.packets.dropped + self.frames.dropped + self.refused) % COUNTER

    def feed(self, data: bytes) -> None:
        for value in data:
            for packet in self.packets.feed(bytes([value]), 0.0):
                if self.framed or self.held:
                    self.refused += 1
                else:
                    self.pose_us = tuple(map(byte_to_width, packet))
            for frame in self.frames.feed(bytes([value])):
                self.take(frame)

    def take(self, frame: Frame) -> None:
        numbers = join12(frame.payload) if frame.kind < FIRST_TYPE_OF_THE_BOARD else ()
        allowed = frame.kind < FIRST_TYPE_OF_THE_BOARD
        if frame.kind in (FrameType.SET, FrameType.SET_LIMITS):
            allowed = all(NARROWEST_US <= width <= WIDEST_US for width in numbers)
        if frame.kind is FrameType.SET_LIMITS:
            threes = zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True)
            allowed &= all(least <= rest <= largest for least, rest, largest in threes)
        if frame.kind is FrameType.SLEW:
            allowed = 1 <= numbers[0] <= 124
        if not allowed:
            self.refused += 1
            return
        self.seq, self.framed = frame.seq, True
        self.held = frame.kind is FrameType.HOLD or (self.held and frame.kind is not FrameType.SET)
        if frame.kind is FrameType.SET:
            self.pose_us = tuple(map(float, numbers))


def agree(board: EmulatedBoard, model: Model, data: bytes) -> None:
    """Feed both, let the board come to rest, and compare acknowledgement, counters and pose."""
    data += b"\x00"  # drops what is not complete
    model.framed = False
    model.feed(data)
    board.feed(data)
    board.run(len(data) * 1389 / 16e6 + 0.54)  # the longest way takes 21 frames; silence holds after 25
    said = heard(board)
    assert (said.seq, said.rejects, said.overruns) == (model.seq, model.rejects, 0)
    widths = board.widths_us()
    assert (widths is None) == (model.pose_us is None)
    assert widths is None or widths == pytest.approx(model.pose_us, abs=TOLERANCE_US)


def bounded(board: EmulatedBoard) -> None:
    """No pulse outside the limits, none faster than the slew limit, no reset."""
    assert board.resets == 1
    for channel in range(3):
        widths = widths_by_frame(board, channel)
        assert min(widths) > NARROWEST_US - TOLERANCE_US
        assert max(widths) < WIDEST_US + TOLERANCE_US
        assert max(abs(b - a) for a, b in itertools.pairwise(widths)) < SLEW_US


@pytest.mark.parametrize(
    ("data", "accepted"),
    [
        (frames.set_widths(5, [544, 1500, 2400]), True),
        (frames.set_widths(5, [543, 1500, 2400]), False),
        (frames.set_widths(5, [544, 1500, 2401]), False),
        (frames.set_widths(5, [0, 0, 0]), False),
        (frames.ping(5), True),
        (frames.hold(5), True),
        (frames.relax(5), True),
        (frames.slew(5, 1), True),
        (frames.slew(5, 0), False),
        (frames.slew(5, 125), False),
        (frames.set_limits(5, [(544, 1500, 2400)] * 3), True),
        (frames.set_limits(5, [(1500, 1500, 1500)] * 3), True),
        (frames.set_limits(5, [(544, 544, 2400), (1500, 1499, 1501), (544, 544, 2400)]), False),
        (frames.set_limits(5, [(544, 544, 2400), (544, 1501, 1500), (544, 544, 2400)]), False),
        (frames.set_limits(5, [(543, 1500, 2400)] * 3), False),
        (frames.ping(5)[:-1], False),
        (frames.ping(5)[1:], False),
        (frames.set_widths(5, [1500] * 3)[:-2] + b"\x80\x80", False),
        (frames.ping(5)[:3] + b"\x80" + frames.ping(5)[3:], False),
        (frames.identify(5), True),
        (frames.identify(5, 12345), True),
        (bytes([0xFE, 0x80 | 8, 0x85, 0x80, 0x80]), False),
        (encode(Frame(FrameType.BANNER, 5, (1, 1, 0, 1))), False),
        (frames.ping(5)[:2] + frames.ping(5), True),
        (legacy(90, 90) + frames.ping(5), True),
        (frames.ping(5)[:2] + legacy(90, 90, 90), False),
    ],
)
def test_frames_accepted_and_refused(board: EmulatedBoard, data: bytes, accepted: bool) -> None:
    model = Model()
    agree(board, model, data)
    assert (model.seq == 5) is accepted


def test_every_sequence_number_is_acknowledged(board: EmulatedBoard) -> None:
    for seq in [*range(1, 64), 0]:
        board.feed(frames.ping(seq))
        board.run(0.001)
        assert heard(board).seq == seq


def test_every_flipped_bit_of_a_frame_is_noticed(board: EmulatedBoard) -> None:
    """In a stream of frames, where the header's flipped bit must not make a legacy packet, either."""
    frame = frames.set_widths(9, [1500, 1600, 1700])
    model = Model()
    for place in range(8 * len(frame)):
        damaged = bytearray(frame)
        damaged[place // 8] ^= 1 << place % 8
        agree(board, model, frames.ping(1) + damaged)
    assert (model.seq, model.pose_us) == (1, None)
    assert model.packets.accepted == 1  # the flipped header's, which both refuse


def test_a_packet_older_than_40_ms_is_dropped(board: EmulatedBoard) -> None:
    for gap, pose in ((0.038, ideal(90, 120, 150)), (0.042, ideal(90, 120, 150))):
        board.feed(legacy(*((90, 120) if gap < 0.04 else (60, 60))))
        board.run(gap)
        board.feed(bytes([150]))
        board.run(0.1)
        assert board.widths_us() == pytest.approx(pose, abs=TOLERANCE_US)
    assert heard(board).rejects == 1


def test_banner_then_telemetry_at_20_hz(board: EmulatedBoard) -> None:
    board.run(10.0)
    parsed = FrameParser().feed(board.transmitted)
    banner = frames.Banner(frames.PROTOCOL_VERSION, *frames.FIRMWARE_VERSION, 1)
    assert frames.read_banner(parsed[0]) == banner
    assert {frame.kind for frame in parsed[1:]} == {FrameType.TELEMETRY}
    assert 199 <= len(parsed[1:]) <= 201
    assert [frame.seq for frame in parsed] == [index % 64 for index in range(len(parsed))]
    assert not frames.read_telemetry(parsed[-1]).flags


def number(board: EmulatedBoard, frame: bytes) -> int:
    """What the board answers to an IDENTIFY."""
    board.take_transmitted()
    board.feed(frame)
    board.run(0.3)
    answers = [each for each in FrameParser().feed(board.transmitted) if each.kind is FrameType.IDENTITY]
    return frames.read_number(answers[0])


def test_a_number_is_taken_once_and_kept_for_good_and_moves_nothing(board: EmulatedBoard) -> None:
    assert number(board, frames.identify(1)) == frames.NO_IDENTITY
    assert number(board, frames.identify(2, 0x0123456789AB)) == 0x0123456789AB
    board.feed(frames.identify(3, 1))
    board.power_cycle()
    board.run(0.01)
    assert number(board, frames.identify(4, 2)) == 0x0123456789AB
    assert board.widths_us() is None


def test_the_number_is_said_once_it_is_kept(board: EmulatedBoard) -> None:
    board.feed(frames.identify(1, 77))
    board.run(0.1)
    assert FrameType.IDENTITY not in {each.kind for each in FrameParser().feed(board.transmitted)}
    board.power_cycle()  # amid the writing: another number, which nobody has heard
    board.run(0.01)
    assert number(board, frames.identify(1)) not in (77, frames.NO_IDENTITY)


def test_pulses_keep_their_widths_while_a_number_is_written(board: EmulatedBoard) -> None:
    board.feed(frames.set_widths(1, [1001, 1502, 2003]))
    board.settle()
    board.clear()
    assert number(board, frames.identify(1, 77)) == 77
    widths = {(pulse.channel, round(pulse.width_us)) for pulse in board.pulses}
    assert widths == {(0, 1001), (1, 1502), (2, 2003)}


def test_telemetry_tells_the_widths_on_the_pins(board: EmulatedBoard) -> None:
    for _ in range(40):
        board.feed(frames.set_widths(1, [1001, 1502, 2003]))
        board.run(0.02)
        said = heard(board)
    assert said.widths_us == (1001, 1502, 2003)
    assert board.widths_us() == pytest.approx(said.widths_us, abs=TOLERANCE_US)


@pytest.mark.slow
@pytest.mark.parametrize("pieces", [500, pytest.param(5000, marks=pytest.mark.exhaustive)])
def test_fuzzed_bytes(board: EmulatedBoard, pieces: int) -> None:
    """Uniform bytes, and those that mean something, so that whole packets come about; 200 in a piece."""
    draw = random.Random(6)
    alphabet = [255, 255, 254, 0x81, 0x84, 60, 90, 120, 150, 180, *range(0x80, 0xC0, 7)]
    model = Model()
    for index in range(pieces):
        if index % 2:
            data = draw.randbytes(200)
        else:
            data = bytes(draw.choice(alphabet) for _ in range(200))
        agree(board, model, data)
    assert model.packets.accepted > 500
    assert model.packets.dropped + model.frames.dropped > 5_000
    bounded(board)


def mutated(draw: random.Random, packet: bytes) -> bytes:
    """The packet with a byte changed, lost, doubled, inserted, a bit flipped, an end cut off; or as it is."""
    data = bytearray(packet)
    place = draw.randrange(len(data))
    match draw.randrange(7):
        case 0:
            data[place] = draw.randrange(256)
        case 1:
            del data[place]
        case 2:
            data.insert(place, data[place])
        case 3:
            data.insert(place, draw.randrange(256))
        case 4:
            data[place] ^= 1 << draw.randrange(8)
        case 5:
            del data[place:]
    return bytes(data)


@pytest.mark.slow
def test_mutated_packets(board: EmulatedBoard) -> None:
    """10 000 packets and frames, most of them damaged."""
    draw = random.Random(7)
    model = Model()
    for _ in range(500):
        data = bytearray()
        for _ in range(20):
            pose = [draw.randrange(60, 181) for _ in range(3)]
            widths = [draw.randrange(1163, 2401) for _ in range(3)]
            seq = draw.randrange(64)
            kinds = (legacy(*pose), frames.set_widths(seq, widths), frames.ping(seq))
            data += mutated(draw, draw.choice(kinds))
        agree(board, model, bytes(data))
    assert model.packets.accepted > 1000
    assert model.frames.accepted > 1000
    bounded(board)


@pytest.mark.slow
def test_mutated_settings_never_pass_the_limits(board: EmulatedBoard) -> None:
    """All types of frames, damaged or not, with allowed and forbidden values."""
    draw = random.Random(8)
    model = Model()
    for _ in range(2000):
        widths = [draw.randrange(4096) for _ in range(6)]
        within = sorted(draw.randrange(500, 2450) for _ in range(6))
        seq = draw.randrange(64)
        kinds = (
            frames.set_widths(seq, draw.choice([widths, within])[:3]),
            frames.set_limits(seq, [(within[side], within[side + 1], within[side + 3]) for side in range(3)]),
            frames.slew(seq, draw.randrange(1, 70)),
            frames.slew(seq, draw.randrange(4096)),
            frames.hold(seq),
            frames.relax(seq),
            frames.ping(seq),
        )
        data = mutated(draw, draw.choice(kinds)) + b"\x00"
        model.feed(data)
        board.feed(data)
        board.run(draw.choice([0.003, 0.02, 0.1]))
    said = heard(board)
    assert (said.seq, said.rejects, said.overruns) == (model.seq, model.rejects, 0)
    assert board.resets == 1
    assert board.pulses
    for pulse in board.pulses:
        assert NARROWEST_US - TOLERANCE_US < pulse.width_us < WIDEST_US + TOLERANCE_US
