"""The firmware stops where it is told to and stays: a latched hold, a slow way to the rest it was told."""

from __future__ import annotations

import itertools

import pytest
from firmware_line import SLEW_US, TOLERANCE_US, heard, ideal, legacy, widths_by_frame

from servo_bridge.emulator import EmulatedBoard
from servo_bridge.protocols import BoardFlags, frames

RANGE = (1163, 2091, 2400)
CREEP_US = 11.0  # 10 us a frame, as measured


def stream(board: EmulatedBoard, packet: bytes, seconds: float) -> None:
    """Send the packet at 50 Hz."""
    for _ in range(round(seconds * 50)):
        board.feed(packet)
        board.run(0.02)


def largest_step(board: EmulatedBoard) -> float:
    """Largest change of a width from pulse to pulse, all pins, in [us]."""
    pins = (itertools.pairwise(widths_by_frame(board, pin)) for pin in range(3))
    return max(abs(after - before) for pairs in pins for before, after in pairs)


def test_a_hold_outlasts_every_silence(board: EmulatedBoard) -> None:
    stream(board, frames.set_widths(1, [1208, 1500, 1800]), 0.2)
    board.feed(frames.hold(2))
    board.clear()
    board.run(60.0)
    assert board.widths_us() == pytest.approx([1208, 1500, 1800], abs=TOLERANCE_US)
    assert largest_step(board) < 1.0
    flags = heard(board).flags
    assert BoardFlags.HOLD in flags
    assert BoardFlags.HOMING not in flags
    assert BoardFlags.LINK not in flags


@pytest.mark.parametrize(
    "word",
    [
        frames.ping(3),
        frames.set_limits(3, [RANGE] * 3),
        frames.slew(3, 50),
        frames.set_widths(3, [500] * 3),  # refused
        legacy(150, 150, 150),
        b"\xfe\x81\x83",
    ],
)
def test_only_a_pose_in_a_frame_ends_a_hold(board: EmulatedBoard, word: bytes) -> None:
    stream(board, frames.set_widths(1, [1208, 1500, 1800]), 0.2)
    board.feed(frames.hold(2))
    board.clear()
    board.run(1.0)  # long enough for a legacy packet to count again
    stream(board, word, 1.0)
    board.run(5.0)
    assert board.widths_us() == pytest.approx([1208, 1500, 1800], abs=TOLERANCE_US)
    assert largest_step(board) < 1.0
    stream(board, frames.set_widths(4, [1250, 1500, 1800]), 0.2)
    assert board.widths_us() == pytest.approx([1250, 1500, 1800], abs=TOLERANCE_US)
    assert BoardFlags.HOLD not in heard(board).flags


@pytest.mark.parametrize("word", [frames.ping(3), frames.set_limits(3, [RANGE] * 3), frames.slew(3, 124)])
def test_a_word_on_the_way_to_rest_stops_it_and_never_makes_it_fast(
    board: EmulatedBoard, word: bytes
) -> None:
    stream(board, frames.set_widths(1, [1208] * 3), 0.2)
    board.run(2.5)
    assert BoardFlags.HOMING in heard(board).flags
    before = board.widths_us()
    assert before is not None
    board.clear()
    stream(board, word, 3.0)
    after = board.widths_us()
    assert after is not None
    assert abs(after[0] - before[0]) < 4 * CREEP_US
    assert largest_step(board) < CREEP_US
    assert BoardFlags.HOMING not in heard(board).flags
    board.run(8.0)  # silent again: on to rest, as slowly
    assert board.widths_us() == pytest.approx([2091] * 3, abs=TOLERANCE_US)
    assert largest_step(board) < CREEP_US


def test_pulses_come_back_where_they_were_also_when_the_limits_have_changed(board: EmulatedBoard) -> None:
    stream(board, frames.set_widths(1, [1208, 1500, 2000]), 0.2)
    board.feed(frames.relax(2))
    board.run(0.1)
    board.feed(frames.set_limits(3, [(600, 700, 939)] * 3))
    board.run(3.0)
    assert board.widths_us() is None
    board.clear()
    stream(board, frames.set_widths(4, [939] * 3), 1.0)
    first = [pulse.width_us for pulse in board.pulses[:3]]
    for seen, was in zip(first, (1208, 1500, 2000), strict=True):
        assert 0.0 <= was - seen <= SLEW_US
    assert largest_step(board) < SLEW_US
    assert board.widths_us() == pytest.approx([939] * 3, abs=TOLERANCE_US)


def test_silence_leads_to_the_rest_pose_that_the_board_was_told(board: EmulatedBoard) -> None:
    board.feed(frames.set_limits(1, [(1163, 1200, 2400), (1163, 1700, 2400), (1163, 2400, 2400)]))
    stream(board, frames.set_widths(2, [1500, 1500, 1500]), 0.2)
    board.run(8.0)
    assert board.widths_us() == pytest.approx([1200, 1700, 2400], abs=TOLERANCE_US)
    assert BoardFlags.HOMING in heard(board).flags


def test_without_being_told_it_rests_at_the_tripod_s_byte(board: EmulatedBoard) -> None:
    stream(board, legacy(120, 120, 120), 0.2)
    board.run(6.0)
    assert board.widths_us() == pytest.approx(ideal(150, 150, 150), abs=TOLERANCE_US)


@pytest.mark.parametrize("half", [b"\xff\x5a\x5a", frames.set_widths(9, [1500] * 3)[:-1]])
def test_half_a_packet_is_dropped_without_another_byte(board: EmulatedBoard, half: bytes) -> None:
    before = heard(board).rejects
    board.feed(half)
    board.run(0.1)
    assert heard(board).rejects == before + 1


@pytest.mark.slow
@pytest.mark.exhaustive
def test_half_a_packet_is_not_obeyed_when_the_clock_of_its_age_has_wrapped(board: EmulatedBoard) -> None:
    stream(board, frames.set_widths(1, [1500] * 3), 0.1)
    board.run(1.0)
    wrap = 2**32 * 0.5e-6
    board.feed(legacy(60, 60))
    start = board.time_s
    while board.time_s < start + wrap - 1.0:
        board.run(10.0 if board.time_s < start + wrap - 20.0 else 0.5)
        board.clear()
        board.take_transmitted()
    board.run(start + wrap + 0.02 - board.time_s)
    before = board.widths_us()
    board.feed(bytes([60]))
    board.run(0.1)
    assert board.widths_us() == pytest.approx(before, abs=TOLERANCE_US)
    assert heard(board).rejects == 1
