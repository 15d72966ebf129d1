"""The ROS nodes of the project by name, as `softsim run` and `ros2 run` know them."""

from __future__ import annotations

from typing import NamedTuple


class NodeEntry(NamedTuple):
    """A node: the module with `main(args)`, its ROS package, one line of help.

    Attributes:
        joins: Whether it joins a running robot, which is found if none is named.
    """

    module: str
    package: str
    help: str
    joins: bool = False


NODES = {
    "simulator": NodeEntry(
        "softsim_ros.nodes.simulator.simulator_node",
        "softsim_ros",
        "simulates a robot or scene (robot:=tripod)",
    ),
    "teleop": NodeEntry(
        "softsim_ros.nodes.teleop.teleop_node",
        "softsim_ros",
        "drives a robot from this terminal's keys",
        True,
    ),
    "inverse_controller": NodeEntry(
        "softsim_ros.nodes.inverse.inverse_node",
        "softsim_ros",
        "brings a robot's effector to a goal (robot:=tripod)",
        True,
    ),
    "path_follower": NodeEntry(
        "softsim_ros.nodes.inverse.path_follower_node",
        "softsim_ros",
        "plays a path as goals of the inverse controller (file:=circle)",
        True,
    ),
    "closed_loop": NodeEntry(
        "softsim_ros.nodes.inverse.closed_loop_node",
        "softsim_ros",
        "tilts the goal until the measured tilts are the wanted ones (measure:=imu)",
        True,
    ),
    "policy": NodeEntry(
        "softsim_ros.nodes.policy.policy_node",
        "softsim_ros",
        "drives a robot by a trained policy (policy:=FILE.onnx)",
        True,
    ),
    "observer": NodeEntry(
        "softsim_ros.nodes.observer.observer_node",
        "softsim_ros",
        "says from sensors what shape a robot has and what touches it (robot:=tripod)",
        True,
    ),
    "recorder": NodeEntry(
        "softsim_ros.recording.recorder_node", "softsim_ros", "records a robot's topics (robot:=tripod)", True
    ),
    "viewer": NodeEntry(
        "softsim_ros.nodes.viewer.viewer_node",
        "softsim_ros",
        "shows a robot in a web page (port:=8080)",
        True,
    ),
    "servo_bridge": NodeEntry(
        "servo_bridge.nodes.bridge_node",
        "servo_bridge",
        "writes servo packets to a serial port (port:=/dev/...)",
    ),
    "virtual_board": NodeEntry(
        "servo_bridge.nodes.virtual_board_node", "servo_bridge", "a serial servo board on a pseudo-terminal"
    ),
    "emulated_board": NodeEntry(
        "servo_bridge.nodes.emulated_board_node", "servo_bridge", "the same with the real firmware, emulated"
    ),
}
