"""How the firmware moves: slew limit, hold and rest when the line falls silent, limits, relax, watchdog."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest
from firmware_line import (
    SLEW_US,
    TOLERANCE_US,
    heard,
    ideal,
    legacy,
    widths_by_frame,
)

from servo_bridge.emulator import EmulatedBoard
from servo_bridge.protocols import BoardFlags, frames

HANG = b"\xff\xcf"
"""A jump to itself."""

RETURN = b"\x18\x95"
"""Return from an interrupt."""

TIMER_VECTOR = 11 * 4


def stream(board: EmulatedBoard, packet: bytes, seconds: float) -> None:
    """Send the packet at 50 Hz."""
    for _ in range(round(seconds * 50)):
        board.feed(packet)
        board.run(0.02)


def steps(board: EmulatedBoard) -> list[float]:
    """Changes of width from pulse to pulse, all pins, in [us]."""
    return [b - a for pin in range(3) for a, b in itertools.pairwise(widths_by_frame(board, pin))]


def patch(board: EmulatedBoard, address: int, code: bytes) -> bytes:
    """Write to the board's flash; returns what was there."""
    flash = board.processor.flash
    before = bytes(flash[address : address + len(code)])
    flash[address : address + len(code)] = list(code)
    return before


def test_no_servo_moves_faster_than_the_slew_limit(board: EmulatedBoard) -> None:
    stream(board, legacy(60, 120, 180), 0.2)
    board.clear()
    stream(board, legacy(180, 60, 60), 0.6)
    assert board.widths_us() == pytest.approx(ideal(180, 60, 60), abs=TOLERANCE_US)
    largest = max(map(abs, steps(board)))
    assert SLEW_US - 2.0 < largest < SLEW_US
    rising = [width for width in widths_by_frame(board, 0) if ideal(61)[0] < width < ideal(179)[0]]
    assert 19 <= len(rising) <= 21  # 120 degrees at 5.92 degrees a frame


def test_the_first_pose_is_taken_at_once(board: EmulatedBoard) -> None:
    board.feed(legacy(60, 120, 180))
    board.run(0.06)
    assert [p.width_us for p in board.pulses[:3]] == pytest.approx(ideal(60, 120, 180), abs=TOLERANCE_US)


def test_silence_holds_after_half_a_second_in_mid_movement(board: EmulatedBoard) -> None:
    board.feed(frames.slew(1, 5) + frames.set_widths(2, [1000, 1000, 1000]))
    board.run(0.1)
    board.feed(frames.set_widths(3, [2400, 2400, 2400]))
    board.run(0.45)
    moving = board.widths_us()
    board.run(0.15)
    held = board.widths_us()
    assert moving is not None
    assert held is not None
    assert held[0] - moving[0] < 4 * 5 + 2.0
    assert BoardFlags.HOLD in heard(board).flags
    board.run(1.2)
    assert board.widths_us() == pytest.approx(held, abs=TOLERANCE_US)
    board.feed(frames.set_widths(4, [2400, 2400, 2400]))  # a command takes up the movement again
    board.run(0.1)
    moved = board.widths_us()
    assert moved is not None
    assert moved[0] > held[0] + 5.0
    assert BoardFlags.HOLD not in heard(board).flags


def test_silence_of_two_seconds_creeps_to_rest(board: EmulatedBoard) -> None:
    stream(board, legacy(60, 120, 180), 0.2)
    board.run(1.9)
    assert board.widths_us() == pytest.approx(ideal(60, 120, 180), abs=TOLERANCE_US)
    board.clear()
    board.run(0.5)
    said = heard(board).flags
    assert BoardFlags.HOMING in said
    assert BoardFlags.LINK not in said
    board.run(2.0)
    assert board.widths_us() == pytest.approx(ideal(150, 150, 150), abs=TOLERANCE_US)
    assert max(map(abs, steps(board))) < 10.0 + 1.0  # 10 us per frame, one degree
    board.clear()
    stream(board, legacy(60, 60, 60), 0.6)  # and back at the usual speed
    assert board.widths_us() == pytest.approx(ideal(60, 60, 60), abs=TOLERANCE_US)
    assert max(map(abs, steps(board))) < SLEW_US


def test_limits_bound_commands_and_the_present_pose(board: EmulatedBoard) -> None:
    stream(board, frames.set_widths(1, [600, 1500, 2300]), 0.1)
    limits = [(1000, 2000, 2000), (1600, 1650, 1700), (1100, 1500, 1900)]
    board.feed(frames.set_limits(2, limits))
    stream(board, frames.set_widths(3, [600, 1500, 2300]), 0.6)
    assert board.widths_us() == pytest.approx([1000, 1600, 1900], abs=TOLERANCE_US)
    assert BoardFlags.LIMITS_SET in heard(board).flags
    board.run(6.0)
    assert board.widths_us() == pytest.approx([2000, 1650, 1500], abs=TOLERANCE_US)


def test_relax_ends_the_pulses_whole_and_a_pose_brings_them_back(board: EmulatedBoard) -> None:
    stream(board, frames.set_widths(1, [1000, 1500, 2000]), 0.1)
    board.feed(frames.relax(2))
    board.run(0.1)
    assert board.widths_us() is None
    assert all(
        abs(pulse.width_us - (1000, 1500, 2000)[pulse.channel]) < TOLERANCE_US for pulse in board.pulses
    )
    said = heard(board)
    assert BoardFlags.RELAXED in said.flags
    assert BoardFlags.ACTIVE not in said.flags
    assert said.widths_us == (0, 0, 0)
    board.run(3.0)
    assert board.widths_us() is None
    board.clear()
    stream(board, frames.set_widths(3, [1100, 1500, 2000]), 0.2)
    first = [pulse.width_us for pulse in board.pulses[:3]]
    assert first[0] == pytest.approx(1061, abs=TOLERANCE_US)  # from where it was, within the slew limit
    assert board.widths_us() == pytest.approx([1100, 1500, 2000], abs=TOLERANCE_US)


def test_hold_stops_where_the_servo_is(board: EmulatedBoard) -> None:
    stream(board, legacy(60, 60, 60), 0.1)
    board.feed(legacy(180, 180, 180))
    board.run(0.1)
    board.feed(frames.hold(4))
    board.run(0.06)
    held = board.widths_us()
    stream(board, frames.ping(5), 1.0)
    assert board.widths_us() == held
    assert BoardFlags.HOLD in heard(board).flags


def test_a_ping_keeps_the_link_and_the_pose(board: EmulatedBoard) -> None:
    stream(board, legacy(100, 110, 120), 0.1)
    stream(board, frames.ping(9), 4.0)
    said = heard(board)
    assert said.seq == 9
    assert BoardFlags.LINK in said.flags
    assert BoardFlags.HOMING not in said.flags
    assert board.widths_us() == pytest.approx(ideal(100, 110, 120), abs=TOLERANCE_US)


def test_the_watchdog_ends_a_hang_of_the_main_loop(board: EmulatedBoard) -> None:
    stream(board, legacy(90, 120, 150), 0.1)
    board.run(0.005)
    place = board.processor.program_counter
    saved = patch(board, place, HANG)
    board.clear()
    start = board.time_s
    assert board.run_until(lambda board: board.resets == 2, 1.0)
    assert 0.2 < board.time_s - start < 0.35
    assert len(widths_by_frame(board, 0)) >= 10  # the timer held the pose meanwhile
    assert all(abs(p.width_us - ideal(90, 120, 150)[p.channel]) < TOLERANCE_US for p in board.pulses)
    patch(board, place, saved)
    pulses = len(board.pulses)
    board.run(1.0)
    assert board.resets == 2
    assert len(board.pulses) == pulses
    parsed = frames.FrameParser().feed(board.transmitted)
    parsed = parsed[[frame.kind for frame in parsed].index(frames.FrameType.BANNER) :]
    assert frames.read_banner(parsed[0]).reset_cause & 8
    assert BoardFlags.WATCHDOG in frames.read_telemetry(parsed[1]).flags


def test_the_watchdog_also_guards_the_timer(board: EmulatedBoard) -> None:
    stream(board, legacy(90, 120, 150), 0.1)
    saved = patch(board, TIMER_VECTOR, RETURN)
    assert board.run_until(lambda board: board.resets == 2, 1.0)
    patch(board, TIMER_VECTOR, saved)
    board.run(0.1)
    assert board.widths_us() is None


def test_a_reset_starts_without_pulses(board: EmulatedBoard) -> None:
    stream(board, legacy(90, 120, 150), 0.1)
    board.reset()
    board.clear()
    board.run(3.0)
    assert board.pulses == []
    parsed = frames.FrameParser().feed(board.transmitted)
    assert frames.read_banner(parsed[0]).reset_cause == 2


def test_a_reset_in_mid_pulse_is_told_apart(board: EmulatedBoard) -> None:
    stream(board, legacy(90, 120, 150), 0.1)
    first = [pulse for pulse in board.pulses if pulse.channel == 0][-1]
    whole = len(board.pulses)
    middle = first.start_s + 0.0207  # 0.7 ms into the next frame's pulse
    board.run(middle - board.time_s)
    board.reset()
    assert [pulse.channel for pulse in board.cut_pulses] == [0]
    assert board.cut_pulses[0].width_us == pytest.approx(700.0, abs=2.0)
    board.run(0.1)
    assert len(board.pulses) == whole


def test_two_runs_are_the_same(make_board: Callable[[], EmulatedBoard]) -> None:
    seen = []
    for _ in range(2):
        board = make_board()
        stream(board, legacy(90, 120, 150), 0.3)
        board.feed(frames.set_widths(1, [1000, 1500, 2000]))
        board.run(3.0)
        seen.append((board.pulses, board.transmitted))
    assert seen[0] == seen[1]
