"""Several nodes in one process: simulator, servo bridge, a board, the teleop or a status line."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from rclpy.node import Node
from rclpy.parameter import Parameter

from servo_bridge.nodes import BoardNode, ServoBridge, VirtualBoardNode
from softsim_core.base import SceneError
from softsim_core.scene import RobotDescription
from softsim_node import ending, takes_escapes
from softsim_ros import SpinThread
from softsim_ros.nodes.inverse import InverseControl
from softsim_ros.nodes.simulator import Simulator
from softsim_ros.nodes.teleop import NoTerminalError, Teleop, drive

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
    """Board of the bridge (NONE: no bridge), port of a real one (empty: search), whether to send at once."""

    kind: BoardKind
    port: str = ""
    send: bool = False


def local_board(
    stack: contextlib.ExitStack, robot: RobotDescription, namespace: str, kind: BoardKind
) -> BoardNode | None:
    """Return the node of a board in this process, closed by `stack`; None if the board is elsewhere.

    Raises:
        EmulatorMissingError: libsimavr is not installed.
        SceneError: the robot has another number of servos than the emulated firmware.
    """
    node: BoardNode
    servos, bus_servos = (robot.board.servos, robot.board.bus_servos) if robot.board else ((), ())
    if kind is BoardKind.VIRTUAL or (kind is BoardKind.EMULATED and bus_servos):
        # It also emulates servos on a bus, each with its control table.
        node = VirtualBoardNode(described=robot.board, link="", namespace=namespace)
    elif kind is BoardKind.EMULATED:
        from servo_bridge.nodes import EmulatedBoardNode  # loads simavr: only when wanted

        if len(servos) != EMULATED_SERVOS:
            raise SceneError(
                f"{robot.name} has {len(servos)} servos, and the emulated firmware drives"
                f" {EMULATED_SERVOS}; use --board {BoardKind.VIRTUAL.value}"
            )
        node = EmulatedBoardNode(link="", namespace=namespace)
    else:
        return None
    stack.callback(node.destroy_node)
    return node


LOOK_S = 0.2
TERMINAL_PERIOD_S = 0.5
LOG_PERIOD_S = 30.0


class BringUp(contextlib.AbstractContextManager["BringUp"]):
    """The nodes of one robot, spinning in two threads.

    Leaving the `with` block moves the servos to the safe pose.

    Args:
        namespace: Namespace of every node, without slashes at its ends.
        board: The bridge's board.
        inverse: Whether to run inverse control, disabled until key I.
        policy: File of a policy that drives the robot; empty: none.
        watch: Whether to reload the scene when one of its files is saved.
        allow_code: Folders with Python scenes that may be loaded at run time.
    """

    def __init__(
        self,
        robot: RobotDescription,
        namespace: str,
        board: BoardChoice,
        *,
        inverse: bool = False,
        policy: str = "",
        watch: bool = False,
        allow_code: Sequence[str] = (),
    ) -> None:
        self._robot, self._namespace = robot, namespace
        self.board: BoardNode | None = None
        self.bridge: ServoBridge | None = None
        with contextlib.ExitStack() as stack:  # unwound in order if one of these fails
            values = {"watch": watch, "allow_code": os.pathsep.join(allow_code)}
            self.simulator = Simulator(robot, namespace=namespace, parameter_overrides=_parameters(values))
            stack.callback(self.simulator.close)
            bridged = board.kind is not BoardKind.NONE
            hardware = self._add_bridge(stack, robot, namespace, board) if bridged else []
            stack.enter_context(SpinThread([self.simulator]))
            if hardware:
                stack.enter_context(SpinThread(hardware))
            if inverse:
                controller = InverseControl(robot, namespace=namespace)
                stack.callback(controller.close)
                stack.enter_context(SpinThread([controller]))
            if policy:
                from softsim_ros.nodes.policy import PolicyNode  # it imports the tasks, and Gymnasium

                chosen = _parameters({"policy": policy, "enabled": True})
                driver = PolicyNode(robot, namespace=namespace, parameter_overrides=chosen)
                stack.callback(driver.close)
                stack.enter_context(SpinThread([driver]))
            self._stack = stack.pop_all()

    def _add_bridge(
        self, stack: contextlib.ExitStack, robot: RobotDescription, namespace: str, board: BoardChoice
    ) -> list[Node]:
        self.board = local_board(stack, robot, namespace, board.kind)
        values: dict[str, object] = {
            "robot": robot.name,
            "port": board.port if self.board is None else self.board.board.port,
            "autostart": "activate" if board.send else "configure",
        }
        if board.kind is BoardKind.VIRTUAL:
            values["open_wait_s"] = 0.0  # it has no boot loader to wait for
        self.bridge = ServoBridge(scene=robot, namespace=namespace, parameter_overrides=_parameters(values))
        stack.callback(self.bridge.destroy_node)
        return [*([self.board] if self.board else ()), self.bridge]

    def __exit__(self, *_: object) -> None:
        """Stop spinning, move to the safe pose, close the port, end the physics."""
        self._stack.close()

    def run(self, interactive: bool, notice: Callable[[], str]) -> None:
        """Run until the user or a signal ends it.

        Args:
            interactive: Whether to show the teleop in this terminal; otherwise a status line.
            notice: Returns the message about the web page, which is shown whenever it changes.
        """
        if said := notice():
            print(said, flush=True)
        if not (interactive and self._drive(notice)):
            self._show_status(notice)

    def _drive(self, notice: Callable[[], str]) -> bool:
        """Run the teleop here, with a permanent line; return False if this terminal cannot be used."""
        teleop = Teleop(self._robot, namespace=self._namespace)
        teleop.notice = notice
        try:
            drive(teleop)
        except NoTerminalError as error:
            print(f"softsim up: no teleop: {error}", file=sys.stderr)
            return False
        finally:
            teleop.close()
        return True

    def _show_status(self, notice: Callable[[], str]) -> None:
        """Show the status line until the process is to end, and the notice whenever it changes."""
        terminal = takes_escapes(sys.stdout)
        period = TERMINAL_PERIOD_S if terminal else LOG_PERIOD_S
        shown, due, nap, notice_text = "", 0.0, threading.Event(), notice()
        while not ending.asked:
            if (said := notice()) != notice_text:
                print(f"\r\x1b[K{said}" if terminal else said, flush=True)
                notice_text = said
            news, figures = self._status()
            now, line = time.monotonic(), f"{news}  {figures}"
            if now >= due or (news != shown and not terminal):
                print(f"\r\x1b[K{line}" if terminal else line, end="" if terminal else "\n", flush=True)
                shown, due = news, now + period
            nap.wait(LOOK_S)
        if terminal:
            print()

    def _status(self) -> tuple[str, str]:
        """Return both parts of the status line: states, whose change is news, and changing numbers."""
        status = self.simulator.physics.status
        news = (
            f"{self.simulator.get_namespace()}  {status.fault or ('paused' if status.paused else 'running')}"
        )
        figures = f"t {status.time_s:.1f} s  {status.speed.real_time_factor:.2f} x real time"
        if self.bridge is not None:
            news += f"  bridge {self.bridge.lifecycle_state}"
        if self.board is not None:
            news += f" on {self.board.board.port}"
            figures += f"  {self.board.pose_text}"
        return news, figures


def _parameters(values: Mapping[str, object]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in values.items()]
