"""The emulated board behind a pseudo-terminal, in wall time: a bridge opens it like a real board's port.

How the port behaves, and why:

* Opening the port resets the board, as DTR does on a real one; plugging it in is a power-on. Bytes that the
  firmware sends while the port is closed are dropped. See `servo_bridge.emulator.pty` for the rest.
* Virtual time never runs ahead of wall time. If this computer was busy and virtual time is more than 50 ms
  behind, it stays behind: catching up quickly would let the firmware's time limits expire by mistake. So
  assert poses only once they are settled, and test timing with the lock-step board.
* Stepping releases the interpreter's lock, so one thread per board is enough.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from servo_bridge.emulator.board import EmulatedBoard, Pulse
from servo_bridge.emulator.pty import MasterEnd, PtyBoard
from servo_bridge.emulator.simavr import BAUD_RATE, EmulatorError

SLICE_S = 0.004  # virtual time advances in slices of about this length, in [s]
LARGEST_SLICE_S = 0.010
LARGEST_LAG_S = 0.050
LOG_LENGTH = 100_000


class EmulatedBoardPty(PtyBoard):
    """A servo board with its real firmware behind a pseudo-terminal; use it as a context manager.

    Args:
        hex_path, bootloader: As for `EmulatedBoard`.
        link: As for `PtyBoard`.
        baud_rate: Speed of the line to the board; the rate with which the port is opened does not matter.
        line: Function applied to bytes on the line in both directions, such as noise for tests; None changes
            nothing.
        log_length: Number of pulses stored in `pulses`; older ones are dropped.

    Attributes:
        failure: Message about why the processor stopped for good; empty while it runs.
        reset_wired: Whether opening the port resets the processor; False models a cut reset wire.

    Raises:
        EmulatorMissingError: libsimavr is not installed.
        EmulatorError: an image cannot be read or does not fit.
        PortError: the link cannot be created, or its path exists and is no link.
    """

    def __init__(
        self,
        hex_path: Path | str | None = None,
        bootloader: Path | str | None = None,
        link: Path | str | None = None,
        baud_rate: int = BAUD_RATE,
        line: Callable[[bytes], bytes] | None = None,
        log_length: int = LOG_LENGTH,
    ) -> None:
        super().__init__(link)
        self._board = EmulatedBoard(hex_path, bootloader, log_length, baud_rate)
        self._line = line or bytes
        self.reset_wired = True
        self._running = True
        self.failure = ""
        self.replug()

    @property
    def resets(self) -> int:
        """Number of resets so far: power-ons, openings of the port, the watchdog's."""
        with self._changed:
            return self._board.resets

    @property
    def time_s(self) -> float:
        """Virtual time of the board in [s]; it may lag behind the wall clock, and never runs ahead."""
        with self._changed:
            return self._board.time_s

    @property
    def pulses(self) -> list[Pulse]:
        """Whole pulses on the three pins, oldest first."""
        with self._changed:
            return self._board.pulses

    def widths_us(self) -> tuple[float, ...] | None:
        """Return the widths of the newest pulses on pins 9, 10, 11 in [us]; None without pulses."""
        with self._changed:
            return None if self._end is None else self._board.widths_us()

    def read_flash(self, address: int, length: int) -> bytes:
        """Return bytes of the board's program memory."""
        with self._changed:
            return bytes(self._board.processor.flash[address : address + length])

    def clear(self) -> None:
        """Drop the pulses logged so far; the board runs on."""
        with self._changed:
            self._board.clear()

    def kill(self) -> None:
        """Stop the board's processor for good, like a failed supply; the port stays and sends nothing."""
        with self._changed:
            self._running = False
            self._changed.notify_all()

    def close(self) -> None:
        """Remove the port and its link, and free the emulator; a second call does nothing."""
        super().close()
        self._board.close()

    def _power_on(self) -> None:
        self._board.power_cycle()
        self._running = True

    def _power_off(self) -> None:
        self._running = False

    def _serve(self, end: MasterEnd) -> None:
        ahead = time.monotonic() - self._board.time_s  # wall time minus virtual time
        while not end.pause(SLICE_S):
            received = end.receive(0.0)
            if received is None:
                return
            data, opened = self._line(received[0]), received[1]
            behind = time.monotonic() - ahead - self._board.time_s
            if behind > LARGEST_LAG_S:
                ahead += behind - LARGEST_SLICE_S
            with self._changed:
                if opened and not self.is_open:
                    self.open_count += 1
                    if self._running and self.reset_wired:
                        self._board.reset()
                        self._board.take_transmitted()
                self.is_open = opened
                self.received += len(data)
                if self._running:
                    self._board.feed(data)
                    try:
                        self._board.run(min(behind, LARGEST_SLICE_S))
                    except EmulatorError as error:
                        self.failure, self._running = str(error), False
                sent = self._board.take_transmitted()
                self._changed.notify_all()
            if sent and self.is_open:
                end.write(self._line(sent))
