"""Joint states, pressures, poses, transforms, clock; arrays as buffers of message fields."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Pose as PoseMessage,
    PoseStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from numpy.typing import ArrayLike
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, MultiDOFJointState
from std_msgs.msg import Header

from softsim_core.base import CommandError, shorten
from softsim_node import WORLD

_TYPECODES: dict[str, Any] = {"d": np.dtype("<f8"), "f": np.dtype("<f4"), "I": np.dtype("<u4")}


def message_array(values: ArrayLike, typecode: str) -> array[Any]:
    """Return values as the `array.array` of a message field.

    Args:
        values: Numbers of any shape; taken row by row.
        typecode: "d" (float64), "f" (float32), "I" (uint32) or "B" (raw bytes of the values).

    Returns:
        A copy of the numbers; for "B" a copy of their memory, little-endian if the input is.
    """
    numbers = np.asarray(values, dtype=_TYPECODES.get(typecode))
    buffer: array[Any] = array(typecode)
    buffer.frombytes(numbers.tobytes())
    return buffer


def time_message(seconds: float) -> Time:
    """Return a time of `seconds` >= 0, rounded to the nearest nanosecond."""
    whole, nanoseconds = divmod(round(seconds * 1e9), 1_000_000_000)
    return Time(sec=whole, nanosec=nanoseconds)


def header(stamp: Time, frame: str) -> Header:
    """Return a header with that time and frame."""
    return Header(stamp=stamp, frame_id=frame)


def clock(seconds: float) -> Clock:
    """Return a /clock message at simulated time `seconds`."""
    return Clock(clock=time_message(seconds))


def joint_state(
    stamp: Time,
    frame: str,
    names: Sequence[str],
    positions: ArrayLike,
    velocities: ArrayLike,
    efforts: ArrayLike,
) -> JointState:
    """Return joint states in the order of `names`.

    Args:
        stamp: Time of the state.
        frame: Frame of the joints.
        names: Joint names, length nj.
        positions: [rad] or [m], shape (nj,).
        velocities: [rad/s] or [m/s], shape (nj,).
        efforts: Torque or force that a servo must apply, [N m] or [N], shape (nj,).
    """
    return JointState(
        header=header(stamp, frame),
        name=list(names),
        position=message_array(positions, "d"),
        velocity=message_array(velocities, "d"),
        effort=message_array(efforts, "d"),
    )


def pose(position: Iterable[float], quaternion_xyzw: Iterable[float]) -> PoseMessage:
    """Return a pose at `position` in [m] with a unit quaternion."""
    message = PoseMessage()
    message.position.x, message.position.y, message.position.z = map(float, position)
    turn = message.orientation
    turn.x, turn.y, turn.z, turn.w = map(float, quaternion_xyzw)
    return message


def pose_stamped(
    stamp: Time, frame: str, position: Iterable[float], quaternion_xyzw: Iterable[float]
) -> PoseStamped:
    """Return a pose in `frame`: position in [m], unit quaternion."""
    return PoseStamped(header=header(stamp, frame), pose=pose(position, quaternion_xyzw))


def transform_stamped(
    stamp: Time, parent: str, child: str, position: Iterable[float], quaternion_xyzw: Iterable[float]
) -> TransformStamped:
    """Return the pose of frame `child` in frame `parent`: position in [m], unit quaternion."""
    message = TransformStamped(header=header(stamp, parent), child_frame_id=child)
    shift, turn = message.transform.translation, message.transform.rotation
    shift.x, shift.y, shift.z = map(float, position)
    turn.x, turn.y, turn.z, turn.w = map(float, quaternion_xyzw)
    return message


def base_target(stamp: Time, joint: str, position: Sequence[float]) -> MultiDOFJointState:
    """Return a message that moves the base of a joint to a position (3,) in [m] in `world`."""
    x, y, z = map(float, position)
    place = Transform(translation=Vector3(x=x, y=y, z=z))
    return MultiDOFJointState(header=header(stamp, WORLD), joint_names=[joint], transforms=[place])


def read_base_target(message: MultiDOFJointState) -> tuple[str, tuple[float, float, float]]:
    """Return joint and position in [m] of a message.

    Raises:
        CommandError: another frame than `world`, not one joint with one transform, a rotation, velocities or
            forces: only the position of a base can be set.
    """
    if message.header.frame_id != WORLD:
        raise CommandError(
            f"base target refused: unknown frame_id {shorten(message.header.frame_id)!r}; allowed: {WORLD}"
        )
    if len(message.joint_names) != 1 or len(message.transforms) != 1:
        raise CommandError(
            f"base target refused: {len(message.joint_names)} joint names with {len(message.transforms)} "
            "transforms; name one joint a message, with one transform"
        )
    place = message.transforms[0]
    if message.twist or message.wrench or place.rotation != Quaternion():
        raise CommandError(
            "base target refused: only a base's place can be chosen; leave rotation, twist and wrench out"
        )
    at = place.translation
    return message.joint_names[0], (at.x, at.y, at.z)
