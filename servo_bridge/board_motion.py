"""How the firmware moves its servos, in Python: slew limit, ranges, hold, creep to rest. Pure, no I/O.

The rules and numbers are those of firmware/tripod.c, in its unit: ticks of half a microsecond, frames of
20 ms. A property test holds both to each other.
"""

from __future__ import annotations

from collections.abc import Sequence

from servo_bridge.frames import PULSE_MIN_US, PULSE_US_PER_180, SERVOS

FRAME_S = 0.020
"""Period of the servo pulses in [s]; once in it the widths move."""

TICKS_PER_US = 2
PULSE_MAX_US = PULSE_MIN_US + PULSE_US_PER_180
SLEW_MAX_US = 124

_SLEW, _CREEP = 122, 20  # ticks a frame
_HOLD_FRAMES, _REST_FRAMES = 25, 100
_REST_BYTE = 150
_LARGEST_LAG_S = 0.5


def byte_ticks(servo_byte: int) -> int:
    """Pulse width in ticks of a servo byte, rounded as in the firmware."""
    return PULSE_MIN_US * TICKS_PER_US + (servo_byte * PULSE_US_PER_180 * TICKS_PER_US + 90) // 180


class BoardMotion:
    """Widths of a board's servos, frame by frame; times are seconds of any steady clock.

    Attributes:
        started: A pose was commanded since the reset: before it there are no pulses.
        relaxed: The pulses were switched off.
        hold_asked: A frame asked to hold.
        slew: Largest change of a width in a frame, in ticks.
        ranges: Least and largest width of each servo in ticks.
    """

    def __init__(self) -> None:
        self.started = self.relaxed = self.hold_asked = False
        self.slew = _SLEW
        self.ranges = [(PULSE_MIN_US * TICKS_PER_US, PULSE_MAX_US * TICKS_PER_US)] * SERVOS
        self._current = [byte_ticks(_REST_BYTE)] * SERVOS
        self._target = list(self._current)
        self._silence = _REST_FRAMES  # frames since the newest valid command, saturating
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
        """Whether the servos creep to the rest pose, or stand there, for want of commands."""
        return self.active and self._silence >= _REST_FRAMES

    @property
    def holding(self) -> bool:
        """Whether the servos hold where they are: asked to, or for want of commands."""
        silent = _HOLD_FRAMES <= self._silence < _REST_FRAMES
        return self.started and not self.homing and (self.hold_asked or silent)

    @property
    def arrived(self) -> bool:
        """Whether the servos stand where they are to go."""
        return self._current == self._within(self._target)

    @property
    def widths_us(self) -> tuple[float, ...] | None:
        """Widths of the pulses in [us], one a servo; None without pulses."""
        return tuple(ticks / TICKS_PER_US for ticks in self._current) if self.active else None

    def command(self, ticks: Sequence[int]) -> None:
        """Go to a pose; the first one since the reset is taken at once."""
        self._target = self._within(ticks)
        if not self.started:
            self._current = list(self._target)
        self.started, self.relaxed, self.hold_asked = True, False, False
        self.heard()

    def stop(self) -> None:
        """Stay where the servos are."""
        self._target = list(self._current)

    def heard(self) -> None:
        """A valid command came."""
        self._silence = 0

    def advance(self, now: float) -> None:
        """Let the frames up to `now` pass; where nobody looked for long, time stretches instead of racing."""
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
        if self._silence >= _REST_FRAMES and not self.relaxed:
            self.hold_asked = False
            self._target = [byte_ticks(_REST_BYTE)] * SERVOS
            step = min(step, _CREEP)
        self._current = [
            now + max(-step, min(step, wanted - now))
            for wanted, now in zip(self._within(self._target), self._current, strict=True)
        ]

    def _within(self, ticks: Sequence[int]) -> list[int]:
        return [min(max(each, low), high) for each, (low, high) in zip(ticks, self.ranges, strict=True)]
