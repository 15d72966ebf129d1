"""Checks of the servo board's port, real and virtual."""

from __future__ import annotations

import os
from pathlib import Path

from serial.tools import list_ports

from servo_bridge.errors import PortError
from servo_bridge.ports import find_port
from servo_bridge.virtual_board import VirtualBoard
from softsim_ros.cli.checks.finding import Finding, Level

NO_ACCESS = "sudo usermod -aG dialout $USER, then log out and in"


def board(port: str = "") -> list[Finding]:
    """Which port the bridge would take, and whether it may.

    Args:
        port: Named by the user; empty searches.
    """
    seen = sorted(info.device for info in list_ports.comports())
    try:
        found = find_port(port)
    except PortError as error:
        advice = "without a board everything runs on the virtual one: softsim up tripod"
        return [Finding(Level.OK if not seen else Level.WARNING, "board", str(error), advice)]
    if not Path(found).exists():
        return [
            Finding(
                Level.PROBLEM, "board", f"{found} does not exist; ports seen: {', '.join(seen) or 'none'}"
            )
        ]
    if not os.access(found, os.R_OK | os.W_OK):
        return [Finding(Level.PROBLEM, "board", f"no permission to use {found}", NO_ACCESS)]
    return [Finding(Level.OK, "board", found)]


def virtual_board() -> list[Finding]:
    """Whether a virtual board can be made on this machine."""
    with VirtualBoard() as virtual:
        return [Finding(Level.OK, "virtual board", f"works (just now on {virtual.port})")]
