"""Sensor samples, contacts and step profiles as messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseArray, Vector3, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import FluidPressure, Image, Imu, JointState, PointCloud2, PointField
from std_msgs.msg import Float64, Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout

from softsim_core.base import Array
from softsim_core.physics.dynamics import ContactReport
from softsim_core.physics.sensing import (
    CableSensorDescription,
    ChamberSensorDescription,
    ForceTorqueDescription,
    ImuDescription,
    MarkersDescription,
    SensorReading,
    SimulatedSensorDescription,
    StrainSensorDescription,
    TactileArrayDescription,
    WrenchSensorDescription,
)
from softsim_ros.messages.states import header, joint_state, message_array, pose

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
    kinds = dict.fromkeys(_NUMBERS, PointField.FLOAT32) | dict.fromkeys(_BODIES, PointField.INT32)
    return PointCloud2(
        header=header(stamp, frame),
        height=1,
        width=len(rows),
        fields=[
            PointField(name=name, offset=4 * index, datatype=kind, count=1)
            for index, (name, kind) in enumerate(kinds.items())
        ],
        is_bigendian=False,
        point_step=CONTACT.itemsize,
        row_step=CONTACT.itemsize * len(rows),
        data=message_array(rows, "B"),
        is_dense=True,
    )


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

Write: TypeAlias = Callable[[Header, SensorReading], Any]


class SensorMessage(NamedTuple):
    """A message that a kind of sensor publishes: topic suffix, type, and the function that writes it."""

    below: str
    message: type
    write: Write


def wrench(header: Header, reading: SensorReading) -> WrenchStamped:
    """Return force in [N] and moment in [N m] in the frame of the header."""
    message = WrenchStamped(header=header)
    message.wrench.force, message.wrench.torque = _vectors(reading.value)
    return message


def tactile_image(header: Header, reading: SensorReading) -> Image:
    """Return pressures in [Pa] as an image with one float32 channel and a row for each row of the grid."""
    rows, columns = reading.value.shape
    return Image(
        header=header,
        height=rows,
        width=columns,
        encoding=TACTILE_ENCODING,
        is_bigendian=0,
        step=4 * columns,
        data=message_array(reading.value.astype("<f4"), "B"),
    )


def read_tactile_image(message: Image) -> Array:
    """Return pressures in [Pa] of a message made by `tactile_image`, shape (rows, columns)."""
    return np.frombuffer(message.data, dtype="<f4").reshape(message.height, message.width).astype(float)


def imu(header: Header, reading: SensorReading) -> Imu:
    """Return specific force, angular rate and orientation with their noise variances.

    The first orientation covariance is -1 if there is no orientation.
    """
    described = reading.description
    assert isinstance(described, ImuDescription)
    message = Imu(header=header)
    message.linear_acceleration, message.angular_velocity = _vectors(reading.value[:6])
    message.linear_acceleration_covariance[0:9:4] = [described.accelerometer_noise**2] * 3
    message.angular_velocity_covariance[0:9:4] = [described.gyroscope_noise**2] * 3
    if described.orientation_noise is None:
        message.orientation_covariance[0] = -1.0
    else:
        message.orientation_covariance[0:9:4] = [described.orientation_noise**2] * 3
        turn = message.orientation
        turn.x, turn.y, turn.z, turn.w = reading.value[6:].tolist()
    return message


def marker_poses(header: Header, reading: SensorReading) -> PoseArray:
    """Return positions of markers in [m] with identity rotation; NaN for a marker that is not visible."""
    return PoseArray(header=header, poses=[pose(place, UPRIGHT) for place in reading.value.tolist()])


def number(_: Header, reading: SensorReading) -> Float64:
    """Return one number."""
    return Float64(data=float(reading.value))


def cable_state(header: Header, reading: SensorReading) -> JointState:
    """Return length in [m] as position and tension in [N] as effort of the cable's joint."""
    described = reading.description
    assert isinstance(described, CableSensorDescription)
    length, tension = reading.value
    return joint_state(header.stamp, header.frame_id, [described.joint], [length], [], [tension])


def chamber_pressure(atmosphere: float, header: Header, reading: SensorReading) -> FluidPressure:
    """Return absolute pressure in [Pa] with its noise variance; `atmosphere` is the surrounding pressure."""
    described = reading.description
    assert isinstance(described, ChamberSensorDescription)
    pressure, variance = atmosphere + float(reading.value[1]), described.pressure_noise**2
    return FluidPressure(header=header, fluid_pressure=pressure, variance=variance)


def chamber_volume(_: Header, reading: SensorReading) -> Float64:
    """Return volume in [m^3]."""
    return Float64(data=float(reading.value[0]))


def numbers(_: Header, reading: SensorReading) -> Float64MultiArray:
    """Return all numbers, row by row; used for kinds of sensors that a user has added."""
    return Float64MultiArray(data=message_array(reading.value, "d"))


KINDS: Final[dict[type[SimulatedSensorDescription], tuple[SensorMessage, ...]]] = {
    WrenchSensorDescription: (SensorMessage("", WrenchStamped, wrench),),
    ForceTorqueDescription: (SensorMessage("", WrenchStamped, wrench),),
    TactileArrayDescription: (SensorMessage("", Image, tactile_image),),
    StrainSensorDescription: (SensorMessage("", Float64, number),),
    ImuDescription: (SensorMessage("", Imu, imu),),
    MarkersDescription: (SensorMessage("", PoseArray, marker_poses),),
    CableSensorDescription: (SensorMessage("", JointState, cable_state),),
}
"""Messages of the sensor kinds of this package; for chambers see `messages_of`, for others `numbers`."""


def messages_of(described: SimulatedSensorDescription, atmosphere: float) -> tuple[SensorMessage, ...]:
    """Return the messages of a sensor; `atmosphere` is the absolute pressure of the air in [Pa]."""
    if isinstance(described, ChamberSensorDescription):

        def pressure(header: Header, reading: SensorReading) -> FluidPressure:
            return chamber_pressure(atmosphere, header, reading)

        return SensorMessage("", FluidPressure, pressure), SensorMessage("/volume", Float64, chamber_volume)
    return KINDS.get(type(described), (SensorMessage("", Float64MultiArray, numbers),))


def _vectors(value: Array) -> tuple[Vector3, Vector3]:
    first, second = value.reshape(2, 3).tolist()
    return Vector3(x=first[0], y=first[1], z=first[2]), Vector3(x=second[0], y=second[1], z=second[2])
