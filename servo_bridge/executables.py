"""The executables of this package: each imports its node after signal handling is set up."""

from __future__ import annotations

from softsim_node import run_module


def servo_bridge() -> int:
    """Run the node `servo_bridge` and return the exit code."""
    return run_module("servo_bridge.nodes.bridge_node")


def virtual_board() -> int:
    """Run the node `virtual_board` and return the exit code."""
    return run_module("servo_bridge.nodes.virtual_board_node")


def emulated_board() -> int:
    """Run the node `emulated_board` and return the exit code."""
    return run_module("servo_bridge.nodes.emulated_board_node")
