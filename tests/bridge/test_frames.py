"""Extended frames: known bytes, round trips, and a parser that survives anything."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from servo_bridge import PacketError
from servo_bridge.driver import byte_to_width, width_to_byte
from servo_bridge.protocols import (
    Banner,
    BoardFlags,
    Frame,
    FrameParser,
    FrameType,
    PacketParser,
    Telemetry,
    frames,
    legacy,
)

sextet = st.integers(0, 63)
width = st.integers(0, 4095)


@st.composite
def any_frame(draw: st.DrawFn) -> Frame:
    kind = draw(st.sampled_from(FrameType))
    length = frames.PAYLOAD_SEXTETS[kind]
    return Frame(kind, draw(sextet), tuple(draw(st.lists(sextet, min_size=length, max_size=length))))


def test_the_crc_is_the_common_one() -> None:
    assert frames.crc8(b"123456789") == 0xF4  # the check value of CRC-8 (poly 0x07)
    assert frames.crc8(b"") == 0


def test_a_set_frame_has_these_bytes() -> None:
    widths = (1472, 1781, 2090)
    body = [1, 5, 1472 >> 6, 1472 & 63, 1781 >> 6, 1781 & 63, 2090 >> 6, 2090 & 63]
    crc = frames.crc8(body)
    expected = bytes([0xFE, *(0x80 | value for value in [*body, crc >> 6, crc & 63])])
    assert frames.set_widths(5, widths) == expected
    assert len(expected) == 11


@pytest.mark.parametrize(
    ("made", "length"),
    [
        (frames.set_widths(0, (1500,) * 3), 11),
        (frames.relax(1), 5),
        (frames.hold(2), 5),
        (frames.ping(3), 5),
        (frames.set_limits(4, [(1163, 2091, 2400)] * 3), 23),
        (frames.slew(5, 62), 7),
        (frames.identify(5, 12345), 13),
        (frames.identity(5, 12345), 13),
        (frames.banner(6, Banner(1, 0, 3, 2)), 9),
        (frames.telemetry(7, Telemetry(9, BoardFlags.LINK, (1500,) * 3, 0, 0)), 18),
    ],
)
def test_the_type_fixes_the_length(made: bytes, length: int) -> None:
    assert len(made) == length


def test_a_servo_byte_is_a_pulse_width() -> None:
    assert byte_to_width(90) == pytest.approx(1472.0)
    assert byte_to_width(180) == 2400.0
    assert byte_to_width(0) == 544.0
    assert all(round(width_to_byte(round(byte_to_width(a)))) == a for a in range(181))


@settings(derandomize=True, max_examples=300)
@given(any_frame())
def test_every_frame_survives_the_line_and_holds_no_byte_of_another_protocol(frame: Frame) -> None:
    data = frames.encode(frame)
    assert FrameParser().feed(data) == [frame]
    assert all(value >= 0x80 and value != legacy.HEADER for value in data)
    assert PacketParser().feed(data, 0.0) == []


@settings(derandomize=True)
@given(st.integers(0, 4095), st.lists(width, min_size=3, max_size=3), sextet, width, width)
def test_telemetry_round_trip(flags: int, widths: list[int], seq: int, rejects: int, overruns: int) -> None:
    content = Telemetry(seq, BoardFlags(flags), tuple(widths), rejects, overruns)
    (frame,) = FrameParser().feed(frames.telemetry(0, content))
    assert frames.read_telemetry(frame) == content


def test_the_versions_are_those_of_the_firmware() -> None:
    source = (Path(frames.__file__).parents[1] / "firmware" / "tripod.c").read_text()
    versions = dict(re.findall(r"#define (\w+_VERSION|FIRMWARE_M\w+) (\d+)", source))
    assert versions == {
        "PROTOCOL_VERSION": str(frames.PROTOCOL_VERSION),
        "FIRMWARE_MAJOR": str(frames.FIRMWARE_VERSION[0]),
        "FIRMWARE_MINOR": str(frames.FIRMWARE_VERSION[1]),
    }


def test_banner_round_trip() -> None:
    (frame,) = FrameParser().feed(frames.banner(0, Banner(1, 2, 3, 8)))
    assert frames.read_banner(frame) == Banner(1, 2, 3, 8)
    with pytest.raises(PacketError, match="TELEMETRY was expected"):
        frames.read_telemetry(frame)


@settings(derandomize=True, max_examples=200)
@given(any_frame(), st.data())
def test_one_wrong_bit_is_always_found(frame: Frame, data: st.DataObject) -> None:
    good = bytearray(frames.encode(frame))
    place = data.draw(st.integers(0, len(good) - 1))
    good[place] ^= 1 << data.draw(st.integers(0, 7))
    assert frame not in FrameParser().feed(bytes(good))


@pytest.mark.slow
@settings(derandomize=True, max_examples=200)
@given(st.binary(max_size=200), any_frame(), st.binary(max_size=50))
def test_a_frame_after_rubbish_is_found_however_it_is_cut(before: bytes, frame: Frame, after: bytes) -> None:
    data = before + frames.encode(frame) + bytes(value for value in after if value != 0xFE)
    whole, bytewise = FrameParser(), FrameParser()
    expected = whole.feed(data)
    assert frame in expected
    assert [found for value in data for found in bytewise.feed(bytes([value]))] == expected
    assert (whole.accepted, whole.dropped) == (bytewise.accepted, bytewise.dropped)


def test_a_frame_cut_by_another_is_dropped_and_counted() -> None:
    parser = FrameParser()
    data = frames.set_widths(1, (1500,) * 3)
    assert parser.feed(data[:6] + data) == [Frame(FrameType.SET, 1, frames.split12((1500,) * 3))]
    assert (parser.accepted, parser.dropped) == (1, 1)


@pytest.mark.parametrize("value", [-1, 4096])
def test_a_width_of_more_than_12_bits_is_refused(value: int) -> None:
    with pytest.raises(PacketError, match=r"0\.\.4095"):
        frames.set_widths(0, (value, 1500, 1500))


def test_a_wrong_count_or_sequence_number_is_refused() -> None:
    with pytest.raises(PacketError, match="SET takes 6 sextets, not 4"):
        frames.set_widths(0, (1500, 1500))
    with pytest.raises(PacketError, match="64 does not fit"):
        frames.ping(64)
