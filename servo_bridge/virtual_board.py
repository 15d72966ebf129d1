"""A board without hardware: a pseudo-terminal that speaks the board's side of the protocol.

The bridge opens it with real pyserial on a real tty. As a plain board it says nothing, forgets a packet
begun when the port is opened, and keeps the last servo bytes when the line falls silent. On request it speaks
the extended protocol as well: banner when opened, frames, telemetry, slew limit and creep to rest, in a
Python model of the firmware; the firmware itself runs in the emulator.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from servo_bridge.codec import PacketParser
from servo_bridge.extended_board import TELEMETRY_PERIOD_S, ExtendedBoard
from servo_bridge.port_link import make_link, remove_link

START_S = 0.2
"""Time in [s] from the opening of the port to the banner; a real board's boot loader takes 1.4 s."""

IDLE_POLL_S = 0.02
"""How often a port that nobody has open is looked at, in [s]."""


@dataclass(frozen=True, slots=True)
class ReceivedPacket:
    """Servo bytes of one accepted packet and when it came, on `time.monotonic`, in [s]."""

    time_s: float
    servo_bytes: tuple[int, ...]


class VirtualBoard:
    """A pseudo-terminal with a servo board behind it; use it as a context manager.

    Args:
        servo_count: Servo bytes in a packet.
        link: Path of a symbolic link to the port, replaced at once when the port changes; None for none.
        log_length: Packets kept in `packets`; older ones are forgotten.
        extended: Speak the extended protocol, too; a legacy packet stays accepted.

    Raises:
        PortError: the link cannot be made, or something that is no link is in its place.
    """

    def __init__(
        self,
        servo_count: int = 3,
        link: Path | str | None = None,
        log_length: int = 100_000,
        extended: bool = False,
    ) -> None:
        self.servo_count = servo_count
        self.link = None if link is None else Path(link)
        self._parser = PacketParser(servo_count)
        self.extended = ExtendedBoard(self._parser) if extended else None
        self._telemetry_due = 0.0
        self._log: deque[ReceivedPacket] = deque(maxlen=log_length)
        self._changed = threading.Condition()
        self._servo_bytes: tuple[int, ...] | None = None
        self._raw_bytes = 0
        self._opened = False
        self._open_count = 0
        self._device = ""
        self._master: int | None = None
        self._thread: threading.Thread | None = None
        self.replug()

    @property
    def port(self) -> str:
        """Name to open: the link where there is one, else the pseudo-terminal (empty while unplugged)."""
        return self._device if self.link is None else str(self.link)

    @property
    def servo_bytes(self) -> tuple[int, ...] | None:
        """What the servos are told now, in [deg] of the servo; None before the first packet (no pulses)."""
        with self._changed:
            return self._servo_bytes

    @property
    def widths_us(self) -> tuple[float, ...] | None:
        """Widths in [us] that the extended board's motion has reached; None without pulses."""
        with self._changed:
            return None if self.extended is None else self.extended.motion.widths_us

    @property
    def packets(self) -> list[ReceivedPacket]:
        """Accepted packets, oldest first."""
        with self._changed:
            return list(self._log)

    @property
    def accepted(self) -> int:
        """Poses accepted by the board so far."""
        with self._changed:
            return (self.extended or self._parser).accepted

    @property
    def dropped(self) -> int:
        """Packets (and frames) dropped or refused by the board so far."""
        with self._changed:
            return self._parser.dropped if self.extended is None else self.extended.rejects

    @property
    def received(self) -> int:
        """Bytes received so far, good or bad."""
        with self._changed:
            return self._raw_bytes

    @property
    def is_open(self) -> bool:
        """Whether some program has the port open."""
        with self._changed:
            return self._opened

    @property
    def open_count(self) -> int:
        """How many times the port was seen to be opened (each one resets a real board)."""
        with self._changed:
            return self._open_count

    def wait_for(self, predicate: Callable[[VirtualBoard], bool], deadline_s: float = 10.0) -> bool:
        """Wait until `predicate(board)` holds, looking at every packet, opening and closing.

        Returns:
            False when `deadline_s` seconds passed first.
        """
        with self._changed:
            return self._changed.wait_for(lambda: predicate(self), timeout=deadline_s)

    def clear(self) -> None:
        """Forget the packets logged so far; the servos stay."""
        with self._changed:
            self._log.clear()

    def restart(self, cause: int) -> None:
        """Reset the board, which forgets its pose; `cause` as in `frames.Banner`."""
        with self._changed:
            self._parser.reset()
            self._servo_bytes = None
            if self.extended is not None:
                self.extended.reset(cause)
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
        self._master = None
        remove_link(self.link, self._device)
        with self._changed:
            self._opened, self._servo_bytes, self._device = False, None, ""
            self._changed.notify_all()

    def replug(self) -> None:
        """Put the cable back: a new port (most often with another number) behind the same link.

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
            os.close(slave)  # from here on a hang-up on the master means that nobody has the port open
        os.set_blocking(master, False)
        self._master = master
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(
            target=self._serve, args=(master, self._wake_read), name="virtual_board", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Remove the port and its link; a second call does nothing."""
        self.unplug()

    def __enter__(self) -> VirtualBoard:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _serve(self, master: int, wake: int) -> None:
        both, idle = select.poll(), select.poll()
        both.register(master, select.POLLIN)
        both.register(wake, select.POLLIN)
        idle.register(wake, select.POLLIN)
        while True:
            events = dict(both.poll(self._patience_ms()))
            if wake in events:
                return
            state = events.get(master, 0)
            if state & select.POLLIN:
                self._take(_read(master))
            if state & select.POLLHUP:
                self._set_open(False)
                if self.extended is not None:
                    with self._changed:
                        self.extended.motion.advance(time.monotonic())
                if idle.poll(IDLE_POLL_S * 1000.0):
                    return
            else:
                self._set_open(True)
                self._speak(master)

    def _patience_ms(self) -> float | None:
        if not self._opened:
            return 0.0  # an opening by itself wakes no poll
        if self.extended is None:
            return None
        return max(self._telemetry_due - time.monotonic(), 0.0) * 1000.0

    def _speak(self, master: int) -> None:
        """What the board has to say by now; what a full line does not take is lost, as on the wire."""
        now = time.monotonic()
        if self.extended is None or now < self._telemetry_due:
            return
        with self._changed:
            data = self.extended.say(now)
            if self.extended.silent:
                data = b""
        self._telemetry_due = now + TELEMETRY_PERIOD_S
        if data:
            with contextlib.suppress(OSError):
                os.write(master, data)

    def _set_open(self, opened: bool) -> None:
        with self._changed:
            if opened != self._opened:
                self._opened = opened
                self._open_count += opened
                self._parser.reset()
                if opened and self.extended is not None:
                    self.extended.reset()
                    self._telemetry_due = time.monotonic() + START_S
                self._changed.notify_all()

    def _take(self, data: bytes) -> None:
        now = time.monotonic()
        with self._changed:
            self._raw_bytes += len(data)
            board = self._parser if self.extended is None else self.extended
            for servo_bytes in board.feed(data, now):
                self._servo_bytes = servo_bytes
                self._log.append(ReceivedPacket(now, servo_bytes))
            self._changed.notify_all()


def _read(master: int) -> bytes:
    try:
        return os.read(master, 4096)
    except OSError:  # nobody has the port open any more: the hang-up that follows says so
        return b""
