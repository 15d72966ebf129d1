"""The board's side of the extended protocol, without hardware: frames in, banner and telemetry out. Pure.

It answers and moves as the firmware does; the same bytes into both give the same counters and widths.
"""

from __future__ import annotations

from servo_bridge import frames
from servo_bridge.board_motion import PULSE_MAX_US, SLEW_MAX_US, TICKS_PER_US, BoardMotion, byte_ticks
from servo_bridge.codec import PacketParser
from servo_bridge.frames import (
    PULSE_MIN_US,
    Banner,
    BoardFlags,
    Frame,
    FrameParser,
    FrameType,
    Telemetry,
)

TELEMETRY_PERIOD_S = 0.05
RESET_EXTERNAL = 2
_COUNTER = 0xFFF


class ExtendedBoard:
    """A board that takes legacy packets and frames; times are seconds of any steady clock.

    Args:
        legacy: Parser of legacy packets.

    Attributes:
        accepted: Poses taken since it was made, of packets and frames.
        refused: Well-formed packets and frames refused for what they ask.
        seq: Sequence number of the newest accepted frame.
        silent: Say nothing any more, as a board that hangs.
        motion: The servos.
    """

    def __init__(self, legacy: PacketParser) -> None:
        self.silent = False
        self.accepted = self.refused = 0
        self._legacy, self._frames = legacy, FrameParser()
        self.reset()

    def reset(self, cause: int = RESET_EXTERNAL) -> None:
        """Start anew, as after the opening of the port; the banner is said next."""
        self._frames.reset()
        self._legacy.reset()
        self.motion = BoardMotion()
        self.seq = self._own_seq = 0
        self._limits_set = self._framed = False
        self._banner_due, self._reset_cause = True, cause

    @property
    def limits_us(self) -> tuple[tuple[float, float], ...]:
        """Ranges told by SET_LIMITS in [us]; empty before."""
        if not self._limits_set:
            return ()
        return tuple((low / TICKS_PER_US, high / TICKS_PER_US) for low, high in self.motion.ranges)

    @property
    def rejects(self) -> int:
        """Packets and frames dropped or refused so far."""
        return self._legacy.dropped + self._frames.dropped + self.refused

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Take bytes; the poses accepted among them as degrees of the servos, rounded, oldest first."""
        self.motion.advance(now)
        poses = []
        for value in data:  # in the order of arrival, whatever the protocol
            byte = bytes([value])
            for servo_bytes in self._legacy.feed(byte, now):
                if self._take_packet(servo_bytes):
                    poses.append(servo_bytes)
            for frame in self._frames.feed(byte):
                if not self._take_frame(frame):
                    self.refused += 1
                elif frame.kind is FrameType.SET:
                    widths = frames.join12(frame.payload)
                    poses.append(tuple(round(frames.width_to_byte(width)) for width in widths))
        self.accepted += len(poses)
        return poses

    def say(self, now: float) -> bytes:
        """The banner where it is due, then telemetry."""
        self.motion.advance(now)
        data = b""
        if self._banner_due:
            self._banner_due = False
            content = Banner(frames.PROTOCOL_VERSION, *frames.FIRMWARE_VERSION, self._reset_cause)
            data += frames.banner(self._next(), content)
        widths = self.motion.widths_us or (0.0,) * frames.SERVOS
        told = Telemetry(
            self.seq, self._flags(), tuple(int(width + 0.5) for width in widths), self.rejects & _COUNTER, 0
        )
        return data + frames.telemetry(self._next(), told)

    def _flags(self) -> BoardFlags:
        motion = self.motion
        states = {
            BoardFlags.LINK: motion.linked,
            BoardFlags.HOLD: motion.holding,
            BoardFlags.HOMING: motion.homing,
            BoardFlags.ACTIVE: motion.active,
            BoardFlags.RELAXED: motion.relaxed,
            BoardFlags.LIMITS_SET: self._limits_set,
            BoardFlags.WATCHDOG: bool(self._reset_cause & 8),
        }
        return BoardFlags(sum(flag for flag, is_set in states.items() if is_set))

    def _take_packet(self, servo_bytes: tuple[int, ...]) -> bool:
        """Take a legacy packet; soon after a frame it is refused: a flipped bit makes one of a frame."""
        if self._framed and self.motion.linked:
            self.refused += 1
            return False
        self._framed = False
        self.motion.command([byte_ticks(value) for value in servo_bytes])
        return True

    def _take_frame(self, frame: Frame) -> bool:
        """Carry a frame out; False, and nothing done, where a value of it is not allowed."""
        if frame.kind >= FrameType.BANNER:
            return False
        numbers = frames.join12(frame.payload)
        ticks = [number * TICKS_PER_US for number in numbers]
        motion = self.motion
        if frame.kind is FrameType.SET:
            if not all(map(_is_width, numbers)):
                return False
            motion.command(ticks)
        elif frame.kind is FrameType.SET_LIMITS:
            pairs = list(zip(ticks[::2], ticks[1::2], strict=True))
            if not all(map(_is_width, numbers)) or any(low > high for low, high in pairs):
                return False
            motion.ranges, self._limits_set = pairs, True
        elif frame.kind is FrameType.SLEW:
            if not 1 <= numbers[0] <= SLEW_MAX_US:
                return False
            motion.slew = ticks[0]
        elif frame.kind in (FrameType.RELAX, FrameType.HOLD):
            motion.relaxed |= frame.kind is FrameType.RELAX
            motion.hold_asked |= frame.kind is FrameType.HOLD
            motion.stop()
        motion.heard()
        self.seq, self._framed = frame.seq, True
        return True

    def _next(self) -> int:
        self._own_seq = (self._own_seq + 1) % frames.SEQUENCES
        return self._own_seq


def _is_width(us: int) -> bool:
    return PULSE_MIN_US <= us <= PULSE_MAX_US
