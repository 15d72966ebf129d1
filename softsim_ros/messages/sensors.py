"""What sensors told as messages, kind by kind; arrays are filled from buffers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from geometry_msgs.msg import PoseArray, Vector3, WrenchStamped
from sensor_msgs.msg import FluidPressure, Image, Imu, JointState
from std_msgs.msg import Float64, Float64MultiArray, Header

from softsim_core.arrays import Array
from softsim_core.sensing import (
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
from softsim_ros.messages.buffers import message_array
from softsim_ros.messages.states import joint_state, pose

UPRIGHT: Final = (0.0, 0.0, 0.0, 1.0)
TACTILE_ENCODING: Final = "32FC1"

Write: TypeAlias = Callable[[Header, SensorReading], Any]


class Told(NamedTuple):
    """One message of a kind of sensor: what stands behind the sensor's topic, its type, how it is written."""

    below: str
    message: type
    write: Write


def wrench(header: Header, reading: SensorReading) -> WrenchStamped:
    """Force in [N] and moment in [N m] in the frame of the header."""
    message = WrenchStamped(header=header)
    message.wrench.force, message.wrench.torque = _vectors(reading.value)
    return message


def tactile_image(header: Header, reading: SensorReading) -> Image:
    """Pressures in [Pa] as an image of one float32 channel, a row of the image for each row of the grid."""
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
    """Pressures in [Pa] of a message made by `tactile_image`, shape (rows, columns)."""
    return np.frombuffer(message.data, dtype="<f4").reshape(message.height, message.width).astype(float)


def imu(header: Header, reading: SensorReading) -> Imu:
    """Specific force, angular rate and orientation with the variances of their noise; -1: no orientation."""
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
    """Places of markers in [m], not turned; NaN where one is not seen."""
    return PoseArray(header=header, poses=[pose(place, UPRIGHT) for place in reading.value.tolist()])


def number(_: Header, reading: SensorReading) -> Float64:
    """One number."""
    return Float64(data=float(reading.value))


def cable_state(header: Header, reading: SensorReading) -> JointState:
    """Length in [m] as position and tension in [N] as effort of the cable's joint."""
    described = reading.description
    assert isinstance(described, CableSensorDescription)
    length, tension = reading.value
    return joint_state(header.stamp, header.frame_id, [described.joint], [length], [], [tension])


def chamber_pressure(atmosphere: float, header: Header, reading: SensorReading) -> FluidPressure:
    """Pressure against vacuum in [Pa], `atmosphere` around, with the variance of its noise."""
    described = reading.description
    assert isinstance(described, ChamberSensorDescription)
    pressure, variance = atmosphere + float(reading.value[1]), described.pressure_noise**2
    return FluidPressure(header=header, fluid_pressure=pressure, variance=variance)


def chamber_volume(_: Header, reading: SensorReading) -> Float64:
    """Volume in [m^3]."""
    return Float64(data=float(reading.value[0]))


def numbers(_: Header, reading: SensorReading) -> Float64MultiArray:
    """All numbers, row by row: of a kind that a user has added."""
    return Float64MultiArray(data=message_array(reading.value, "d"))


KINDS: Final[dict[type[SimulatedSensorDescription], tuple[Told, ...]]] = {
    WrenchSensorDescription: (Told("", WrenchStamped, wrench),),
    ForceTorqueDescription: (Told("", WrenchStamped, wrench),),
    TactileArrayDescription: (Told("", Image, tactile_image),),
    StrainSensorDescription: (Told("", Float64, number),),
    ImuDescription: (Told("", Imu, imu),),
    MarkersDescription: (Told("", PoseArray, marker_poses),),
    CableSensorDescription: (Told("", JointState, cable_state),),
}
"""What is told of the package's kinds; of chambers see `told_of`, of others `numbers`."""


def told_of(described: SimulatedSensorDescription, atmosphere: float) -> tuple[Told, ...]:
    """The messages of a sensor; `atmosphere` is the pressure of the air around in [Pa], against vacuum."""
    if isinstance(described, ChamberSensorDescription):

        def pressure(header: Header, reading: SensorReading) -> FluidPressure:
            return chamber_pressure(atmosphere, header, reading)

        return Told("", FluidPressure, pressure), Told("/volume", Float64, chamber_volume)
    return KINDS.get(type(described), (Told("", Float64MultiArray, numbers),))


def _vectors(value: Array) -> tuple[Vector3, Vector3]:
    first, second = value.reshape(2, 3).tolist()
    return Vector3(x=first[0], y=first[1], z=first[2]), Vector3(x=second[0], y=second[1], z=second[2])
