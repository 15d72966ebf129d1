"""The executables of this package: each imports its node after signal handling is set up."""

from __future__ import annotations

from functools import partial

from softsim_node import run_module

servo_bridge = partial(run_module, "servo_bridge.nodes.bridge_node")
virtual_board = partial(run_module, "servo_bridge.nodes.virtual_board_node")
emulated_board = partial(run_module, "servo_bridge.nodes.emulated_board_node")
