"""Joint states, pressures, poses, transforms, clock: messages of plain numbers (SI, quaternions x y z w)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseStamped, TransformStamped
from numpy.typing import ArrayLike
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Header

from softsim_ros.messages.buffers import message_array


def time_message(seconds: float) -> Time:
    """A time of `seconds` >= 0, rounded to the nearest nanosecond."""
    whole, nanoseconds = divmod(round(seconds * 1e9), 1_000_000_000)
    return Time(sec=whole, nanosec=nanoseconds)


def header(stamp: Time, frame: str) -> Header:
    """A header of that time and frame."""
    return Header(stamp=stamp, frame_id=frame)


def clock(seconds: float) -> Clock:
    """A /clock message at simulated time `seconds`."""
    return Clock(clock=time_message(seconds))


def joint_state(
    stamp: Time,
    frame: str,
    names: Sequence[str],
    positions: ArrayLike,
    velocities: ArrayLike,
    efforts: ArrayLike,
) -> JointState:
    """Joint states in the order of `names`.

    Args:
        stamp: Time of the state.
        frame: Frame the joints sit in.
        names: Joint names, length nj.
        positions: [rad] or [m], shape (nj,).
        velocities: [rad/s] or [m/s], shape (nj,).
        efforts: What a servo must hold, [N m] or [N], shape (nj,).
    """
    return JointState(
        header=header(stamp, frame),
        name=list(names),
        position=message_array(positions, "d"),
        velocity=message_array(velocities, "d"),
        effort=message_array(efforts, "d"),
    )


def fluid_pressure(stamp: Time, frame: str, pressure: float) -> FluidPressure:
    """A pressure against vacuum in [Pa], of unknown variance, at a sensor in `frame`."""
    return FluidPressure(header=header(stamp, frame), fluid_pressure=pressure)


def pose(position: Iterable[float], quaternion_xyzw: Iterable[float]) -> PoseMessage:
    """A pose at `position` in [m] with a unit quaternion."""
    message = PoseMessage()
    message.position.x, message.position.y, message.position.z = map(float, position)
    turn = message.orientation
    turn.x, turn.y, turn.z, turn.w = map(float, quaternion_xyzw)
    return message


def pose_stamped(
    stamp: Time, frame: str, position: Iterable[float], quaternion_xyzw: Iterable[float]
) -> PoseStamped:
    """A pose in `frame`: position in [m], unit quaternion."""
    return PoseStamped(header=header(stamp, frame), pose=pose(position, quaternion_xyzw))


def transform_stamped(
    stamp: Time, parent: str, child: str, position: Iterable[float], quaternion_xyzw: Iterable[float]
) -> TransformStamped:
    """Where frame `child` sits in frame `parent`: position in [m], unit quaternion."""
    message = TransformStamped(header=header(stamp, parent), child_frame_id=child)
    shift, turn = message.transform.translation, message.transform.rotation
    shift.x, shift.y, shift.z = map(float, position)
    turn.x, turn.y, turn.z, turn.w = map(float, quaternion_xyzw)
    return message
