"""The executables of this package: each imports its node once signals are looked after."""

from __future__ import annotations

from softsim_node.program import run_module


def servo_bridge() -> int:
    """Run the node `servo_bridge`; returns the exit code."""
    return run_module("servo_bridge.nodes.bridge_node")


def virtual_board() -> int:
    """Run the node `virtual_board`; returns the exit code."""
    return run_module("servo_bridge.nodes.virtual_board_node")


def emulated_board() -> int:
    """Run the node `emulated_board`; returns the exit code."""
    return run_module("servo_bridge.nodes.emulated_board_node")
