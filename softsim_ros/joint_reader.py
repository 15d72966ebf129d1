"""Joint states of a robot, whoever sends them, in the order of its commands."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from softsim_core.arrays import Array
from softsim_core.scene.joint import JointDescription
from softsim_ros.qos import MEASURED


class JointReader:
    """Takes joint states that name all joints of a robot, in any order, among others or not.

    Args:
        joints: Of the robot, in command order.
        refuse: Called with one sentence when a message begins to name other joints.
    """

    def __init__(self, joints: Sequence[JointDescription], refuse: Callable[[str], None]) -> None:
        self._joints, self._refuse = joints, refuse
        self._order: tuple[tuple[str, ...], list[int] | None] = ((), None)

    def read(self, message: JointState) -> Array | None:
        """Positions in [rad] or [m], efforts where these are commanded, (j,); None: of another robot."""
        names = tuple(message.name)
        if names != self._order[0]:
            self._order = (names, self._order_of(names))
        order = self._order[1]
        if order is None or len(message.position) != len(names):
            return None
        told = len(message.effort) == len(names)
        return np.array(
            [
                message.effort[index] if told and joint.by_effort else message.position[index]
                for index, joint in zip(order, self._joints, strict=True)
            ]
        )

    def efforts(self, message: JointState) -> Array | None:
        """Efforts in [N m] or [N], (j,), of a message that `read` has read; None: it has none."""
        order = self._order[1]
        if order is None or len(message.effort) != len(self._order[0]):
            return None
        return np.array([message.effort[index] for index in order])

    def _order_of(self, names: tuple[str, ...]) -> list[int] | None:
        missing = [joint.name for joint in self._joints if joint.name not in names]
        if missing:
            self._refuse(
                f"joint states of another robot ignored: {', '.join(missing)} not in {', '.join(names)}"
            )
            return None
        return [names.index(joint.name) for joint in self._joints]


class JointStates:
    """Hears where the joints are: what is measured, and while nobody measures what a bridge has sent.

    Args:
        node: Owner of the subscriptions.
        silent_after: Nobody measures once nothing came for so long, in [s].
        take: Called in the node's executor with each message.
    """

    def __init__(self, node: Node, silent_after: float, take: Callable[[JointState], None]) -> None:
        self._silent_after, self._take = silent_after, take
        self._measured_at = -np.inf
        node.create_subscription(JointState, "joint_states", self._on_measured, MEASURED)
        node.create_subscription(JointState, "applied_joint_states", self._on_applied, MEASURED)

    def _on_measured(self, message: JointState) -> None:
        self._measured_at = time.monotonic()
        self._take(message)

    def _on_applied(self, message: JointState) -> None:
        if time.monotonic() - self._measured_at > self._silent_after:  # a bare robot
            self._take(message)
