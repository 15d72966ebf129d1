"""Commands of the bridge: ROS messages of bounded size, checked and put into the order of the servos."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from servo_bridge.driver import ServoDriver
from softsim_core.base import CommandError
from softsim_core.physics.mechanics import check_age, check_positions_only
from softsim_node import error_text, list_names

MOST_BYTES = 65_536  # longest ROS message that is deserialised: a thousand joints, which delays no packet


def command_values(data: bytes) -> Sequence[float]:
    """Return the values of a serialised Float64MultiArray.

    Raises:
        CommandError: the message is too long or damaged.
    """
    values: Sequence[float] = _deserialize(data, Float64MultiArray).data
    return values


def joint_positions(data: bytes) -> dict[str, float]:
    """Return the positions by joint name of a serialised JointState.

    Raises:
        CommandError: the message is too long or damaged, names a joint twice, or has another number of names
            than of positions.
    """
    message = _deserialize(data, JointState)
    if len(message.name) != len(message.position):
        raise CommandError(
            f"{len(message.name)} names with {len(message.position)} positions refused; nothing was moved"
        )
    positions = dict(zip(message.name, message.position, strict=True))
    if len(positions) != len(message.name):
        twice = [name for name, count in Counter(message.name).items() if count > 1]
        raise CommandError(
            f"joint states that name {list_names(twice)} twice refused; name every joint once;"
            " nothing was moved"
        )
    return positions


def named_command(data: bytes, now_s: float) -> tuple[Sequence[str], Sequence[float]]:
    """Return the joint names and positions in [rad] of a serialised JointState; the names are not checked.

    Raises:
        CommandError: the message is too long, damaged or too old, or it has more than positions.
    """
    message = _deserialize(data, JointState)
    stamp = message.header.stamp
    check_age(stamp.sec + 1e-9 * stamp.nanosec, now_s)
    check_positions_only(message.velocity, message.effort)
    return message.name, message.position


def _deserialize(data: bytes, message_type: type[Any]) -> Any:
    if len(data) > MOST_BYTES:
        raise CommandError(
            f"message of {len(data)} bytes refused; allowed are {MOST_BYTES}; nothing was moved"
        )
    try:
        return deserialize_message(data, message_type)
    except Exception as error:  # an RMWError, or an error of a field's setter for invalid text
        raise CommandError(
            f"message refused: its {len(data)} bytes are no {message_type.__name__}; nothing was moved"
        ) from error


NAMED_DEPTH = 10  # queue length for commands by name: each may be for other joints
REFUSAL_LOG_PERIOD_S = 2.0


class CommandInput:
    """A subscription to commands, from its creation to `close`.

    Args:
        node: Owner of the subscription and of the log for refusals.
        source: Kind of commands: joint_states, commands or joint_commands.
        active_driver: Returns the driver that follows the commands now; None if none does.

    Attributes:
        topic: Full name of the topic.
    """

    def __init__(self, node: Node, source: str, active_driver: Callable[[], ServoDriver | None]) -> None:
        self._node, self._active_driver, self._source = node, active_driver, source
        message_type, self._name, self._depth = {
            "joint_states": (JointState, "joint_states", 1),
            "commands": (Float64MultiArray, "position_controller/commands", 1),
            "joint_commands": (JointState, "joint_commands", NAMED_DEPTH),
        }[source]
        self._subscription: Subscription = node.create_subscription(
            message_type, self._name, self._take, QoSProfile(depth=self._depth), raw=True
        )
        self.topic = str(self._subscription.topic_name)

    def forget(self) -> None:
        """Drop queued commands; callable from any thread, also after `close`.

        It drops at most as many as the queue holds: commands that arrive meanwhile are newer, and might never
        end.
        """
        waiting = self._subscription.handle
        with contextlib.suppress(InvalidHandle), waiting:
            for _ in range(self._depth):
                if waiting.take_message(self._subscription.msg_type, True) is None:
                    break

    def close(self) -> None:
        """Remove the subscription."""
        self._node.destroy_subscription(self._subscription)

    def _take(self, data: bytes) -> None:
        driver = self._active_driver()
        if driver is None:
            return
        try:
            command = self._unpack(driver, data)
            command()
        except CommandError as error:
            text = f"{self._name}: {error_text(error)}"
            self._node.get_logger().warning(text, throttle_duration_sec=REFUSAL_LOG_PERIOD_S)

    def _unpack(self, driver: ServoDriver, data: bytes) -> Callable[[], None]:
        """Return the call of the driver that a message stands for; one that is none counts as refused."""
        try:
            if self._source == "commands":
                return partial(ServoDriver.command, driver, command_values(data))
            if self._source == "joint_states":
                return partial(ServoDriver.command_named, driver, joint_positions(data))
            now_s = 1e-9 * self._node.get_clock().now().nanoseconds
            return partial(ServoDriver.command_some, driver, *named_command(data, now_s))
        except CommandError as error:
            driver.refuse(error)
            raise
