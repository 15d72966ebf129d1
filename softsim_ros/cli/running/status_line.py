"""What `softsim up` shows where nobody can type: one line, moving in a terminal, now and then in a log."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable

from servo_bridge.board_node import BoardNode
from servo_bridge.bridge_node import ServoBridge
from softsim_node.ending import ending
from softsim_node.terminals import takes_escapes
from softsim_ros.simulator.simulator_node import Simulator

LOOK_S = 0.2
TERMINAL_PERIOD_S = 0.5
LOG_PERIOD_S = 30.0


def status_text(simulator: Simulator, bridge: ServoBridge | None, board: BoardNode | None) -> tuple[str, str]:
    """The line without and with the numbers that change all the time; a change of the first is news."""
    status = simulator.physics.status
    state = status.fault or ("paused" if status.paused else "running")
    news = f"{simulator.get_namespace()}  {state}"
    figures = f"t {status.time_s:.1f} s  {status.speed.real_time_factor:.2f} x real time"
    if bridge is not None:
        news += f"  bridge {bridge.lifecycle_state}"
    if board is not None:
        news += f" on {board.board.port}"
        figures += f"  {board.pose_text}"
    return news, f"{news}  {figures}"


def show_status(
    simulator: Simulator, bridge: ServoBridge | None, board: BoardNode | None, notice: Callable[[], str] = str
) -> None:
    """Show the line until the process shall end, and what `notice` says whenever that changes."""
    terminal = takes_escapes(sys.stdout)
    period = TERMINAL_PERIOD_S if terminal else LOG_PERIOD_S
    shown, due, nap = "", 0.0, threading.Event()
    told = notice()
    while not ending.asked:
        if (said := notice()) != told:
            print(f"\r\x1b[K{said}" if terminal else said, flush=True)
            told = said
        news, line = status_text(simulator, bridge, board)
        now = time.monotonic()
        if now >= due or (news != shown and not terminal):
            print(f"\r\x1b[K{line}" if terminal else line, end="" if terminal else "\n", flush=True)
            shown, due = news, now + period
        nap.wait(LOOK_S)
    if terminal:
        print()
