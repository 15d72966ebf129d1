"""The board's side of the extended protocol, without hardware: frames in, banner and telemetry out.

It responds and moves as firmware/tripod.c does, in its unit: ticks of half a microsecond, pulse periods of 20
ms. The same bytes into both give the same counters and widths; a property test compares them.
"""

from __future__ import annotations

from collections.abc import Sequence

from servo_bridge.driver import PULSE_MIN_US, PULSE_US_PER_180, width_to_byte
from servo_bridge.protocols import frames
from servo_bridge.protocols.frames import (
    FRAME_HEADER,
    SERVOS,
    Banner,
    BoardFlags,
    Frame,
    FrameParser,
    FrameType,
    Telemetry,
)
from servo_bridge.protocols.legacy import PARTIAL_TIMEOUT_S, PacketParser
from servo_bridge.protocols.protocol import BoardModel

FRAME_S = 0.020  # period of the servo pulses in [s]; the widths move once per period
TICKS_PER_US = 2
SLEW_US_PER_FRAME = 61.0  # largest change of a width per pulse period in [us], unless SLEW sets another
PULSE_MAX_US = PULSE_MIN_US + PULSE_US_PER_180
SLEW_MAX_US = 124
_SLEW, _CREEP = round(SLEW_US_PER_FRAME * TICKS_PER_US), 20  # ticks per pulse period
_HOLD_FRAMES, _REST_FRAMES = 25, 100
_REST_BYTE = 150
_LARGEST_LAG_S = 0.5
_PARTIAL_AT_MOST_S = 3 * FRAME_S  # an unfinished packet is dropped then, even without a new byte


def byte_ticks(servo_byte: int) -> int:
    """Return the pulse width in ticks of a servo byte, rounded as in the firmware."""
    return PULSE_MIN_US * TICKS_PER_US + (servo_byte * PULSE_US_PER_180 * TICKS_PER_US + 90) // 180


TELEMETRY_PERIOD_S = 0.05
RESET_POWER_ON, RESET_EXTERNAL = 1, 2
_COUNTER = 0xFFF


class BoardMotion:
    """Widths of a board's servos, period by period; times are seconds of any steady clock.

    `last_ticks` are the widths in ticks of the pulses before the reset; None after a loss of power.

    Attributes:
        started: Whether a pose was commanded since the reset; before that there are no pulses.
        relaxed: Whether the pulses were switched off.
        hold_asked: Whether a frame commanded to hold; only a pose in a frame ends that.
        slew: Largest change of a width per pulse period, in ticks.
        ranges: Smallest and largest width of each servo in ticks.
        rest: Width of each servo in ticks in the rest pose.
    """

    def __init__(self, last_ticks: Sequence[int] | None = None) -> None:
        self.started = self.relaxed = self.hold_asked = False
        self._position_known = last_ticks is not None
        self.slew = _SLEW
        self.ranges = [(PULSE_MIN_US * TICKS_PER_US, PULSE_MAX_US * TICKS_PER_US)] * SERVOS
        self.rest = [byte_ticks(_REST_BYTE)] * SERVOS
        self._current = list(last_ticks or self.rest)
        self._target = list(self._current)
        self._silence = _REST_FRAMES  # pulse periods since the newest valid command, saturating
        self._next_frame: float | None = None

    @property
    def active(self) -> bool:
        """Whether there are pulses."""
        return self.started and not self.relaxed

    @property
    def linked(self) -> bool:
        """Whether a valid command came within 0.5 s."""
        return self._silence < _HOLD_FRAMES

    @property
    def homing(self) -> bool:
        """Whether the servos move slowly to the rest pose, or are there, since no commands arrive."""
        return self.active and not self.hold_asked and self._silence >= _REST_FRAMES

    @property
    def holding(self) -> bool:
        """Whether the servos hold: on command, or since no commands arrive."""
        silent = _HOLD_FRAMES <= self._silence < _REST_FRAMES
        return self.started and (self.hold_asked or silent)

    @property
    def arrived(self) -> bool:
        """Whether the servos are at their target."""
        return self._current == self._within(self._target)

    @property
    def widths_us(self) -> tuple[float, ...] | None:
        """Widths of the pulses in [us], one per servo; None without pulses."""
        return tuple(ticks / TICKS_PER_US for ticks in self._current) if self.active else None

    @property
    def last_ticks(self) -> Sequence[int] | None:
        """Widths in ticks of the newest pulses, which survive a reset; None before the first pulses."""
        return tuple(self._current) if self.started or self._position_known else None

    @property
    def telemetry_us(self) -> tuple[float, ...]:
        """Widths in [us] in telemetry: of the pulses, else of those before the reset, else 0."""
        is_valid = self.active or (self._position_known and not self.started)
        return tuple(ticks / TICKS_PER_US if is_valid else 0.0 for ticks in self._current)

    def command(self, ticks: Sequence[int]) -> None:
        """Set a target; the first one after a loss of power is reached at once."""
        self._target = self._within(ticks)
        if not (self.started or self._position_known):
            self._current = list(self._target)
        self.started, self.relaxed, self.hold_asked = True, False, False
        self._silence = 0

    def stop(self) -> None:
        """Stop where the servos are."""
        self._target = list(self._current)

    def record_command(self) -> None:
        """Record a valid command; after a silence the servos first stop where they are."""
        if not self.linked:
            self.stop()
        self._silence = 0

    def advance(self, now: float) -> None:
        """Advance to `now` in pulse periods; after a long gap the time is not caught up."""
        if self._next_frame is None or now - self._next_frame > _LARGEST_LAG_S:
            self._next_frame = now + FRAME_S
        while self._next_frame <= now:
            self._next_frame += FRAME_S
            self._move()

    def _move(self) -> None:
        self._silence = min(self._silence + 1, _REST_FRAMES)
        if self._silence == _HOLD_FRAMES:
            self.stop()
        step = self.slew
        if self._silence >= _REST_FRAMES and not self.hold_asked:
            self._target = list(self.rest)
            step = min(step, _CREEP)
        if not self.active:
            return  # without pulses the servos stay where they were
        self._current = [
            now + max(-step, min(step, target - now))
            for target, now in zip(self._within(self._target), self._current, strict=True)
        ]

    def _within(self, ticks: Sequence[int]) -> list[int]:
        return [min(max(each, low), high) for each, (low, high) in zip(ticks, self.ranges, strict=True)]


class ExtendedBoard(BoardModel):
    """A board that takes legacy packets, with the parser `legacy`, and frames.

    Attributes:
        refused: Number of well-formed packets and frames refused for their content.
        seq: Sequence number of the newest accepted frame.
        silent: Send nothing any more, as a board that hangs.
        deaf: Receive nothing any more, as behind a broken wire.
        motion: The servos.
        identity: Number of the board, stored permanently; `frames.NO_IDENTITY` until one is assigned.
    """

    say_period_s = TELEMETRY_PERIOD_S
    accepted = 0

    def __init__(self, legacy: PacketParser) -> None:
        self.silent = self.deaf = False
        self.motion = BoardMotion()
        self.identity = frames.NO_IDENTITY
        self._identity_requested = False
        self.refused = 0
        self._legacy, self._frames = legacy, FrameParser()
        self._begun = 0.0  # time at which the newest frame began
        self.reset()

    def reset(self, cause: int = RESET_EXTERNAL) -> None:
        """Restart; the banner is sent next. Only a loss of power loses the positions of the servos."""
        self._frames.reset()
        self._legacy.reset()
        self.motion = BoardMotion(None if cause == RESET_POWER_ON else self.motion.last_ticks)
        self.seq = self._own_seq = 0
        self._limits_set = self._framed = False
        self._banner_due, self._reset_cause = True, cause

    @property
    def limits_us(self) -> tuple[tuple[float, float], ...]:
        """Ranges set by SET_LIMITS in [us]; empty before that."""
        if not self._limits_set:
            return ()
        return tuple((low / TICKS_PER_US, high / TICKS_PER_US) for low, high in self.motion.ranges)

    @property
    def dropped(self) -> int:
        """Number of packets and frames dropped or refused so far."""
        return self._legacy.dropped + self._frames.dropped + self.refused

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        """Process bytes; return the accepted poses as degrees of the servos, rounded, oldest first."""
        self.advance(now)
        if self.deaf:
            return []
        poses = []
        for value in data:  # in the order of arrival, whatever the protocol
            byte = bytes([value])
            self._drop_older(now, PARTIAL_TIMEOUT_S)
            if value == FRAME_HEADER:
                self._begun = now
            for servo_bytes in self._legacy.feed(byte, now):
                if self._take_packet(servo_bytes):
                    poses.append(servo_bytes)
            for frame in self._frames.feed(byte):
                if not self._take_frame(frame):
                    self.refused += 1
                elif frame.kind is FrameType.SET:
                    widths = frames.join12(frame.payload)
                    poses.append(tuple(round(width_to_byte(width)) for width in widths))
        self.accepted += len(poses)
        return poses

    def say(self, now: float) -> bytes:
        """Return the banner if it is due, then telemetry; nothing while `silent`."""
        self.advance(now)
        data = b""
        if self._banner_due:
            self._banner_due = False
            content = Banner(frames.PROTOCOL_VERSION, *frames.FIRMWARE_VERSION, self._reset_cause)
            data += frames.banner(self._next(), content)
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
        flags = BoardFlags(sum(flag for flag, is_set in states.items() if is_set))
        widths = tuple(int(width + 0.5) for width in motion.telemetry_us)
        state = Telemetry(self.seq, flags, widths, self.dropped & _COUNTER, 0)
        data += frames.telemetry(self._next(), state)
        return b"" if self.silent else data

    def answer(self, now: float) -> bytes:
        """Return the board's number, if it was requested."""
        requested, self._identity_requested = self._identity_requested, False
        return frames.identity(self._next(), self.identity) if requested and not self.silent else b""

    def advance(self, now: float) -> None:
        """Let the servos move, and drop an unfinished packet in time."""
        self.motion.advance(now)
        self._drop_older(now, _PARTIAL_AT_MOST_S)

    @property
    def widths_us(self) -> tuple[float, ...] | None:
        """Widths that the servos have reached in [us]; None without pulses."""
        return self.motion.widths_us

    def _take_packet(self, servo_bytes: tuple[int, ...]) -> bool:
        """Accept a legacy packet, except during a hold, or while frames arrive.

        A flipped bit in a frame can look like a legacy packet.
        """
        if self.motion.hold_asked or (self._framed and self.motion.linked):
            self.refused += 1
            return False
        self._framed = False
        self.motion.command([byte_ticks(value) for value in servo_bytes])
        return True

    def _take_frame(self, frame: Frame) -> bool:
        """Execute a frame; return False, with nothing done, if one of its values is not allowed."""
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
            threes = list(zip(ticks[::3], ticks[1::3], ticks[2::3], strict=True))
            if not all(map(_is_width, numbers)) or any(sorted(each) != list(each) for each in threes):
                return False
            motion.ranges = [(least, largest) for least, _, largest in threes]
            motion.rest, self._limits_set = [rest for _, rest, _ in threes], True
        elif frame.kind is FrameType.SLEW:
            if not 1 <= numbers[0] <= SLEW_MAX_US:
                return False
            motion.slew = ticks[0]
        elif frame.kind is FrameType.IDENTIFY:
            if self.identity == frames.NO_IDENTITY:
                self.identity = frames.read_number(frame)
            self._identity_requested = True
        elif frame.kind in (FrameType.RELAX, FrameType.HOLD):
            motion.relaxed |= frame.kind is FrameType.RELAX
            motion.hold_asked |= frame.kind is FrameType.HOLD
            motion.stop()
        motion.record_command()
        self.seq, self._framed = frame.seq, True
        return True

    def _drop_older(self, now: float, age_s: float) -> None:
        self._legacy.drop_older(now, age_s)
        if self._frames.begun and now - self._begun > age_s:
            self._frames.drop()

    def _next(self) -> int:
        self._own_seq = (self._own_seq + 1) % frames.SEQUENCES
        return self._own_seq


def _is_width(us: int) -> bool:
    return PULSE_MIN_US <= us <= PULSE_MAX_US
