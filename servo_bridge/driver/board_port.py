"""One board's port: opened, listened to, and told the words that its protocol has. No motion; no ROS."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Literal, TypeAlias

from servo_bridge.driver.link import BoardLink, MetBoard, Reader
from servo_bridge.driver.ports import Transport
from servo_bridge.errors import PortError
from servo_bridge.protocols import WAITING, Ability, BoardProtocol, TiltReading
from softsim_core.scene.board import BoardDescription

Word: TypeAlias = Literal[Ability.HOLD, Ability.RELAX]


class BoardPort:
    """A port to a board that speaks one of some protocols.

    Args:
        board: The robot's board.
        candidates: Protocols that it may speak; see `link`.
        baud_rate: Bits a second.
        on_tilt: Called with every reading of the board's IMU, in the reading thread.
        clock: Steady clock in [s].

    Attributes:
        link: The conversation; None without an open port.
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
        self._met: MetBoard | None = None  # on a port closed since

    @property
    def met(self) -> MetBoard | None:
        """The board that was spoken to since `connect`; None as long as none was."""
        return self._met if self.link is None else self.link.met

    @property
    def port(self) -> str:
        """Name of the port in use; empty without one."""
        return "" if self._transport is None else self._transport.port

    @property
    def connected(self) -> bool:
        """Whether a port is open."""
        return self._transport is not None

    @property
    def waiting(self) -> bool:
        """Whether the board is still given its quiet time after the port was opened."""
        return self.link_state == WAITING

    @property
    def link_state(self) -> str | None:
        """Name of the protocol found, or WAITING: it is too early to say; None without a port."""
        return None if self.link is None else self.link.state(self._clock())

    @property
    def holds(self) -> bool | None:
        """Whether the board can be told to stay where it is (ability HOLD); None while that is not known."""
        link = self.link
        return None if link is None or self.waiting else Ability.HOLD in link.board.abilities

    @property
    def telemetry_age(self) -> float | None:
        """Time in [s] since a board that says what it is last spoke; None before the first time."""
        return None if self.link is None else self.link.heard_age(self._clock())

    @property
    def tilt_age(self) -> float | None:
        """Time in [s] since the newest reading of the board's IMU; None before the first."""
        return None if self.link is None else self.link.tilt_age(self._clock())

    def listen(self) -> None:
        """Look whether the board still lives; the way to notice, without writing, that the port has vanished.

        Raises:
            PortError: the port vanished, telemetry stopped, or the board is not the one asked for.
        """
        if self.link is not None:
            self.link.check(self._clock())

    def _open(
        self, transport: Transport, quiet_s: float, before: MetBoard | None, silent_allowed: bool
    ) -> None:
        """Listen on a port that was opened; nothing is to be written for `quiet_s` unless the board spoke.

        Args:
            transport: The port.
            quiet_s: The time in [s].
            before: The board that has to be met again; None: any board.
            silent_allowed: A board that says nothing may be driven.
        """
        boards = [each(self.board) for each in self._candidates]
        self._transport = transport
        self.link = BoardLink(transport.port, boards, quiet_s, self._clock(), before, silent_allowed)
        self._reader = Reader(transport, self.link, self._clock, self.on_tilt)

    def _take_out(self, words: Sequence[Word] = ()) -> Callable[[], None]:
        """Forget the port; what is returned says the last words and closes it, and may hang."""
        self._met = self.met
        reader, self._reader = self._reader, None
        transport, self._transport = self._transport, None
        link, self.link = self.link, None

        def close() -> None:
            if transport is not None and link is not None:
                with contextlib.suppress(PortError):
                    for word in words:
                        _say(transport, link, word)
            if reader is not None:
                reader.stop()
            if transport is not None:
                transport.close()

        return close

    def _ask(self) -> None:
        """Ask the board what is to be known of it next, where that may be asked.

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

    def _say(self, word: Word) -> bool:
        """Write a word that says no pose; False, and nothing written, where the board does not know it.

        Raises:
            PortError: the port failed.
        """
        transport, link = self._transport, self.link
        return transport is not None and link is not None and _say(transport, link, word)


def _say(transport: Transport, link: BoardLink, word: Word) -> bool:
    with link.speaking() as board:
        if word not in board.abilities:
            return False
        packet = board.hold() if word is Ability.HOLD else board.relax()
    transport.write(packet)
    return True
