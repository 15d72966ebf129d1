"""The port of one board: open, listen, and send the packets that carry no pose. No motion, no ROS."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Literal, TypeAlias

from servo_bridge import PortError
from servo_bridge.driver.link import BoardLink, MetBoard, Reader
from servo_bridge.driver.ports import Transport
from servo_bridge.protocols import WAITING, Ability, BoardProtocol, TiltReading
from softsim_core.scene import BoardDescription

PoselessPacket: TypeAlias = Literal[Ability.HOLD, Ability.RELAX]


class BoardPort:
    """A port to a board that speaks one of several protocols.

    Args:
        board: The robot's board.
        candidates: Protocols that the board may speak; see `link`.
        baud_rate: Bits per second.
        on_tilt: Called in the reading thread with every reading of the board's IMU.
        clock: Steady clock in [s].

    Attributes:
        link: State of the open port; None without one.
    """

    def __init__(
        self,
        board: BoardDescription,
        candidates: Sequence[type[BoardProtocol]],
        baud_rate: int,
        on_tilt: Callable[[TiltReading], None],
        clock: Callable[[], float],
    ) -> None:
        self.board, self.servos = board, board.servos
        self.baud_rate = baud_rate
        self.on_tilt = on_tilt
        self.link: BoardLink | None = None
        self._candidates, self._clock = tuple(candidates), clock
        self._transport: Transport | None = None
        self._reader: Reader | None = None
        self._met: MetBoard | None = None  # of a port that is closed again

    @property
    def met(self) -> MetBoard | None:
        """Board accepted since `connect`, or before it with `again`; None before the first."""
        return self._met if self.link is None else self.link.met

    @property
    def port(self) -> str:
        """Name of the open port; empty without one."""
        return "" if self._transport is None else self._transport.port

    @property
    def connected(self) -> bool:
        """Whether a port is open."""
        return self._transport is not None

    @property
    def waiting(self) -> bool:
        """Whether the quiet time after the opening of the port still runs."""
        return self.link_state == WAITING

    @property
    def link_state(self) -> str | None:
        """Name of the protocol in use, or WAITING while it is not known yet; None without a port."""
        return None if self.link is None else self.link.state(self._clock())

    @property
    def holds(self) -> bool | None:
        """Whether the board has the ability HOLD; None while that is not known."""
        link = self.link
        return None if link is None or self.waiting else Ability.HOLD in link.board.abilities

    @property
    def telemetry_age(self) -> float | None:
        """Time in [s] since the newest message that identifies the protocol; None before the first."""
        return None if self.link is None else self.link.telemetry_age(self._clock())

    @property
    def tilt_age(self) -> float | None:
        """Time in [s] since the newest reading of the board's IMU; None before the first."""
        return None if self.link is None else self.link.tilt_age(self._clock())

    def listen(self) -> None:
        """Check that the board is still present; detects a vanished port without writing to it.

        Raises:
            PortError: the port vanished, telemetry stopped, or the board is not the one asked for.
        """
        if self.link is not None:
            self.link.check(self._clock())

    def _open(
        self, transport: Transport, quiet_s: float, before: MetBoard | None, silent_allowed: bool
    ) -> None:
        """Start to listen on an open port; nothing is written for `quiet_s` unless the board sends first.

        Args:
            transport: The port.
            quiet_s: The time in [s].
            before: The only board that is accepted; None accepts any.
            silent_allowed: Whether a board that sends nothing may be driven.
        """
        boards = [each(self.board) for each in self._candidates]
        self._transport = transport
        self.link = BoardLink(transport.port, boards, quiet_s, self._clock(), before, silent_allowed)
        self._reader = Reader(transport, self.link, self._clock, self.on_tilt)

    def _take_out(self, packets: Sequence[PoselessPacket] = ()) -> Callable[[], None]:
        """Detach the port and return a function that sends the last packets and closes it.

        The returned function may block for as long as the port or the protocol does.
        """
        self._met = self.met
        reader, self._reader = self._reader, None
        transport, self._transport = self._transport, None
        link, self.link = self.link, None

        def close() -> None:
            if transport is not None and link is not None:
                with contextlib.suppress(PortError):
                    for packet_kind in packets:
                        _say(transport, link, packet_kind)
            if reader is not None:
                reader.stop()
            if transport is not None:
                transport.close()

        return close

    def _ask(self) -> None:
        """Send the next query of the protocol, if there is one and the board may be queried.

        Raises:
            PortError: the port failed.
        """
        transport, link = self._transport, self.link
        if transport is None or link is None:
            return
        with link.speaking() as board:
            question = board.ask() if link.asks else b""
        if question:
            transport.write(question)

    def _say(self, packet_kind: PoselessPacket) -> bool:
        """Send a packet without a pose; return False, with nothing sent, if the board lacks the ability.

        Raises:
            PortError: the port failed.
        """
        transport, link = self._transport, self.link
        return transport is not None and link is not None and _say(transport, link, packet_kind)


def _say(transport: Transport, link: BoardLink, packet_kind: PoselessPacket) -> bool:
    with link.speaking() as board:
        if packet_kind not in board.abilities:
            return False
        packet = board.hold() if packet_kind is Ability.HOLD else board.relax()
    transport.write(packet)
    return True
