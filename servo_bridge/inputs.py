"""Commands as they come from a topic, in bytes: bounded before they are unpacked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from servo_bridge.wording import named
from softsim_core.errors import CommandError
from softsim_core.mechanics.named_command import check_age, check_positions_only

MOST_BYTES = 65_536
"""Longest message that is unpacked: a thousand joints, and no packet is late for it."""


class NamedCommand(NamedTuple):
    """A command for some joints, not checked against those that there are.

    Attributes:
        names: Names of the joints.
        positions: In [rad].
    """

    names: Sequence[str]
    positions: Sequence[float]


def command_values(data: bytes) -> Sequence[float]:
    """Values of a serialised Float64MultiArray.

    Raises:
        CommandError: the message is too long or damaged.
    """
    values: Sequence[float] = _unpacked(data, Float64MultiArray).data
    return values


def joint_positions(data: bytes) -> dict[str, float]:
    """Positions by joint name of a serialised JointState.

    Raises:
        CommandError: the message is too long or damaged, names a joint twice, or has another number of names
            than of positions.
    """
    message = _unpacked(data, JointState)
    if len(message.name) != len(message.position):
        raise CommandError(
            f"{len(message.name)} names with {len(message.position)} positions refused; nothing was moved"
        )
    positions = dict(zip(message.name, message.position, strict=True))
    if len(positions) != len(message.name):
        twice = [name for name, count in Counter(message.name).items() if count > 1]
        raise CommandError(
            f"joint states that name {named(twice)} twice refused; name every joint once; nothing was moved"
        )
    return positions


def named_command(data: bytes, now_s: float) -> NamedCommand:
    """The command of a serialised JointState.

    Args:
        data: The message.
        now_s: The time now in [s], on the clock of its stamp.

    Raises:
        CommandError: the message is too long, damaged or too old, or it says more than positions.
    """
    message = _unpacked(data, JointState)
    stamp = message.header.stamp
    check_age(stamp.sec + 1e-9 * stamp.nanosec, now_s)
    check_positions_only(message.velocity, message.effort)
    return NamedCommand(message.name, message.position)


def _unpacked(data: bytes, message_type: type[Any]) -> Any:
    if len(data) > MOST_BYTES:
        raise CommandError(
            f"message of {len(data)} bytes refused; allowed are {MOST_BYTES}; nothing was moved"
        )
    try:
        return deserialize_message(data, message_type)
    except Exception as error:  # an RMWError, or what a field's setter says of text that is none
        raise CommandError(
            f"message refused: its {len(data)} bytes are no {message_type.__name__}; nothing was moved"
        ) from error
