"""The emulated board behind a pseudo-terminal, in wall time: what a bridge opens like a real board's port.

How the port behaves, and why:

* Opening the port resets the board, as DTR does on a real one; plugging it in is a power-on. While nobody
  listens, what the firmware sends is dropped. The rest stands in `servo_bridge.emulator.pty`.
* Virtual time never runs ahead of wall time. Where this computer was busy and virtual time is more than 50 ms
  behind, it stays behind: to catch up by racing would let the firmware's time limits run out by mistake. So
  poses are to be asserted once they are settled, and statements about timing belong to the lock-step board.
* Stepping releases the interpreter's lock; one thread a board is fine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from servo_bridge.emulator.board import EmulatedBoard, Pulse
from servo_bridge.emulator.pty import MasterEnd, PtyBoard
from servo_bridge.emulator.simavr import BAUD_RATE, EmulatorError

SLICE_S = 0.004
"""Virtual time passes in pieces of about this length, in [s]."""

LARGEST_SLICE_S = 0.010
LARGEST_LAG_S = 0.050
LOG_LENGTH = 100_000


class EmulatedBoardPty(PtyBoard):
    """A servo board with its real firmware behind a pseudo-terminal; use it as a context manager.

    Args:
        hex_path: Firmware; None for this package's own.
        bootloader: Boot loader (Intel hex) that runs first after a reset; None for none.
        link: Path of a symbolic link to the port, replaced at once when the port changes; None for none.
        baud_rate: Speed of the line to the board; what the port is opened with does not matter.
        line: What the line makes of bytes, either way: noise, for tests; None leaves them as they are.
        log_length: Pulses kept in `pulses`; older ones are forgotten.

    Attributes:
        reset_wired: Whether opening the port resets the processor; False: its wire is cut, too.

    Raises:
        EmulatorMissingError: libsimavr is not installed.
        EmulatorError: an image cannot be read or does not fit.
        PortError: the link cannot be made, or something that is no link is in its place.
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
        self._failure = ""
        self.replug()

    @property
    def resets(self) -> int:
        """Resets so far: power-ons, openings of the port, the watchdog's."""
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

    @property
    def failure(self) -> str:
        """Why the processor stopped for good; empty while it runs."""
        with self._changed:
            return self._failure

    def widths_us(self) -> tuple[float, ...] | None:
        """Widths of the newest pulses on pins 9, 10, 11 in [us]; None while there are no pulses."""
        with self._changed:
            return None if self._end is None else self._board.widths_us()

    def read_flash(self, address: int, length: int) -> bytes:
        """Bytes of the board's program memory."""
        with self._changed:
            return bytes(self._board.processor.flash[address : address + length])

    def clear(self) -> None:
        """Forget the pulses logged so far; the board runs on."""
        with self._changed:
            self._board.clear()

    def kill(self) -> None:
        """Stop the board's processor for good, as a failed supply does; the port stays and says nothing."""
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
            heard = end.hear(0.0)
            if heard is None:
                return
            data = self._line(heard.data)
            behind = time.monotonic() - ahead - self._board.time_s
            if behind > LARGEST_LAG_S:
                ahead += behind - LARGEST_SLICE_S
            with self._changed:
                self._look_at_line(heard.opened)
                self._received += len(data)
                self._step(data, min(behind, LARGEST_SLICE_S))
                sent = self._board.take_transmitted()
                self._changed.notify_all()
            if sent and self._opened:
                end.write(self._line(sent))

    def _look_at_line(self, opened: bool) -> None:
        if opened and not self._opened:
            self._open_count += 1
            if self._running and self.reset_wired:
                self._board.reset()
                self._board.take_transmitted()
        self._opened = opened

    def _step(self, data: bytes, seconds: float) -> None:
        if not self._running:
            return
        self._board.feed(data)
        try:
            self._board.run(seconds)
        except EmulatorError as error:
            self._failure = str(error)
            self._running = False
