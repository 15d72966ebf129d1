"""Which robots run: the namespaces in which a simulator or a servo bridge lives."""

from __future__ import annotations

from rclpy.node import Node

PEERS = ("simulator", "servo_bridge")


def running_robots(node: Node) -> list[str]:
    """Namespaces of the robots that `node` has discovered, such as "/tripod", sorted."""
    return sorted({space for name, space in node.get_node_names_and_namespaces() if name in PEERS})
