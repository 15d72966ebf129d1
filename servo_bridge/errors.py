"""Errors of the serial board; each message says what to do."""

from __future__ import annotations

from softsim_core.base import SoftSimError


class PacketError(SoftSimError, ValueError):
    """Bytes do not form a packet of the board's protocol."""


class PortError(SoftSimError, OSError):
    """A serial port cannot be found, opened or used; carries the port's name (empty if none was found)."""

    def __init__(self, port: str, message: str) -> None:
        self.port = port
        super().__init__(message)


class ProtocolError(SoftSimError, ValueError):
    """A board protocol is unknown, incomplete, or does not fit the robot's servos."""


class WriterError(SoftSimError, RuntimeError):
    """The thread that sends packets is dead or hangs: the board receives nothing any more."""
