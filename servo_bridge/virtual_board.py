"""A board without hardware: a pseudo-terminal that speaks the board's side of the protocol.

As a plain board it says nothing, forgets a packet begun when the port is opened, and keeps the last servo
bytes when the line falls silent. On request it speaks the extended protocol as well: banner when opened,
frames, telemetry, slew limit and creep to rest, in a Python model of the firmware; the firmware itself runs
in the emulator.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from servo_bridge.codec import PacketParser
from servo_bridge.extended_board import TELEMETRY_PERIOD_S, ExtendedBoard
from servo_bridge.pty_board import MasterEnd, PtyBoard

START_S = 0.2
"""Time in [s] from the opening of the port to the banner; a real board's boot loader takes 1.4 s."""

IDLE_POLL_S = 0.02
"""How often a port that nobody has open is looked at, in [s]."""


@dataclass(frozen=True, slots=True)
class ReceivedPacket:
    """Servo bytes of one accepted packet and when it came, on `time.monotonic`, in [s]."""

    time_s: float
    servo_bytes: tuple[int, ...]


class VirtualBoard(PtyBoard):
    """A pseudo-terminal with a model of a servo board behind it; use it as a context manager.

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
        super().__init__(link)
        self.servo_count = servo_count
        self._parser = PacketParser(servo_count)
        self.extended = ExtendedBoard(self._parser) if extended else None
        self._telemetry_due = 0.0
        self._log: deque[ReceivedPacket] = deque(maxlen=log_length)
        self._servo_bytes: tuple[int, ...] | None = None
        self.replug()

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

    def _power_on(self) -> None:
        """Nothing to do: a board begins anew whenever it is opened."""

    def _power_off(self) -> None:
        self._servo_bytes = None

    def _serve(self, end: MasterEnd) -> None:
        while (heard := end.hear(self._patience_s())) is not None:
            if heard.data:
                self._take(heard.data)
            self._set_open(heard.opened)
            if heard.opened:
                self._speak(end)
                continue
            if self.extended is not None:
                with self._changed:
                    self.extended.motion.advance(time.monotonic())
            if end.pause(IDLE_POLL_S):
                return

    def _patience_s(self) -> float | None:
        if not self._opened:
            return 0.0  # an opening by itself wakes no poll
        if self.extended is None:
            return None
        return max(self._telemetry_due - time.monotonic(), 0.0)

    def _speak(self, end: MasterEnd) -> None:
        """What the board has to say by now."""
        now = time.monotonic()
        if self.extended is None or now < self._telemetry_due:
            return
        with self._changed:
            data = self.extended.say(now)
            if self.extended.silent:
                data = b""
        self._telemetry_due = now + TELEMETRY_PERIOD_S
        if data:
            end.write(data)

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
            self._received += len(data)
            board = self._parser if self.extended is None else self.extended
            for servo_bytes in board.feed(data, now):
                self._servo_bytes = servo_bytes
                self._log.append(ReceivedPacket(now, servo_bytes))
            self._changed.notify_all()
