"""The servo board with its real firmware in an emulated processor, in virtual time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

from servo_bridge.emulator.simavr import BAUD_RATE, EXTERNAL, FREQUENCY, POWER_ON, Processor, read_image

CHANNELS = 3
# A pin without a pulse for this time (40 ms, two periods) does not command its servo
QUIET_CYCLES = FREQUENCY // 25


class Pulse(NamedTuple):
    """One pulse on one pin."""

    channel: int  # 0, 1, 2 for the pins 9, 10, 11
    start: int  # cycle of the rising edge
    width: int  # cycles from the rising to the falling edge

    @property
    def start_s(self) -> float:
        """Start of the pulse in [s] since the first power-on."""
        return self.start / FREQUENCY

    @property
    def width_us(self) -> float:
        """Width in [us]."""
        return self.width * 1e6 / FREQUENCY


FIRMWARE = Path(__file__).resolve().parents[1] / "firmware" / "tripod.hex"  # the firmware of this package
FRAME_S = 0.020  # period of the servo pulses in [s]


class EmulatedBoard(AbstractContextManager["EmulatedBoard"]):
    """A servo board in lock-step: time passes only in `run`, and is the same on every execution.

    Args:
        hex_path: Firmware; None selects the one of this package.
        bootloader: Boot loader (Intel hex) that runs first after a reset; None for none.
        log_length: Number of pulses stored in `pulses`; older ones are dropped.
        baud_rate: Speed of the line to the board.

    Attributes:
        processor: The emulated processor, for tests of its internals.

    Raises:
        EmulatorMissingError: libsimavr is not installed.
        EmulatorError: an image cannot be read or does not fit.
    """

    def __init__(
        self,
        hex_path: Path | str | None = None,
        bootloader: Path | str | None = None,
        log_length: int = 1_000_000,
        baud_rate: int = BAUD_RATE,
    ) -> None:
        image = [read_image(FIRMWARE if hex_path is None else hex_path)]
        if bootloader is not None:
            image.append(read_image(bootloader))
        start = 0 if bootloader is None else image[-1][0]
        self._pulses: deque[Pulse] = deque(maxlen=log_length)
        self._cut_pulses: list[Pulse] = []
        self._rise: list[int | None] = [None] * CHANNELS  # cycle at which each pin rose, while it is high
        self._last: list[Pulse | None] = [None] * CHANNELS
        self._sent = bytearray()
        self.processor = Processor(image, start, self._take_edge, self._sent.append, self._cut, baud_rate)

    @property
    def time_s(self) -> float:
        """Virtual time since the first power-on, in [s]."""
        return self.processor.cycle / FREQUENCY

    @property
    def pulses(self) -> list[Pulse]:
        """Whole pulses on the three pins, oldest first."""
        return list(self._pulses)

    @property
    def cut_pulses(self) -> list[Pulse]:
        """Pulses that a reset cut short (the pins float from then on); not in `pulses`."""
        return list(self._cut_pulses)

    @property
    def transmitted(self) -> bytes:
        """Bytes that the firmware sent since the start or the last `take_transmitted`."""
        return bytes(self._sent)

    @property
    def resets(self) -> int:
        """Number of resets so far: power-on, external ones, the watchdog's."""
        return self.processor.resets

    @property
    def pending(self) -> int:
        """Number of bytes still on the line to the board."""
        return self.processor.waiting

    def take_transmitted(self) -> bytes:
        """Return the bytes that the firmware sent, and drop them here."""
        sent = bytes(self._sent)
        self._sent.clear()
        return sent

    def clear(self) -> None:
        """Drop the pulses and the sent bytes so far; the board runs on."""
        self._pulses.clear()
        self._cut_pulses.clear()
        self._sent.clear()

    def feed(self, data: bytes) -> None:
        """Put bytes on the line; they arrive one after the other as time passes."""
        self.processor.feed(data)

    def run(self, seconds: float) -> None:
        """Advance virtual time by `seconds`."""
        self.processor.run_to(self.processor.cycle + round(seconds * FREQUENCY))

    def run_until(self, predicate: Callable[[EmulatedBoard], bool], limit_s: float = 10.0) -> bool:
        """Advance virtual time, a quarter period at a time, until `predicate(board)` holds.

        Returns:
            False if `limit_s` seconds of virtual time passed first.
        """
        end = self.time_s + limit_s
        while not predicate(self):
            if self.time_s >= end:
                return False
            self.run(FRAME_S / 4.0)
        return True

    def widths_us(self) -> tuple[float, ...] | None:
        """Return the widths of the newest pulses on pins 9, 10, 11 in [us]; None without pulses."""
        since = self.processor.cycle - QUIET_CYCLES
        newest = tuple(pulse.width_us for pulse in self._last if pulse and pulse.start >= since)
        return newest if len(newest) == CHANNELS else None

    def settle(self, limit_s: float = 10.0) -> tuple[float, ...] | None:
        """Advance until the line is empty and the widths are the same for three periods, or `limit_s`.

        Returns:
            The widths in [us], or None without pulses.
        """
        self.run_until(lambda board: not board.pending, limit_s)
        end = self.time_s + limit_s
        before, same = self.widths_us(), 0
        while same < 3 and self.time_s < end:
            self.run(FRAME_S)
            now = self.widths_us()
            steady = (now is None) == (before is None) and all(
                abs(a - b) < 2.0 for a, b in zip(now or (), before or (), strict=True)
            )
            before, same = now, same + 1 if steady else 0
        return before

    def reset(self) -> None:
        """Press the reset button, as opening the port does on a real board."""
        self._cut()
        self.processor.reset(EXTERNAL)

    def power_cycle(self) -> None:
        """Switch the power off and on: the processor's memory is lost."""
        self._cut()
        self.processor.forget_memory()
        self.processor.reset(POWER_ON)

    def _take_edge(self, channel: int, level: int, cycle: int) -> None:
        rise = self._rise[channel]
        if level:
            self._rise[channel] = cycle if rise is None else rise
        elif rise is not None:
            self._rise[channel] = None
            self._last[channel] = pulse = Pulse(channel, rise, cycle - rise)
            self._pulses.append(pulse)

    def _cut(self) -> None:
        """Record a reset of the processor: a pulse in progress ends here."""
        cycle = self.processor.cycle
        for channel, rise in enumerate(self._rise):
            if rise is not None:
                self._cut_pulses.append(Pulse(channel, rise, cycle - rise))
        self._rise, self._last = [None] * CHANNELS, [None] * CHANNELS

    def close(self) -> None:
        """Free the emulator's memory."""
        self.processor.close()

    def __exit__(self, *error: object) -> None:
        self.close()
