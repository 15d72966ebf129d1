"""Pulses of the firmware, measured in cycles of the emulated processor."""

from __future__ import annotations

import itertools

import pytest

from servo_bridge.emulator import EmulatedBoard

TOLERANCE_US = 1.5
JITTER_US = 2.0
SATURATED_BYTES_PER_S = 11520


def ideal_us(servo_byte: int) -> float:
    """Pulse width of a degree byte in [us]."""
    return 544.0 + servo_byte * 1856.0 / 180.0


def legacy(*servo_bytes: int) -> bytes:
    return bytes([255, *servo_bytes])


@pytest.mark.slow
def test_every_byte_on_every_pin(board: EmulatedBoard) -> None:
    worst = 0.0
    for first in range(60, 181):
        second, third = 60 + (first - 60 + 40) % 121, 60 + (first - 60 + 80) % 121
        poses = [legacy(first, second, third)] * 40  # the longest way takes 21 frames
        for packet in poses:
            board.feed(packet)
            board.run(0.02)
        widths = board.widths_us()
        assert widths is not None
        for width, servo_byte in zip(widths, (first, second, third), strict=True):
            worst = max(worst, abs(width - ideal_us(servo_byte)))
    assert worst < TOLERANCE_US


def test_no_pulse_before_the_first_valid_command(board: EmulatedBoard) -> None:
    board.feed(legacy(59, 90, 90) + legacy(90, 90) + bytes(range(200)))
    board.run(3.0)
    assert board.pulses == []
    assert board.widths_us() is None
    board.feed(legacy(90, 120, 150))
    board.run(0.05)
    assert board.widths_us() == pytest.approx([ideal_us(90), ideal_us(120), ideal_us(150)], abs=TOLERANCE_US)


def test_jitter_stays_small_while_the_line_is_saturated(board: EmulatedBoard) -> None:
    board.feed(legacy(90, 120, 150) * 5)
    board.run(0.1)
    board.clear()
    board.feed(legacy(90, 120, 150) * (5 * SATURATED_BYTES_PER_S // 4))
    board.run(5.0)
    assert board.processor.lost_bytes == 0
    for channel, servo_byte in enumerate((90, 120, 150)):
        pulses = [pulse for pulse in board.pulses if pulse.channel == channel]
        assert 249 <= len(pulses) <= 251
        assert all(abs(pulse.width_us - ideal_us(servo_byte)) < TOLERANCE_US for pulse in pulses)
        widths = [pulse.width_us for pulse in pulses]
        assert max(widths) - min(widths) < JITTER_US
        periods = [(b.start - a.start) / 16.0 for a, b in itertools.pairwise(pulses)]
        assert all(abs(period - 20000.0) < JITTER_US for period in periods)
