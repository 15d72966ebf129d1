"""The board for the bridge of `softsim up`: virtual or emulated in this process, or a real one's port."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from enum import Enum

from servo_bridge.nodes import BoardNode, VirtualBoardNode
from softsim_core.base import SceneError
from softsim_core.scene import RobotDescription

EMULATED_SERVOS = 3
"""Number of servos of the firmware."""


class BoardKind(Enum):
    """Device at the far end of the line; the value is that of `--board`."""

    NONE = "none"
    VIRTUAL = "virtual"
    EMULATED = "emulated"
    REAL = "real"


@dataclass(frozen=True, slots=True)
class BoardChoice:
    """Board that the bridge talks to.

    Attributes:
        kind: NONE has no bridge at all.
        port: Port of a real board; empty searches for the one that is plugged in.
        send: Whether to start sending at once, without waiting for key B.
    """

    kind: BoardKind
    port: str = ""
    send: bool = False


def quiet_s(kind: BoardKind) -> float | None:
    """Return the time in [s] for which the bridge sends nothing after opening; None: the bridge's default."""
    return 0.0 if kind is BoardKind.VIRTUAL else None  # the virtual board has no boot loader to wait for


def local_board(
    stack: contextlib.ExitStack, robot: RobotDescription, namespace: str, kind: BoardKind
) -> BoardNode | None:
    """Return the node of a board in this process, closed by `stack`; None if the board is elsewhere.

    Raises:
        EmulatorMissingError: libsimavr is not installed.
        SceneError: the robot has another number of servos than the emulated firmware.
    """
    node: BoardNode
    if kind is BoardKind.VIRTUAL or (kind is BoardKind.EMULATED and _has_bus(robot)):
        node = VirtualBoardNode(described=robot.board, link="", namespace=namespace)
    elif kind is BoardKind.EMULATED:
        from servo_bridge.nodes import EmulatedBoardNode  # loads simavr: only when wanted

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
    """Return whether the robot's servos are on a bus.

    The virtual board then emulates them, each with its control table.
    """
    return robot.board is not None and bool(robot.board.bus_servos)


def servo_count(robot: RobotDescription) -> int:
    """Return the number of servos of a robot's board; 0 without one."""
    return len(robot.board.servos) if robot.board else 0
