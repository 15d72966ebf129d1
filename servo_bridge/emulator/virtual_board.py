"""A board without hardware: a pseudo-terminal that speaks the board's side of a protocol.

It behaves like the model that a protocol has of its boards (`BoardProtocol.board_model`). The default model
sends nothing, drops an unfinished packet when the port is opened, and stays at the last servo bytes when no
packets arrive. The firmware itself runs in the emulator.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from servo_bridge.emulator.pty import MasterEnd, PtyBoard
from servo_bridge.protocols import AUTO, model_of_board
from softsim_core.scene import Servo, ServoCalibration

# Time in [s] from the opening of the port to the first message; a real board's boot loader takes 1.4 s
START_S = 0.2

# Reset causes of a board that is plugged in, and of one with a port that is opened
RESET_POWER_ON, RESET_EXTERNAL = 1, 2
IDLE_POLL_S = 0.02  # interval in [s] at which a port is checked that no program has open


@dataclass(frozen=True, slots=True)
class ReceivedPacket:
    """Servo bytes, or pulses, of one accepted packet, and its time on `time.monotonic` in [s]."""

    time_s: float
    servo_bytes: tuple[int, ...]


class VirtualBoard(PtyBoard):
    """A pseudo-terminal with a model of a servo board behind it; use it as a context manager.

    Args:
        servos: The servos that it drives; a number stands for that many hobby servos.
        link: Path of a symbolic link to the port, replaced at once when the port changes; None for none.
        log_length: Number of packets stored in `packets`; older ones are dropped.
        protocol: Name of its protocol; "auto" gives a board that does not identify itself, or a bus of
            servos.

    Attributes:
        model: The model behind the port.
        servo_bytes: Newest command of the servos in degrees or pulses; None before the first packet.

    Raises:
        ProtocolError: the protocol is unknown, or has no model of a board with these servos.
        PortError: the link cannot be created, or its path exists and is no link.
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
        self.servo_bytes: tuple[int, ...] | None = None
        self.replug()

    @property
    def widths_us(self) -> tuple[float, ...] | None:
        """Widths in [us] that the servos have reached; None without pulses, or if not modelled."""
        with self._changed:
            return self.model.widths_us

    @property
    def packets(self) -> list[ReceivedPacket]:
        """Accepted packets, oldest first."""
        with self._changed:
            return list(self._log)

    @property
    def accepted(self) -> int:
        """Number of poses accepted by the board so far."""
        with self._changed:
            return self.model.accepted

    @property
    def dropped(self) -> int:
        """Number of packets dropped or refused by the board so far."""
        with self._changed:
            return self.model.dropped

    def clear(self) -> None:
        """Drop the packets logged so far; the servos are unchanged."""
        with self._changed:
            self._log.clear()

    def restart(self, cause: int) -> None:
        """Reset the board, which loses its pose; `cause` as in `BoardModel.reset`."""
        with self._changed:
            self.servo_bytes = None
            self.model.reset(cause)
            self._changed.notify_all()

    def _power_on(self) -> None:
        self.model.reset(RESET_POWER_ON)

    def _power_off(self) -> None:
        self.servo_bytes = None

    def _serve(self, end: MasterEnd) -> None:
        while True:
            patience_s: float | None = 0.0  # the opening of the port alone does not wake a poll
            if self.is_open:
                speaks = self.model.say_period_s is not None
                patience_s = max(self._say_due - time.monotonic(), 0.0) if speaks else None
            received = end.receive(patience_s)
            if received is None:
                return
            data, opened = received
            if data:
                self._take(data, end)
            if opened != self.is_open:
                with self._changed:
                    self.is_open = opened
                    if self.is_open:
                        self.open_count += 1
                        self.model.reset(RESET_EXTERNAL)
                        self._say_due = time.monotonic() + START_S
                    self._changed.notify_all()
            if self.is_open:
                self._say_if_due(end)
                continue
            with self._changed:
                self.model.advance(time.monotonic())
                self._changed.notify_all()
            if end.pause(IDLE_POLL_S):
                return

    def _say_if_due(self, end: MasterEnd) -> None:
        now, period_s = time.monotonic(), self.model.say_period_s
        if period_s is None or now < self._say_due:
            return
        with self._changed:
            data = self.model.say(now)
            self._changed.notify_all()
        self._say_due = now + period_s
        if data:
            end.write(data)

    def _take(self, data: bytes, end: MasterEnd) -> None:
        now = time.monotonic()
        with self._changed:
            self.received += len(data)
            for servo_bytes in self.model.feed(data, now):
                self.servo_bytes = servo_bytes
                self._log.append(ReceivedPacket(now, servo_bytes))
            answer = self.model.answer(now)
            self._changed.notify_all()
        if answer:
            end.write(answer)
