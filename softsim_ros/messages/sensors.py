"""Sensor samples, contacts and step profiles as messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseArray, Vector3, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import FluidPressure, Image, Imu, JointState, PointCloud2
from std_msgs.msg import Float64, Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout

from softsim_core.base import Array
from softsim_core.physics.actuation import ActuatorView
from softsim_core.physics.dynamics import ContactReport
from softsim_core.physics.sensing import Output, Quantity, SensorReading, SimulatedSensorDescription
from softsim_ros.messages.meshes import cloud
from softsim_ros.messages.states import joint_state, message_array, pose

_NUMBERS = (
    *("x", "y", "z"),
    *("normal_x", "normal_y", "normal_z"),
    *("force_x", "force_y", "force_z"),
    "gap",
)
_BODIES = ("body_a", "body_b")

CONTACT = np.dtype([*((name, "<f4") for name in _NUMBERS), *((name, "<i4") for name in _BODIES)])
"""A contact: position and gap in [m], unit normal from body b to body a, force on a in [N]."""


def contact_cloud(stamp: Time, frame: str, contacts: ContactReport) -> PointCloud2:
    """Return all contacts of a step as a message, including those that are only close (force 0).

    Args:
        stamp: Time of the step.
        frame: Frame of positions, normals and forces.
        contacts: Contacts of the step.
    """
    rows = np.zeros(len(contacts.points), dtype=CONTACT)
    columns = (contacts.points, contacts.normals, contacts.forces, contacts.gaps[:, None])
    for name, column in zip(_NUMBERS, np.concatenate(columns, axis=1).T, strict=True):
        rows[name] = column
    for name, body in zip(_BODIES, contacts.bodies.T, strict=True):
        rows[name] = body
    return cloud(stamp, frame, rows)


TENSION = np.dtype([*((name, "<f4") for name in ("x", "y", "z", "tension")), ("joint", "<i4")])
"""A segment of a cable: its middle in [m], its tension in [N], the index of its joint."""


def tension_cloud(
    stamp: Time, frame: str, actuators: Sequence[ActuatorView], joints: Sequence[str]
) -> PointCloud2:
    """Return the tension of each segment of each cable as rows of TENSION, from the pulled end on.

    Args:
        stamp: Time of the step.
        frame: Frame of the points.
        actuators: The actuators.
        joints: Names of all joints.
    """
    rows, first = np.zeros(sum(len(each.tensions) for each in actuators), dtype=TENSION), 0
    for each in actuators:
        if not len(each.tensions):
            continue
        part = rows[first : first + len(each.tensions)]
        middles = 0.5 * (each.points[1:] + each.points[:-1])
        part["x"], part["y"], part["z"] = middles.T
        part["tension"], part["joint"] = each.tensions, joints.index(each.name)
        first += len(part)
    return cloud(stamp, frame, rows)


def read_tension_cloud(message: PointCloud2) -> NDArray[np.void]:
    """Return the segments of a message made by `tension_cloud` as rows of TENSION; a view, not a copy."""
    return np.frombuffer(message.data, dtype=TENSION)


def read_contact_cloud(message: PointCloud2) -> NDArray[np.void]:
    """Return the contacts of a message made by `contact_cloud` as rows of CONTACT; a view, not a copy."""
    return np.frombuffer(message.data, dtype=CONTACT)


def step_profile(stages: Sequence[str], rows: Array) -> Float64MultiArray:
    """Return steps with the times of their stages as a message.

    Args:
        stages: Names of the stages, length s; the label of the second dimension joins them by commas.
        rows: Number, simulated time in [s], time of each stage in [ms], oldest step first, shape (k, 2 + s).
    """
    count, width = rows.shape
    dimensions = [
        MultiArrayDimension(label="steps", size=count, stride=count * width),
        MultiArrayDimension(label=",".join(("step", "time_s", *stages)), size=width, stride=width),
    ]
    return Float64MultiArray(layout=MultiArrayLayout(dim=dimensions), data=message_array(rows, "d"))


def read_step_profile(message: Float64MultiArray) -> tuple[tuple[str, ...], Array]:
    """Return stages and rows of a message made by `step_profile`."""
    steps, columns = message.layout.dim
    rows = np.frombuffer(message.data, dtype=float).reshape(steps.size, columns.size)
    return tuple(columns.label.split(",")[2:]), rows


UPRIGHT: Final = (0.0, 0.0, 0.0, 1.0)
TACTILE_ENCODING: Final = "32FC1"

Write: TypeAlias = Callable[[Header, Array, Output], Any]
"""Writes a message of a header, the numbers of an output, and the output."""


class SensorMessage(NamedTuple):
    """A message about an output of a sensor: the text behind its topic, its type, and the writer."""

    below: str
    message: type
    write: Callable[[Header, SensorReading], Any]


def wrench(header: Header, value: Array, _: Output) -> WrenchStamped:
    """Return force in [N] and moment in [N m] in the frame of the header."""
    message = WrenchStamped(header=header)
    message.wrench.force, message.wrench.torque = _vectors(value)
    return message


def tactile_image(header: Header, value: Array, _: Output) -> Image:
    """Return pressures in [Pa] as an image with one float32 channel and a row for each row of the grid."""
    rows, columns = value.shape
    return Image(
        header=header,
        height=rows,
        width=columns,
        encoding=TACTILE_ENCODING,
        is_bigendian=0,
        step=4 * columns,
        data=message_array(value.astype("<f4"), "B"),
    )


def imu(header: Header, value: Array, output: Output) -> Imu:
    """Return specific force, angular rate and orientation with their noise variances.

    The first orientation covariance is -1 if there is no orientation.
    """
    force, rate, turning = (*output.deviations, 0.0, 0.0, 0.0)[:3]
    message = Imu(header=header)
    message.linear_acceleration, message.angular_velocity = _vectors(value[:6])
    message.linear_acceleration_covariance[0:9:4] = [force**2] * 3
    message.angular_velocity_covariance[0:9:4] = [rate**2] * 3
    if len(value) == 6:
        message.orientation_covariance[0] = -1.0
    else:
        message.orientation_covariance[0:9:4] = [turning**2] * 3
        turn = message.orientation
        turn.x, turn.y, turn.z, turn.w = value[6:].tolist()
    return message


def marker_poses(header: Header, value: Array, _: Output) -> PoseArray:
    """Return positions of markers in [m] with identity rotation; NaN for a marker that is not visible."""
    return PoseArray(header=header, poses=[pose(place, UPRIGHT) for place in value.tolist()])


def number(_: Header, value: Array, __: Output) -> Float64:
    """Return one number."""
    return Float64(data=float(value))


def joint(header: Header, value: Array, output: Output) -> JointState:
    """Return position and effort of a joint, such as length in [m] and tension in [N] of a cable."""
    position, effort = value
    return joint_state(header.stamp, header.frame_id, [output.joint], [position], [], [effort])


def pressure(header: Header, value: Array, output: Output) -> FluidPressure:
    """Return an absolute pressure in [Pa] with its noise variance."""
    deviation = next(iter(output.deviations), 0.0)
    return FluidPressure(header=header, fluid_pressure=float(value), variance=deviation**2)


def numbers(_: Header, value: Array, __: Output) -> Float64MultiArray:
    """Return all numbers, row by row."""
    return Float64MultiArray(data=message_array(value, "d"))


MESSAGES: Final[dict[Quantity, tuple[type, Write]]] = {
    Quantity.WRENCH: (WrenchStamped, wrench),
    Quantity.PRESSURES: (Image, tactile_image),
    Quantity.INERTIAL: (Imu, imu),
    Quantity.POINTS: (PoseArray, marker_poses),
    Quantity.NUMBER: (Float64, number),
    Quantity.JOINT: (JointState, joint),
    Quantity.PRESSURE: (FluidPressure, pressure),
    Quantity.NUMBERS: (Float64MultiArray, numbers),
}
"""Message type of each quantity, and its writer."""


def messages_of(described: SimulatedSensorDescription, atmosphere: float) -> tuple[SensorMessage, ...]:
    """Return the messages of a sensor; `atmosphere` is the absolute pressure of the air in [Pa]."""
    return tuple(
        SensorMessage(output.below, MESSAGES[output.quantity][0], partial(_write, output, atmosphere))
        for output in described.outputs
    )


def _write(output: Output, atmosphere: float, header: Header, reading: SensorReading) -> Any:
    value = np.asarray(reading.value[output.part])
    if output.quantity is Quantity.PRESSURE:  # sensors measure it relative to the air
        value = atmosphere + value
    return MESSAGES[output.quantity][1](header, value, output)


def _vectors(value: Array) -> tuple[Vector3, Vector3]:
    first, second = value.reshape(2, 3).tolist()
    return Vector3(x=first[0], y=first[1], z=first[2]), Vector3(x=second[0], y=second[1], z=second[2])
