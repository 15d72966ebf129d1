"""What ros2_control's JointStateTopicSystem does on its topics, by its documentation, as a node of the test.

At every update of the controller manager it sends all its joints with the positions that controllers command
(NaN until one does), stamped now, nothing but positions, with a queue of one. With a threshold it is silent
while commands and states add up to less than that; ours is -1: never silent. It reads joint states by name,
with the sensors' best effort, and passes over what is not finite.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from node_processes import Client

UPDATE_PERIOD_S = 0.02


class TopicHardware:
    """The hardware component and the loop around it; `commands` is what a controller writes."""

    def __init__(self, client: Client, joints: Sequence[str], commands_topic: str, states_topic: str) -> None:
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import JointState

        self.joints, self.node, self._message = tuple(joints), client.node, JointState
        self.states = dict.fromkeys(self.joints, math.nan)
        self.commands = dict.fromkeys(self.joints, math.nan)
        self.sent = 0
        self._publisher = self.node.create_publisher(JointState, commands_topic, 1)
        self._subscription = self.node.create_subscription(
            JointState, states_topic, self._read, qos_profile_sensor_data
        )
        self._timer = self.node.create_timer(UPDATE_PERIOD_S, self._write)

    def _read(self, message: Any) -> None:
        for name, position in zip(message.name, message.position, strict=True):
            if name in self.states and math.isfinite(position):
                self.states[name] = position

    def _write(self) -> None:
        message = self._message(
            name=list(self.joints), position=[self.commands[each] for each in self.joints]
        )
        message.header.stamp = self.node.get_clock().now().to_msg()
        self._publisher.publish(message)
        self.sent += 1

    def close(self) -> None:
        """No longer there."""
        self.node.destroy_timer(self._timer)
        self.node.destroy_subscription(self._subscription)
        self.node.destroy_publisher(self._publisher)
