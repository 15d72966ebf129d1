"""The board's side of the extended protocol, without hardware: frames in, banner and telemetry out. Pure.

It answers as the firmware does, but its servos are where they are told to be at once.
"""

from __future__ import annotations

from collections.abc import Sequence

from servo_bridge import frames
from servo_bridge.codec import PacketParser
from servo_bridge.frames import Banner, BoardFlags, Frame, FrameParser, FrameType, Telemetry

TELEMETRY_PERIOD_S = 0.05
LINK_TIMEOUT_S = 0.5
RESET_EXTERNAL = 2


class ExtendedBoard:
    """A board that takes legacy packets and frames; times are seconds of any steady clock.

    Args:
        legacy: Parser of legacy packets; keeps the counts of accepted and dropped packets.
    """

    def __init__(self, legacy: PacketParser) -> None:
        self.silent = False
        self.limits_us: tuple[tuple[int, int], ...] = ()
        self.relaxed = self.holds = False
        self._legacy, self._frames = legacy, FrameParser()
        self._reset_cause = RESET_EXTERNAL
        self.reset()

    def reset(self, cause: int = RESET_EXTERNAL) -> None:
        """Start anew, as after the opening of the port; the banner is said next."""
        self._frames.reset()
        self._legacy.reset()
        self._widths: tuple[int, ...] | None = None
        self._command_time: float | None = None
        self._seq = self._own_seq = 0
        self._banner_due, self._reset_cause = True, cause
        self.limits_us, self.relaxed, self.holds = (), False, False

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Take bytes; the poses among them as degrees of the servos, rounded, oldest first."""
        poses = []
        for value in data:  # in the order of arrival, whatever the protocol
            byte = bytes([value])
            for servo_bytes in self._legacy.feed(byte, now):
                self._pose([round(frames.byte_to_width(each)) for each in servo_bytes], now)
                poses.append(servo_bytes)
            for frame in self._frames.feed(byte):
                self._seq = frame.seq
                self._take(frame, now)
                if frame.kind is FrameType.SET:
                    poses.append(tuple(round(frames.width_to_byte(width)) for width in self._widths or ()))
                    self._legacy.accepted += 1
        return poses

    def say(self, now: float) -> bytes:
        """The banner where it is due, then telemetry."""
        data = b""
        if self._banner_due:
            self._banner_due = False
            data += frames.banner(self._next(), Banner(frames.PROTOCOL_VERSION, 0, 0, self._reset_cause))
        linked = self._command_time is not None and now - self._command_time <= LINK_TIMEOUT_S
        states = {
            BoardFlags.LINK: linked,
            BoardFlags.HOLD: self._widths is not None and (self.holds or not linked),
            BoardFlags.ACTIVE: self._widths is not None and not self.relaxed,
            BoardFlags.RELAXED: self.relaxed,
            BoardFlags.LIMITS_SET: bool(self.limits_us),
            BoardFlags.WATCHDOG: bool(self._reset_cause & 8),
        }
        flags = BoardFlags(sum(flag for flag, is_set in states.items() if is_set))
        widths = self._widths if self._widths is not None and not self.relaxed else (0,) * frames.SERVOS
        rejects = (self._legacy.dropped + self._frames.dropped) & 0xFFF
        return data + frames.telemetry(self._next(), Telemetry(self._seq, flags, widths, rejects, 0))

    def _take(self, frame: Frame, now: float) -> None:
        self._command_time = now
        if frame.kind is FrameType.SET:
            self._pose(frames.join12(frame.payload), now)
        elif frame.kind is FrameType.RELAX:
            self.relaxed = True
        elif frame.kind is FrameType.HOLD:
            self.holds = True
        elif frame.kind is FrameType.SET_LIMITS:
            ends = frames.join12(frame.payload)
            self.limits_us = tuple(zip(ends[::2], ends[1::2], strict=True))

    def _pose(self, widths: Sequence[int], now: float) -> None:
        self._command_time = now
        limits = self.limits_us or ((544, 2400),) * len(widths)
        self._widths = tuple(
            min(max(width, low), high) for width, (low, high) in zip(widths, limits, strict=False)
        )
        self.relaxed = self.holds = False

    def _next(self) -> int:
        self._own_seq = (self._own_seq + 1) % frames.SEQUENCES
        return self._own_seq
