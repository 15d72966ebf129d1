"""What the tests of the firmware say to it and hear from it."""

from __future__ import annotations

from servo_bridge.driver import byte_to_width
from servo_bridge.emulator import EmulatedBoard
from servo_bridge.protocols import FrameParser, FrameType, Telemetry, read_telemetry

TOLERANCE_US = 1.5
SLEW_US = 62.0
"""Largest change of a width from frame to frame: 6 degrees are 61.9 us."""


def legacy(*servo_bytes: int) -> bytes:
    """Legacy packet of servo bytes."""
    return bytes([255, *servo_bytes])


def ideal(*servo_bytes: int) -> list[float]:
    """Pulse widths of servo bytes in [us]."""
    return [byte_to_width(value) for value in servo_bytes]


def newest_telemetry(board: EmulatedBoard) -> Telemetry:
    """The last telemetry the board sent; what it sent is forgotten."""
    frames = FrameParser().feed(board.take_transmitted())
    return [read_telemetry(frame) for frame in frames if frame.kind is FrameType.TELEMETRY][-1]


def heard(board: EmulatedBoard) -> Telemetry:
    """The next telemetry, at most 60 ms later."""
    board.take_transmitted()
    assert board.run_until(lambda board: telemetry_count(board.transmitted) > 0, 0.2)
    return newest_telemetry(board)


def telemetry_count(data: bytes) -> int:
    return sum(frame.kind is FrameType.TELEMETRY for frame in FrameParser().feed(data))


def widths_by_frame(board: EmulatedBoard, channel: int) -> list[float]:
    """Widths of one pin's pulses in [us], oldest first."""
    return [pulse.width_us for pulse in board.pulses if pulse.channel == channel]
