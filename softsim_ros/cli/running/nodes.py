"""The ROS nodes of the project by name, as `softsim run` and `ros2 run` know them."""

from __future__ import annotations

from typing import NamedTuple


class NodeEntry(NamedTuple):
    """A node: the module with `main(args)`, one line of help.

    Attributes:
        joins: Whether it joins a running robot, which is found if none is named.
    """

    module: str
    help: str
    joins: bool = False


_NODES, _BRIDGE = "softsim_ros.nodes", "servo_bridge.nodes"
NODES = {
    "simulator": NodeEntry(
        f"{_NODES}.simulator.simulator_node", "simulates a robot or scene (robot:=tripod)"
    ),
    "teleop": NodeEntry(f"{_NODES}.teleop.teleop_node", "drives a robot from this terminal's keys", True),
    "inverse_controller": NodeEntry(
        f"{_NODES}.inverse.inverse_node", "brings a robot's effector to a goal (robot:=tripod)", True
    ),
    "path_follower": NodeEntry(
        f"{_NODES}.inverse.path_follower_node",
        "plays a path as goals of the inverse controller (file:=circle)",
        True,
    ),
    "closed_loop": NodeEntry(
        f"{_NODES}.inverse.closed_loop_node",
        "tilts the goal until the measured tilts are the wanted ones (measure:=imu)",
        True,
    ),
    "policy": NodeEntry(
        f"{_NODES}.policy.policy_node", "drives a robot by a trained policy (policy:=FILE.onnx)", True
    ),
    "observer": NodeEntry(
        f"{_NODES}.observer.observer_node",
        "says from sensors what shape a robot has and what touches it (robot:=tripod)",
        True,
    ),
    "recorder": NodeEntry(
        "softsim_ros.recording.recorder_node", "records a robot's topics (robot:=tripod)", True
    ),
    "viewer": NodeEntry(f"{_NODES}.viewer.viewer_node", "shows a robot in a web page (port:=8080)", True),
    "servo_bridge": NodeEntry(
        f"{_BRIDGE}.bridge_node", "writes servo packets to a serial port (port:=/dev/...)"
    ),
    "virtual_board": NodeEntry(f"{_BRIDGE}.virtual_board_node", "a serial servo board on a pseudo-terminal"),
    "emulated_board": NodeEntry(
        f"{_BRIDGE}.emulated_board_node", "the same with the real firmware, emulated"
    ),
}
