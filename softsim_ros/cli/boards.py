"""The board that `softsim up` gives the bridge: virtual or emulated in this process, or a real one's port."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from rclpy.node import Node
from rclpy.parameter import Parameter

from servo_bridge.virtual_board_node import VirtualBoardNode
from softsim_core.errors import SceneError
from softsim_core.scene import SceneDescription

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


class LocalBoard(Protocol):
    """A board in this process.

    Attributes:
        quiet_s: Quiet time in [s] that the bridge shall leave it after opening; None for the bridge's own.
        nodes: Nodes to spin.
    """

    quiet_s: float | None
    nodes: list[Node]

    @property
    def port(self) -> str:
        """Name to open."""

    @property
    def pose_text(self) -> str:
        """What the servos are told now, for the status line."""


class VirtualLocalBoard:
    """A pseudo-terminal that speaks the plain board's protocol; it has no boot loader to wait for.

    Args:
        stack: Closes it.
        scene: The robot, with a board.
        namespace: Namespace of its node.
    """

    def __init__(self, stack: contextlib.ExitStack, scene: SceneDescription, namespace: str) -> None:
        node = VirtualBoardNode(
            link="", namespace=namespace, parameter_overrides=[Parameter("servos", value=servo_count(scene))]
        )
        stack.callback(node.destroy_node)
        self.quiet_s: float | None = 0.0
        self.nodes: list[Node] = [node]
        self._board = node.board

    @property
    def port(self) -> str:
        """Name of the pseudo-terminal."""
        return self._board.port

    @property
    def pose_text(self) -> str:
        """Servo bytes."""
        sent = self._board.servo_bytes
        return f"servo bytes {'none yet' if sent is None else ' '.join(map(str, sent))}"


class EmulatedLocalBoard:
    """The real firmware in an emulated processor, behind a pseudo-terminal.

    Args:
        stack: Closes it.
        scene: The robot, with a board.

    Raises:
        EmulatorMissingError: libsimavr is not installed.
        SceneError: the robot has another number of servos than the firmware.
    """

    def __init__(self, stack: contextlib.ExitStack, scene: SceneDescription) -> None:
        from servo_bridge.emulator import EmulatedBoardPty  # loads simavr: only when wanted

        if servo_count(scene) != EMULATED_SERVOS:
            raise SceneError(
                f"{scene.name} has {servo_count(scene)} servos, and the emulated firmware drives"
                f" {EMULATED_SERVOS}; use --board {BoardKind.VIRTUAL.value}"
            )
        self.quiet_s: float | None = None
        self.nodes: list[Node] = []
        self._board = stack.enter_context(EmulatedBoardPty())

    @property
    def port(self) -> str:
        """Name of the pseudo-terminal."""
        return self._board.port

    @property
    def pose_text(self) -> str:
        """Measured pulse widths."""
        if self._board.failure:
            return self._board.failure
        widths = self._board.widths_us()
        return (
            f"pulses {'none yet' if widths is None else ' '.join(f'{each:.0f}' for each in widths) + ' µs'}"
        )


def local_board(
    stack: contextlib.ExitStack, scene: SceneDescription, namespace: str, kind: BoardKind
) -> LocalBoard | None:
    """The board of a kind, closed by `stack`; None where it is not in this process.

    Raises:
        SoftSimError: it cannot be made; says why.
    """
    if kind is BoardKind.VIRTUAL:
        return VirtualLocalBoard(stack, scene, namespace)
    if kind is BoardKind.EMULATED:
        return EmulatedLocalBoard(stack, scene)
    return None


def servo_count(scene: SceneDescription) -> int:
    """Servos of a robot's board; 0 without one."""
    return len(scene.board.servos) if scene.board else 0
