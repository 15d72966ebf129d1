"""The executables of this package: each imports its node after signal handling is set up."""

from __future__ import annotations

from softsim_node import run_module


def simulator() -> int:
    """Run the node `simulator`; return the exit code."""
    return run_module("softsim_ros.nodes.simulator.simulator_node")


def teleop() -> int:
    """Run the node `teleop`; return the exit code."""
    return run_module("softsim_ros.nodes.teleop.teleop_node")


def inverse_controller() -> int:
    """Run the node `inverse_controller`; return the exit code."""
    return run_module("softsim_ros.nodes.inverse.inverse_node")


def path_follower() -> int:
    """Run the node `path_follower`; return the exit code."""
    return run_module("softsim_ros.nodes.inverse.path_follower_node")


def closed_loop() -> int:
    """Run the node `closed_loop`; return the exit code."""
    return run_module("softsim_ros.nodes.inverse.closed_loop_node")


def observer() -> int:
    """Run the node `observer`; return the exit code."""
    return run_module("softsim_ros.nodes.observer.observer_node")


def policy() -> int:
    """Run the node `policy`; return the exit code."""
    return run_module("softsim_ros.nodes.policy.policy_node")


def recorder() -> int:
    """Run the node `recorder`; return the exit code."""
    return run_module("softsim_ros.recording.recorder_node")


def viewer() -> int:
    """Run the node `viewer`; return the exit code."""
    return run_module("softsim_ros.nodes.viewer.viewer_node")
