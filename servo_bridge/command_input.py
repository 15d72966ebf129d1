"""The one topic whose commands a bridge follows: its messages bounded, unpacked, obeyed or refused."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TypeVar

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from servo_bridge.driver import ServoDriver
from servo_bridge.inputs import NamedCommand, command_values, joint_positions, named_command
from servo_bridge.wording import sentence
from softsim_core.errors import CommandError

Values = TypeVar("Values")

NAMED_DEPTH = 10
"""Commands by name that may wait: each may be for other joints."""

REFUSAL_LOG_PERIOD_S = 2.0


class CommandInput:
    """A subscription from its making to `close`.

    Args:
        node: Owner of the subscription, and the log of refusals.
        source: Kind of commands: joint_states, commands or joint_commands.
        obeys: The driver that is to follow them now; None while nothing is.

    Attributes:
        topic: Full name of the topic.
    """

    def __init__(self, node: Node, source: str, obeys: Callable[[], ServoDriver | None]) -> None:
        self._node, self._obeys = node, obeys
        message_type, topic, callback, self._depth = {
            "joint_states": (JointState, "joint_states", self._on_joint_states, 1),
            "commands": (Float64MultiArray, "position_controller/commands", self._on_command, 1),
            "joint_commands": (JointState, "joint_commands", self._on_joint_commands, NAMED_DEPTH),
        }[source]
        self._subscription: Subscription = node.create_subscription(
            message_type, topic, callback, QoSProfile(depth=self._depth), raw=True
        )
        self.topic = str(self._subscription.topic_name)

    def forget(self) -> None:
        """Drop commands that wait to be read; in any thread, also after `close`.

        As many as can wait: those that come meanwhile are newer, and may come without end.
        """
        waiting = self._subscription.handle
        with contextlib.suppress(InvalidHandle), waiting:
            for _ in range(self._depth):
                if waiting.take_message(self._subscription.msg_type, True) is None:
                    break

    def close(self) -> None:
        """Follow the topic no more."""
        self._node.destroy_subscription(self._subscription)

    def _on_command(self, data: bytes) -> None:
        self._obey("position_controller/commands", data, command_values, ServoDriver.command)

    def _on_joint_states(self, data: bytes) -> None:
        self._obey("joint_states", data, joint_positions, ServoDriver.command_named)

    def _on_joint_commands(self, data: bytes) -> None:
        def unpack(data: bytes) -> NamedCommand:
            return named_command(data, 1e-9 * self._node.get_clock().now().nanoseconds)

        self._obey("joint_commands", data, unpack, lambda driver, each: driver.command_some(*each))

    def _obey(
        self,
        topic: str,
        data: bytes,
        unpack: Callable[[bytes], Values],
        command: Callable[[ServoDriver, Values], None],
    ) -> None:
        driver = self._obeys()
        if driver is None:
            return
        try:
            try:
                values = unpack(data)
            except CommandError as error:
                driver.refuse(error)
                raise
            command(driver, values)
        except CommandError as error:
            text = f"{topic}: {sentence(error)}"
            self._node.get_logger().warning(text, throttle_duration_sec=REFUSAL_LOG_PERIOD_S)
