"""The board's side of the protocol: restart, range, age, cuts and noise."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st

from servo_bridge.protocols import PacketParser

POSE = bytes([255, 93, 121, 179])


def test_a_whole_packet_in_any_pieces_is_accepted_once() -> None:
    for first in range(5):
        for second in range(first, 5):
            parser = PacketParser()
            pieces = (POSE[:first], POSE[first:second], POSE[second:])
            packets = [packet for piece in pieces for packet in parser.feed(piece, 1.0)]
            assert packets == [(93, 121, 179)]
            assert (parser.accepted, parser.dropped) == (1, 0)


def test_a_header_always_restarts() -> None:
    parser = PacketParser()
    assert parser.feed(bytes([255, 90, 255, 91, 92, 255]) + POSE, 0.0) == [(93, 121, 179)]
    assert parser.dropped == 3


def test_a_byte_out_of_range_drops_the_packet_and_what_follows_until_the_next_header() -> None:
    for bad in (*range(60), *range(181, 255)):
        parser = PacketParser()
        assert parser.feed(bytes([255, 90, bad, 90, 90, 90]) + POSE, 0.0) == [(93, 121, 179)]
        assert parser.dropped == 1


def test_bytes_without_header_mean_nothing() -> None:
    parser = PacketParser()
    assert parser.feed(bytes([90] * 50), 0.0) == []
    assert parser.dropped == 0


def test_a_partial_packet_older_than_40_ms_is_dropped() -> None:
    fresh, stale = PacketParser(), PacketParser()
    fresh.feed(POSE[:2], 10.0)
    stale.feed(POSE[:2], 10.0)
    assert fresh.feed(POSE[2:], 10.0399) == [(93, 121, 179)]
    assert stale.feed(POSE[2:], 10.0401) == []
    assert stale.feed(POSE, 10.05) == [(93, 121, 179)]


def test_a_reset_forgets_the_packet_begun() -> None:
    parser = PacketParser()
    parser.feed(POSE[:3], 0.0)
    parser.reset()
    assert parser.feed(POSE[3:], 0.001) == []


@pytest.mark.slow
@settings(derandomize=True, max_examples=300)
@given(st.binary(max_size=200), st.integers(1, 8))
def test_noise_never_gives_a_byte_out_of_range(noise: bytes, servo_count: int) -> None:
    parser = PacketParser(servo_count)
    for packet in parser.feed(noise, 0.0):
        assert len(packet) == servo_count
        assert all(60 <= value <= 180 for value in packet)
    assert parser.feed(bytes([255] + [150] * servo_count), 0.01) == [(150,) * servo_count]
