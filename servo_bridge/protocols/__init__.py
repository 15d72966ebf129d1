"""Protocols of boards: the seam to a board of one's own.

Derive a class from `BoardProtocol` and `register` it in the robot's Python file; name it in the robot's board
settings (`BoardDescription(protocol=...)`) or in the bridge's parameter `protocol`.
"""

from __future__ import annotations

from servo_bridge.protocols.protocol import (
    Ability,
    BoardModel,
    BoardProtocol,
    Decoded,
    EncodedPacket,
    TiltReading,
)
from servo_bridge.protocols.registry import (
    AUTO,
    WAITING,
    candidates,
    model_of_board,
    names,
    protocol_named,
    register,
)

__all__ = [
    "AUTO",
    "WAITING",
    "Ability",
    "BoardModel",
    "BoardProtocol",
    "Decoded",
    "EncodedPacket",
    "TiltReading",
    "candidates",
    "model_of_board",
    "names",
    "protocol_named",
    "register",
]
