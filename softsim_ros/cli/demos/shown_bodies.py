"""Poses of rigid bodies from topics: their surfaces once, their poses repeatedly."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import PoseArray
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from softsim_core.base import Array
from softsim_core.physics.mechanics import rotation_of
from softsim_node import EVERY_ONE, LATCHED


class ShownBody(NamedTuple):
    """A rigid body in the world: its origin (3,), rotation (3, 3) and corners (k, 3), in [m]."""

    position: Array
    rotation: Array
    corners: Array


class ShownBodies:
    """Subscribes to `bodies/topology` and `bodies/poses`.

    Args:
        node: The node whose executor delivers the messages.
        on_poses: Called with the simulated time in [s] and all bodies by name, at each message of poses.
    """

    def __init__(self, node: Node, on_poses: Callable[[float, Mapping[str, ShownBody]], None]) -> None:
        self._on_poses = on_poses
        self._shapes: list[tuple[str, Array]] = []
        node.create_subscription(MarkerArray, "bodies/topology", self._topology, LATCHED)
        node.create_subscription(PoseArray, "bodies/poses", self._poses, EVERY_ONE)

    def _topology(self, message: MarkerArray) -> None:
        self._shapes = [
            (marker.ns, np.array([[point.x, point.y, point.z] for point in marker.points]))
            for marker in message.markers
        ]

    def _poses(self, message: PoseArray) -> None:
        if not self._shapes or len(message.poses) != len(self._shapes):  # no surfaces yet, or another scene
            return
        bodies = {}
        for (name, points), pose in zip(self._shapes, message.poses, strict=True):
            position = np.array([pose.position.x, pose.position.y, pose.position.z])
            turn = pose.orientation
            rotation = rotation_of(np.array([turn.x, turn.y, turn.z, turn.w]))
            bodies[name] = ShownBody(position, rotation, points @ rotation.T + position)
        self._on_poses(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec, bodies)
