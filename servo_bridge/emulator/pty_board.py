"""The emulated board behind a pseudo-terminal, in wall time: what a bridge opens like a real board's port.

How the port behaves, and why:

* The slave end is made raw and closed at once. From then on a hang-up on the master means that nobody has the
  port open, and its end means that somebody opened it: on a real board the moment at which DTR resets it. So
  it does here. While nobody listens, what the firmware sends is dropped.
* A stable name is a symbolic link that is replaced at once. Unplugging removes it and closes the master;
  plugging in again is a power-on behind a new port under the same link.
* Virtual time never runs ahead of wall time. Where this computer was busy and virtual time is more than 50 ms
  behind, it stays behind: to catch up by racing would let the firmware's time limits run out by mistake. So
  poses are to be asserted once they are settled, and statements about timing belong to the lock-step board.
* Stepping releases the interpreter's lock; one thread a board is fine.
"""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from servo_bridge.emulator.board import EmulatedBoard
from servo_bridge.emulator.errors import EmulatorError
from servo_bridge.emulator.pulses import Pulse
from servo_bridge.emulator.simavr import BAUD_RATE
from servo_bridge.port_link import make_link, remove_link

SLICE_S = 0.004
"""Virtual time passes in pieces of about this length, in [s]."""

LARGEST_SLICE_S = 0.010
LARGEST_LAG_S = 0.050
LOG_LENGTH = 100_000


class EmulatedBoardPty:
    """A servo board with its real firmware behind a pseudo-terminal; use it as a context manager.

    Args:
        hex_path: Firmware; None for this package's own.
        bootloader: Boot loader (Intel hex) that runs first after a reset; None for none.
        link: Path of a symbolic link to the port, replaced at once when the port changes; None for none.
        baud_rate: Speed of the line to the board; what the port is opened with does not matter.
        line: What the line makes of bytes, either way: noise, for tests; None leaves them as they are.

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
    ) -> None:
        self.link = None if link is None else Path(link)
        self._board = EmulatedBoard(hex_path, bootloader, LOG_LENGTH, baud_rate)
        self._line = line or bytes
        self._changed = threading.Condition()
        self._opened = False
        self._open_count = 0
        self._received = 0
        self._running = True
        self._failure = ""
        self._device = ""
        self._master: int | None = None
        self._thread: threading.Thread | None = None
        self.replug()

    @property
    def port(self) -> str:
        """Name to open: the link where there is one, else the pseudo-terminal (empty while unplugged)."""
        return self._device if self.link is None else str(self.link)

    @property
    def is_open(self) -> bool:
        """Whether some program has the port open."""
        with self._changed:
            return self._opened

    @property
    def open_count(self) -> int:
        """How many times the port was opened; each one reset the board."""
        with self._changed:
            return self._open_count

    @property
    def received(self) -> int:
        """Bytes that came from the computer so far, good or bad."""
        with self._changed:
            return self._received

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
            return None if self._master is None else self._board.widths_us()

    def read_flash(self, address: int, length: int) -> bytes:
        """Bytes of the board's program memory."""
        with self._changed:
            return bytes(self._board.processor.flash[address : address + length])

    def wait_for(self, predicate: Callable[[EmulatedBoardPty], bool], deadline_s: float = 10.0) -> bool:
        """Wait until `predicate(board)` holds, looking after every slice of virtual time.

        Returns:
            False when `deadline_s` seconds passed first.
        """
        with self._changed:
            return self._changed.wait_for(lambda: predicate(self), timeout=deadline_s)

    def clear(self) -> None:
        """Forget the pulses logged so far; the board runs on."""
        with self._changed:
            self._board.clear()

    def kill(self) -> None:
        """Stop the board's processor for good, as a failed supply does; the port stays and says nothing."""
        with self._changed:
            self._running = False
            self._changed.notify_all()

    def unplug(self) -> None:
        """Pull the cable: the port vanishes under whoever has it open. The servos lose power."""
        if self._master is None:
            return
        os.write(self._wake_write, b"x")
        if self._thread is not None:
            self._thread.join()
        os.close(self._master)
        os.close(self._wake_read)
        os.close(self._wake_write)
        remove_link(self.link, self._device)
        with self._changed:
            self._master = None
            self._opened, self._device = False, ""
            self._changed.notify_all()

    def replug(self) -> None:
        """Put the cable back: a power-on behind a new port (most often another number) and the same link.

        Raises:
            PortError: the link cannot be made.
        """
        if self._master is not None:
            return
        master, slave = os.openpty()
        try:
            tty.setraw(slave)
            self._device = os.ttyname(slave)
            make_link(self.link, self._device)
        except BaseException:
            os.close(master)
            raise
        finally:
            os.close(slave)
        os.set_blocking(master, False)
        with self._changed:
            self._board.power_cycle()
            self._running = True
            self._master = master
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(
            target=self._serve, args=(master, self._wake_read), name="emulated_board", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Remove the port and its link, and free the emulator; a second call does nothing."""
        self.unplug()
        self._board.close()

    def __enter__(self) -> EmulatedBoardPty:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _serve(self, master: int, wake: int) -> None:
        line, pause = select.poll(), select.poll()
        line.register(master, select.POLLIN)
        pause.register(wake, select.POLLIN)
        ahead = time.monotonic() - self._board.time_s  # wall time minus virtual time
        while not pause.poll(SLICE_S * 1000.0):
            events = dict(line.poll(0)).get(master, 0)
            data = self._line(_read(master)) if events & select.POLLIN else b""
            behind = time.monotonic() - ahead - self._board.time_s
            if behind > LARGEST_LAG_S:
                ahead += behind - LARGEST_SLICE_S
            with self._changed:
                self._look_at_line(not events & select.POLLHUP)
                self._received += len(data)
                self._step(data, min(behind, LARGEST_SLICE_S))
                sent = self._board.take_transmitted()
                self._changed.notify_all()
            if sent and self._opened:
                _write(master, self._line(sent))

    def _look_at_line(self, opened: bool) -> None:
        if opened and not self._opened:
            self._open_count += 1
            if self._running:
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


def _read(master: int) -> bytes:
    try:
        return os.read(master, 4096)
    except OSError:  # nobody has the port open any more: the hang-up that follows says so
        return b""


def _write(master: int, data: bytes) -> None:
    try:
        os.write(master, data)
    except (
        OSError
    ):  # closed a moment ago, or nobody reads and the port is full: a real board's bytes are lost too
        return
