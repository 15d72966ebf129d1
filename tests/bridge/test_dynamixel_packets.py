"""Dynamixel protocol 2.0: the published examples, CRC, stuffing, noise; the makers' library as oracle."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest
from hypothesis import given, strategies as st

from servo_bridge import PacketError
from servo_bridge.protocols import (
    Instruction,
    Packet,
    PacketStream,
    crc16,
    dynamixel_packets,
    dynamixel_packets as packets,
)


def read(servo_id: int, address: int, size: int) -> bytes:
    return packets.packet(servo_id, Instruction.READ, struct.pack("<HH", address, size))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    return packets.packet(servo_id, Instruction.WRITE, struct.pack("<H", address) + data)


# The e-Manual's examples of protocol 2.0, section "Instruction Details"
EXAMPLES = [
    (packets.ping(1), "FF FF FD 00 01 03 00 01 19 4E"),
    (packets.ping(254), "FF FF FD 00 FE 03 00 01 31 42"),
    (read(1, 132, 4), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    (
        write(1, 116, (512).to_bytes(4, "little")),
        "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
    ),
    (packets.packet(1, Instruction.REBOOT), "FF FF FD 00 01 03 00 08 2F 4E"),
    (
        packets.packet(254, Instruction.SYNC_READ, bytes([132, 0, 4, 0, 1, 2])),
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
    ),
    (
        packets.sync_write(116, {1: bytes([150, 0, 0, 0]), 2: bytes([170, 0, 0, 0])}),
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
    ),
    (
        packets.bulk_read({1: (144, 2), 2: (146, 1)}),
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
    ),
]
ANSWERS = [
    ("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D", Packet(1, 0x55, bytes([6, 4, 38]))),
    ("FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D", Packet(2, 0x55, bytes([6, 4, 38]))),
    ("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0", Packet(1, 0x55, bytes([166, 0, 0, 0]))),
    ("FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE", Packet(2, 0x55, bytes([0x1F, 8, 0, 0]))),
    ("FF FF FD 00 01 04 00 55 00 A1 0C", Packet(1, 0x55)),
    ("FF FF FD 00 01 06 00 55 00 77 00 C3 69", Packet(1, 0x55, bytes([119, 0]))),
    ("FF FF FD 00 02 05 00 55 00 24 8B A9", Packet(2, 0x55, bytes([36]))),
]
AWKWARD = st.lists(st.sampled_from([0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55, 0x01]), max_size=40).map(bytes)


def crc_bit_by_bit(data: bytes) -> int:
    """Remainder of the message, as a polynomial over GF(2), by x^16 + x^15 + x^2 + 1: long division."""
    number, divisor = int.from_bytes(data, "big") << 16, 0x18005
    while number.bit_length() > 16:
        number ^= divisor << (number.bit_length() - 17)
    return number


@pytest.mark.parametrize(("made", "published"), EXAMPLES)
def test_the_published_instructions_are_made_byte_by_byte(made: bytes, published: str) -> None:
    assert made == bytes.fromhex(published)
    assert len(PacketStream().feed(made)) == 1


@pytest.mark.parametrize(("published", "read"), ANSWERS)
def test_the_published_answers_are_read(published: str, read: Packet) -> None:
    assert PacketStream().feed(bytes.fromhex(published)) == [read]
    assert packets.status(read.servo_id, read.parameters) == bytes.fromhex(published)


@given(st.binary(max_size=200))
def test_the_crc_is_the_remainder_of_a_long_division(data: bytes) -> None:
    assert crc16(data) == crc_bit_by_bit(data)


@given(AWKWARD, st.integers(0, 252), st.integers(0, 255), st.integers(1, 7))
def test_what_looks_like_a_header_is_stuffed_and_comes_back(
    body: bytes, servo_id: int, error: int, step: int
) -> None:
    data = packets.status(servo_id, body, error)
    assert data[4:-2].find(dynamixel_packets.HEADER) < 0
    stream = PacketStream()
    found = [each for at in range(0, len(data), step) for each in stream.feed(data[at : at + step])]
    assert found == [Packet(servo_id, Instruction.STATUS, body, error)]
    assert stream.damaged == 0


def test_no_flipped_bit_and_no_cut_goes_through() -> None:
    data = packets.status(3, bytes([0xFF, 0xFF, 0xFD, 1, 2, 3]))
    for bit in range(8 * len(data)):
        spoilt = bytearray(data)
        spoilt[bit // 8] ^= 1 << bit % 8
        assert PacketStream().feed(bytes(spoilt)) == []
    for cut in range(len(data)):
        assert PacketStream().feed(data[:cut]) == []


def test_a_hundred_thousand_bytes_of_noise_raise_nothing_and_hide_no_packet_behind_them() -> None:
    draw, stream, found, pieces, noise = random.Random(13), PacketStream(), 0, 0, 0
    wanted = Packet(7, Instruction.STATUS, bytes(range(10)))
    whole = packets.status(7, wanted.parameters)
    while noise < 100_000:
        kind = draw.randrange(4)
        junk = draw.randbytes(draw.randrange(1, 60))
        if kind == 1:
            junk = dynamixel_packets.HEADER + junk  # begins as a packet
        elif kind == 2:
            junk = whole[: draw.randrange(1, len(whole))]  # a packet cut short
        elif kind == 3:
            junk = bytes(draw.choice((0xFF, 0xFD, 0x00)) for _ in junk)
        noise, pieces = noise + len(junk), pieces + 1
        data = junk + 60 * whole if pieces % 50 == 0 else junk + whole
        at = 0
        while at < len(data):
            size = draw.randrange(1, 30)
            found += stream.feed(data[at : at + size]).count(wanted)
            at += size
    assert found > pieces  # noise that begins as a packet hides the next one at most
    assert stream.damaged > 100


def test_a_packet_cut_short_does_not_hide_the_next() -> None:
    whole = packets.status(7, bytes(10))
    long = packets.status(1, bytes(900))
    assert [len(PacketStream().feed(long[:cut] + whole)) for cut in range(len(long))] == [1] * len(long)


@given(st.binary(max_size=80))
def test_after_any_noise_the_packets_go_on(junk: bytes) -> None:
    """However the noise ends, of the packets behind it at most those within one false packet are missed."""
    stream, whole = PacketStream(), packets.status(7, bytes(10))
    stream.feed(junk)
    found = [len(stream.feed(whole)) for _ in range(60)]
    assert sum(found) >= 58
    assert found[-1] == 1


@pytest.mark.parametrize(
    "make",
    [
        lambda: packets.ping(253),
        lambda: packets.ping(-1),
        lambda: packets.sync_write(116, {}),
        lambda: packets.sync_write(116, {1: b"12", 2: b"123"}),
        lambda: write(1, 0, bytes(1100)),
    ],
)
def test_what_is_no_packet_is_refused(make: Any) -> None:
    with pytest.raises(PacketError, match="refused"):
        make()


class Line:
    """A port of the makers' library, without hardware: keeps what is written, gives what it is to be read."""

    def __init__(self, answer: bytes = b"") -> None:
        self.written, self.answer, self.is_using = b"", answer, False

    def clearPort(self) -> None:  # noqa: N802
        return

    def setPacketTimeout(self, length: int) -> None:  # noqa: N802
        return

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return not self.answer

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        self.written += bytes(packet)
        return len(packet)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        data, self.answer = self.answer[:length], self.answer[length:]
        return data


@given(AWKWARD, st.integers(0, 252))
def test_the_makers_library_sends_the_same_and_reads_ours(body: bytes, servo_id: int) -> None:
    sdk = pytest.importorskip("dynamixel_sdk", reason="the makers' library is no part of the install")
    makers, line = sdk.Protocol2PacketHandler(), Line()
    ours = write(servo_id, 116, body)
    if b"\xff\xff\xfd" in body:  # it stuffs rightly, and then sends what was not stuffed (4.1.0)
        plain = [
            *dynamixel_packets.HEADER,
            servo_id,
            len(body) + 5,
            0,
            Instruction.WRITE,
            116,
            0,
            *body,
            0,
            0,
        ]
        assert bytes(makers.addStuffing(plain)[:-2]) == ours[:-2]
    else:
        makers.writeTxOnly(line, servo_id, 116, len(body), list(body))
        assert line.written == ours
    assert makers.updateCRC(0, list(ours), len(ours) - 2) == int.from_bytes(ours[-2:], "little")
    if b"\xff\xff\xfd" in body:  # what it reads of such a body is not what was sent, either
        return
    line = Line(packets.status(servo_id, body, 0x80))
    said, result, error = makers.readTxRx(line, servo_id, 64, len(body))
    assert (bytes(said[: len(body)]), result, error) == (body, 0, 0x80)
    assert line.written == read(servo_id, 64, len(body))
