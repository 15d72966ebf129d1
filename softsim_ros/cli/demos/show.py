"""A plan that is sent to a robot once, and the poses of rigid bodies that show its result."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, Final, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseArray
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from softsim_core.base import Array
from softsim_core.physics.mechanics import rotation_of
from softsim_node import EVERY_ONE, LATCHED
from softsim_ros.client import Done, RobotClient

LEAD_S: Final = 1.0
"""Delay in simulated [s] between sending a plan and its start, so that it reaches the simulator in time."""

WayPoints = Sequence[tuple[float, Mapping[str, float]]]
"""Joint positions in [rad] and [m] by time from the start in [s]."""


class ShownBody(NamedTuple):
    """A rigid body in the world: its origin (3,) and corners (k, 3), in [m]."""

    position: Array
    corners: Array


class Show(ABC):
    """Sends a plan, and measures on `bodies/topology`, `bodies/poses` and more topics whether it succeeds.

    Args:
        node: The node whose executor delivers the messages.

    Attributes:
        robot: Name of the demo's own robot.
        duration_s: Duration of the plan, in simulated [s].
        began: Simulated time at which it begins in [s]; None: it was not sent.
        message_count: Number of pose messages received from the simulator.
    """

    robot: ClassVar[str]
    duration_s: float

    def __init__(self, node: Node, client: RobotClient) -> None:
        self._client = client
        self.began: float | None = None
        self.message_count, self._now = 0, 0.0
        self._shapes: list[tuple[str, Array]] = []
        node.create_subscription(MarkerArray, "bodies/topology", self._on_topology, LATCHED)
        node.create_subscription(PoseArray, "bodies/poses", self._on_poses, EVERY_ONE)

    @property
    def is_ready(self) -> bool:
        """Whether messages from and to the simulator get through."""
        has_messages = self.message_count > 0 and self._client.state.measured is not None
        return has_messages and self._client.joints.are_followed

    @property
    def elapsed(self) -> float:
        """Simulated seconds since the plan began; < 0 before."""
        return 0.0 if self.began is None else self._now - self.began

    def begin(self, done: Done) -> None:
        """Send the plan: one trajectory of all joints; `done` receives the outcome of the request."""
        self.began = self._now + LEAD_S
        self._client.joints.follow(self._way_points(), done, begin_s=self.began)

    @property
    @abstractmethod
    def phase(self) -> str:
        """Name of the present phase."""

    @abstractmethod
    def report_results(self) -> tuple[list[str], bool]:
        """Return the measurements as messages, and whether they meet the requirements."""

    @abstractmethod
    def _way_points(self) -> WayPoints:
        """Return the plan."""

    @abstractmethod
    def _observe(self, bodies: Mapping[str, ShownBody]) -> None:
        """Measure all bodies, by name, at a new simulated time."""

    def _on_topology(self, message: MarkerArray) -> None:
        self._shapes = [
            (marker.ns, np.array([[point.x, point.y, point.z] for point in marker.points]))
            for marker in message.markers
        ]

    def _on_poses(self, message: PoseArray) -> None:
        if not self._shapes or len(message.poses) != len(self._shapes):  # no surfaces yet, or another scene
            return
        bodies = {}
        for (name, points), pose in zip(self._shapes, message.poses, strict=True):
            position = np.array([pose.position.x, pose.position.y, pose.position.z])
            turn = pose.orientation
            rotation = rotation_of(np.array([turn.x, turn.y, turn.z, turn.w]))
            bodies[name] = ShownBody(position, points @ rotation.T + position)
        self.message_count += 1
        self._now = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self._observe(bodies)
