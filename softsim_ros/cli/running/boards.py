"""The board that `softsim up` gives the bridge: virtual or emulated in this process, or a real one's port."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from enum import Enum

from servo_bridge.nodes.board_node import BoardNode
from servo_bridge.nodes.virtual_board_node import VirtualBoardNode
from softsim_core.base.errors import SceneError
from softsim_core.scene import RobotDescription

EMULATED_SERVOS = 3
"""Servos of the firmware."""


class BoardKind(Enum):
    """What stands at the far end of the line; the value is the word of `--board`."""

    NONE = "none"
    VIRTUAL = "virtual"
    EMULATED = "emulated"
    REAL = "real"


@dataclass(frozen=True, slots=True)
class BoardChoice:
    """Which board the bridge talks to.

    Attributes:
        kind: NONE has no bridge at all.
        port: Port of a real one; empty searches for the one that is plugged in.
        send: Start sending at once, without waiting for key B.
    """

    kind: BoardKind
    port: str = ""
    send: bool = False


def quiet_s(kind: BoardKind) -> float | None:
    """Quiet time in [s] that the bridge shall leave a board after opening; None for the bridge's own."""
    return 0.0 if kind is BoardKind.VIRTUAL else None  # the virtual board has no boot loader to wait for


def local_board(
    stack: contextlib.ExitStack, robot: RobotDescription, namespace: str, kind: BoardKind
) -> BoardNode | None:
    """The node of a board in this process, closed by `stack`; None where it is not in this process.

    Raises:
        EmulatorMissingError: libsimavr is not installed.
        SceneError: the robot has another number of servos than the emulated firmware.
    """
    node: BoardNode
    if kind is BoardKind.VIRTUAL or (kind is BoardKind.EMULATED and _has_bus(robot)):
        node = VirtualBoardNode(described=robot.board, link="", namespace=namespace)
    elif kind is BoardKind.EMULATED:
        from servo_bridge.nodes.emulated_board_node import EmulatedBoardNode  # loads simavr: only when wanted

        if servo_count(robot) != EMULATED_SERVOS:
            raise SceneError(
                f"{robot.name} has {servo_count(robot)} servos, and the emulated firmware drives"
                f" {EMULATED_SERVOS}; use --board {BoardKind.VIRTUAL.value}"
            )
        node = EmulatedBoardNode(link="", namespace=namespace)
    else:
        return None
    stack.callback(node.destroy_node)
    return node


def _has_bus(robot: RobotDescription) -> bool:
    """Whether its servos are on a bus: then the virtual board emulates those, each with its control table."""
    return robot.board is not None and bool(robot.board.bus_servos)


def servo_count(robot: RobotDescription) -> int:
    """Servos of a robot's board; 0 without one."""
    return len(robot.board.servos) if robot.board else 0
