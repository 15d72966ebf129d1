"""A board without hardware: a pseudo-terminal that speaks the board's side of the protocol.

What it takes and says is the model that a protocol has of its boards (`BoardProtocol.board_model`), by
default one that says nothing, forgets a packet begun when the port is opened, and keeps the last servo bytes
when the line falls silent. The firmware itself runs in the emulator.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from servo_bridge.emulator.pty import MasterEnd, PtyBoard
from servo_bridge.protocols import AUTO, model_of_board
from softsim_core.scene.board import Servo, ServoCalibration

START_S = 0.2
"""Time in [s] from the opening of the port to the first word; a real board's boot loader takes 1.4 s."""

RESET_POWER_ON, RESET_EXTERNAL = 1, 2
"""Reset causes of a board that is plugged in, and of one whose port is opened."""

IDLE_POLL_S = 0.02
"""How often a port that nobody has open is looked at, in [s]."""


@dataclass(frozen=True, slots=True)
class ReceivedPacket:
    """Servo bytes, or pulses, of one accepted packet and when it came, on `time.monotonic`, in [s]."""

    time_s: float
    servo_bytes: tuple[int, ...]


class VirtualBoard(PtyBoard):
    """A pseudo-terminal with a model of a servo board behind it; use it as a context manager.

    Args:
        servos: What it drives; a number stands for so many hobby servos.
        link: Path of a symbolic link to the port, replaced at once when the port changes; None for none.
        log_length: Packets kept in `packets`; older ones are forgotten.
        protocol: Name of the protocol it speaks; auto: one that does not say what it is, or a bus of servos.

    Attributes:
        model: What is behind the port.

    Raises:
        ProtocolError: the protocol is unknown, or has no model of such a board.
        PortError: the link cannot be made, or something that is no link is in its place.
    """

    def __init__(
        self,
        servos: int | Sequence[Servo] = 3,
        link: Path | str | None = None,
        log_length: int = 100_000,
        protocol: str = AUTO,
    ) -> None:
        super().__init__(link)
        if isinstance(servos, int):
            servos = [ServoCalibration(joint=f"servo_{number}") for number in range(servos)]
        self.model = model_of_board(protocol, servos)
        self._say_due = 0.0
        self._log: deque[ReceivedPacket] = deque(maxlen=log_length)
        self._servo_bytes: tuple[int, ...] | None = None
        self.replug()

    @property
    def servo_bytes(self) -> tuple[int, ...] | None:
        """What the servos are told now, in degrees or pulses; None before the first packet."""
        with self._changed:
            return self._servo_bytes

    @property
    def widths_us(self) -> tuple[float, ...] | None:
        """Widths in [us] that the servos have reached; None without pulses, or where not modelled."""
        with self._changed:
            return self.model.widths_us

    @property
    def packets(self) -> list[ReceivedPacket]:
        """Accepted packets, oldest first."""
        with self._changed:
            return list(self._log)

    @property
    def accepted(self) -> int:
        """Poses accepted by the board so far."""
        with self._changed:
            return self.model.accepted

    @property
    def dropped(self) -> int:
        """Packets dropped or refused by the board so far."""
        with self._changed:
            return self.model.dropped

    def clear(self) -> None:
        """Forget the packets logged so far; the servos stay."""
        with self._changed:
            self._log.clear()

    def restart(self, cause: int) -> None:
        """Reset the board, which forgets its pose; `cause` as in `BoardModel.reset`."""
        with self._changed:
            self._servo_bytes = None
            self.model.reset(cause)
            self._changed.notify_all()

    def _power_on(self) -> None:
        self.model.reset(RESET_POWER_ON)

    def _power_off(self) -> None:
        self._servo_bytes = None

    def _serve(self, end: MasterEnd) -> None:
        while (heard := end.hear(self._patience_s())) is not None:
            if heard.data:
                self._take(heard.data, end)
            self._set_open(heard.opened)
            if heard.opened:
                self._speak(end)
                continue
            with self._changed:
                self.model.advance(time.monotonic())
                self._changed.notify_all()
            if end.pause(IDLE_POLL_S):
                return

    def _patience_s(self) -> float | None:
        if not self._opened:
            return 0.0  # an opening by itself wakes no poll
        if self.model.say_period_s is None:
            return None
        return max(self._say_due - time.monotonic(), 0.0)

    def _speak(self, end: MasterEnd) -> None:
        """What the board has to say unasked by now."""
        now, period_s = time.monotonic(), self.model.say_period_s
        if period_s is None or now < self._say_due:
            return
        with self._changed:
            data = self.model.say(now)
            self._changed.notify_all()
        self._say_due = now + period_s
        if data:
            end.write(data)

    def _set_open(self, opened: bool) -> None:
        with self._changed:
            if opened != self._opened:
                self._opened = opened
                self._open_count += opened
                if opened:
                    self.model.reset(RESET_EXTERNAL)
                    self._say_due = time.monotonic() + START_S
                self._changed.notify_all()

    def _take(self, data: bytes, end: MasterEnd) -> None:
        now = time.monotonic()
        with self._changed:
            self._received += len(data)
            for servo_bytes in self.model.feed(data, now):
                self._servo_bytes = servo_bytes
                self._log.append(ReceivedPacket(now, servo_bytes))
            answer = self.model.answer(now)
            self._changed.notify_all()
        if answer:
            end.write(answer)
