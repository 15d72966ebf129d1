"""Checks of the servo board's port, real and virtual."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from serial.tools import list_ports

from servo_bridge.emulator.simavr import why_missing
from servo_bridge.errors import PortError
from servo_bridge.ports import find_port
from servo_bridge.virtual_board import VirtualBoard
from softsim_ros.cli.upkeep.checks.finding import Finding, Level

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


def emulated_board() -> list[Finding]:
    """Whether the firmware can run in an emulated board; nothing else needs it."""
    missing = why_missing()
    if missing:
        return [Finding(Level.OK, "emulated board", f"not possible here: {missing}")]
    return [Finding(Level.OK, "emulated board", "works: softsim up tripod --board emulated")]


def flashing() -> list[Finding]:
    """Whether a board's firmware can be uploaded; needed once a board."""
    program = shutil.which("avrdude")
    if program is None:
        advice = "only to put the firmware onto a board: sudo apt install avrdude"
        return [Finding(Level.OK, "avrdude", "not installed", advice)]
    return [Finding(Level.OK, "avrdude", program)]
