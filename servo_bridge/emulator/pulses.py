"""Servo pulses as the pins show them, measured in the processor's own cycles."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from servo_bridge.emulator.simavr import FREQUENCY

CHANNELS = 3
QUIET_CYCLES = FREQUENCY // 25
"""A pin without a pulse for so long (40 ms, two frames) tells its servo nothing."""


class Pulse(NamedTuple):
    """One pulse on one pin.

    Attributes:
        channel: 0, 1, 2 for the pins 9, 10, 11.
        start: Cycle of the rising edge.
        width: Cycles from the rising to the falling edge.
    """

    channel: int
    start: int
    width: int

    @property
    def start_s(self) -> float:
        """When it began, in [s] since the first power-on."""
        return self.start / FREQUENCY

    @property
    def width_us(self) -> float:
        """Width in [us]."""
        return self.width * 1e6 / FREQUENCY


class PulseLog:
    """Collects edges of the servo pins into pulses.

    Args:
        length: Pulses kept; older ones are forgotten.

    Attributes:
        pulses: Whole pulses, oldest first.
        cut: Pulses that a reset cut short (the pins float from then on); not in `pulses`.
    """

    def __init__(self, length: int) -> None:
        self.pulses: deque[Pulse] = deque(maxlen=length)
        self.cut: list[Pulse] = []
        self._rise: list[int | None] = [None] * CHANNELS
        self._last: list[Pulse | None] = [None] * CHANNELS

    def edge(self, channel: int, level: int, cycle: int) -> None:
        """Take an edge."""
        rise = self._rise[channel]
        if level:
            if rise is None:
                self._rise[channel] = cycle
        elif rise is not None:
            self._rise[channel] = None
            pulse = Pulse(channel, rise, cycle - rise)
            self.pulses.append(pulse)
            self._last[channel] = pulse

    def reset(self, cycle: int) -> None:
        """The processor was reset: a pulse that was on ends here."""
        for channel, rise in enumerate(self._rise):
            if rise is not None:
                self.cut.append(Pulse(channel, rise, cycle - rise))
        self._rise = [None] * CHANNELS
        self._last = [None] * CHANNELS

    def last(self, cycle: int) -> tuple[Pulse, ...] | None:
        """The newest pulse of each pin; None where a pin has had none for two frames."""
        newest = tuple(pulse for pulse in self._last if pulse and cycle - pulse.start <= QUIET_CYCLES)
        return newest if len(newest) == CHANNELS else None

    def clear(self) -> None:
        """Forget the pulses so far."""
        self.pulses.clear()
        self.cut.clear()
