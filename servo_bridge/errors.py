"""Errors of the serial board; each is one sentence that says what to do."""

from __future__ import annotations

from softsim_core.base.errors import SoftSimError


class PacketError(SoftSimError, ValueError):
    """Bytes are not a packet of the board's protocol."""


class PortError(SoftSimError, OSError):
    """A serial port cannot be found, opened or used; carries the port's name (empty when none was found)."""

    def __init__(self, port: str, sentence: str) -> None:
        self.port = port
        super().__init__(sentence)


class ProtocolError(SoftSimError, ValueError):
    """A board protocol is unknown, not whole, or does not fit the robot's servos."""


class WriterError(SoftSimError, RuntimeError):
    """The thread that sends packets is dead or hangs: the board is told nothing any more."""
